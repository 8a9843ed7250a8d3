"""People ranked by K, from a finished fit of the recorded heel strikes.

    bayestissue fit HEELSTRIKE --model models/heelstrike.toml --out DIR
    .venv/bin/python benchmarks/heelstrike.py DIR

Writes heelstrike.csv (a person a row: rank, K in N/m, the person's effect on log K, C in N s/m, with 90 %
intervals), prints its table for benchmarks/README.md, and how uncertain K of a single impact is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

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


def row_of(person: dict[str, float | str]) -> str:
    """A person's row of the printed table."""

    def between(name: str, scale: float, digits: int) -> str:
        middle, low, high = (float(person[f"{name}_{level}"]) / scale for level in LEVELS)
        return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"

    rank = f"{person['rank_low']:.0f} to {person['rank_high']:.0f}"
    cells = (person["subject"], rank, between("K", 1e3, 0), between("ratio", 1, 2), between("C", 1, 0))
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, help="folder of the finished fit")
    posterior = xr.open_datatree(parser.parse_args().run / "posterior.nc")["posterior"].dataset
    table = people(posterior)
    print("\n".join(row_of(person) for person in table.to_dict("records")))
    sd = np.log(by_draw(posterior, "K")).std(axis=1)
    print(f"sd of log K of an impact: {sd.min():.2f} at least, {np.median(sd):.2f} in the median")
    table.round(3).to_csv(TABLE, index=False)


if __name__ == "__main__":
    main()
