"""People ranked by K, from a fit of recorded heel strikes.

    HEELSTRIKE=FOLDER .venv/bin/python benchmarks/heelstrike.py

The dataset in FOLDER is fitted by models/heelstrike.toml. Writes heelstrike.csv (a person a row: rank, K in
N/m, the person's effect on log K, C in N s/m, with 90 % intervals, and the median standard deviation of log K
of the person's impacts).
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
TABLE = Path(__file__).parent / "heelstrike.csv"
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
    with recorded("heelstrike"), tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "bayestissue",
            "fit",
            os.environ["HEELSTRIKE"],
            "--out",
            f"{folder}/run",
        ]
        subprocess.run([*command, "--model", str(model)], check=True)  # noqa: S603 - our own program
        with xr.open_datatree(Path(folder) / "run" / "posterior.nc") as tree:
            table = people(tree["posterior"].dataset.load())
        print(table.to_string(index=False))
        table.round(3).to_csv(TABLE, index=False)


if __name__ == "__main__":
    main()
