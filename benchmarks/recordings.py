"""What the program makes of recordings that others made: how many it takes and flags.

    EVIDENCE_RECORDINGS=FOLDER .venv/bin/python benchmarks/recordings.py

Each folder in FOLDER that holds a dataset.toml is read, and its impacts are estimated one by one. A row a
dataset: how many impacts were read and flagged, and of those whose noise was tested how many have p below
0.01, where the model's own noise gives 1 %.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from evidence import measure

import bayestissue as bt
from bayestissue.inference.checking.model_form import SMALL_P


def row_of(folder: Path) -> dict[str, Any]:
    """One dataset."""
    dataset = bt.read_dataset(folder, skip_bad=True)
    table = bt.estimate(dataset)
    tested = table.get("whiteness_p", table["K_N_per_m"] * float("nan"))
    return {
        "recorded": dataset.quantity,
        "impacts": len(dataset.impacts),
        "left_out": len(dataset.left_out),
        "flagged": int((table["flags"] != "").sum()),
        "tested": int(tested.notna().sum()),
        "below": int((tested < SMALL_P).sum()),
    }


def main() -> None:
    paths = sorted(path.parent for path in Path(os.environ["EVIDENCE_RECORDINGS"]).glob("*/dataset.toml"))
    measure("recordings", {folder.name: folder for folder in paths}, row_of)


if __name__ == "__main__":
    main()
