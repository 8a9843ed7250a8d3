"""People ranked by K, from a fit of recorded heel strikes.

    EVIDENCE_RECORDINGS=FOLDER .venv/bin/python benchmarks/heelstrike.py

The dataset FOLDER/heelstrike is fitted by models/heelstrike.toml. A row a person: rank, K in N/m, the
effect on log K, and C in N s/m, with 90 % intervals.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from evidence import recorded

ROOT = Path(__file__).resolve().parents[1]
LEVELS = {"median": 0.5, "low": 0.05, "high": 0.95}


def by_draw(posterior: xr.Dataset, name: str) -> np.ndarray:
    """[label, draw], or [draw] of a single number."""
    values = posterior[name].transpose(..., "chain", "draw").to_numpy()
    return values.reshape(*values.shape[:-2], -1)


def people(posterior: xr.Dataset) -> pd.DataFrame:
    """A row a person, stiffest first: rank, K, K over the typical person's, the effect on log K, and C."""
    K = by_draw(posterior, "K_subject")
    of_draws = {
        "rank": len(K) - K.argsort(0).argsort(0),
        "K": K,
        "ratio": K / np.exp(by_draw(posterior, "intercept_K")),
        "effect_K": by_draw(posterior, "subject_effect_K"),
        "C": by_draw(posterior, "C_subject"),
    }
    columns = {
        f"{name}_{level}": np.quantile(values, probability, axis=1)
        for name, values in of_draws.items()
        for level, probability in LEVELS.items()
    }
    table = pd.DataFrame({"subject": posterior["subject"].to_numpy().astype(str)} | columns)
    return table.sort_values("K_median", ascending=False)


def main() -> None:
    model = ROOT / "models" / "heelstrike.toml"
    with recorded("heelstrike") as record, tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "bayestissue",
            "fit",
            f"{os.environ['EVIDENCE_RECORDINGS']}/heelstrike",
            "--out",
            f"{folder}/run",
        ]
        subprocess.run([*command, "--model", str(model)], check=True)  # noqa: S603 - our own program
        with xr.open_datatree(Path(folder) / "run" / "posterior.nc") as tree:
            record.write(people(tree["posterior"].dataset.load()))


if __name__ == "__main__":
    main()
