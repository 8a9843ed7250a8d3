"""Simulated studies one after the other, whose rows are kept: a script that was stopped goes on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd

from bayestissue import runtime

RESULTS = Path(__file__).parent / "results"


def studied(name: str, count: int, rows_of: Callable[[int], pd.DataFrame]) -> pd.DataFrame:
    """The rows of so many studies, with ``held``: whether an interval holds the truth.

    Args:
        name: of the file below results/ to which the rows of each study are added.
        count: of studies.
        rows_of: of a study's number its rows, one an interval: ``low``, ``high``, ``truth`` and what else.
    """
    path = RESULTS / f"{name}.csv"
    runtime.configure(one_core=True)
    known = set(pd.read_csv(path)["unit"]) if path.is_file() else set()
    for number in (one for one in range(count) if one not in known):
        # What is compiled for many shapes takes more mapped memory than a process may have.
        runtime.release_compiled()
        rows = rows_of(number).assign(unit=number)
        rows.to_csv(path, mode="a", header=not path.is_file(), index=False, float_format="%.7g")
        print(f"{name}: {number + 1} of {count}", flush=True)
    rows = pd.read_csv(path)
    return rows.assign(held=rows["truth"].between(rows["low"], rows["high"]))


def shares_held(rows: pd.DataFrame) -> pd.DataFrame:
    """Of each quantity the share of intervals that hold, and its standard error between studies."""
    of_study = rows.groupby(["of", "unit"], sort=False)["held"].mean().groupby("of", sort=False)
    return pd.DataFrame({"share": of_study.mean(), "error": of_study.sem(), "studies": of_study.size()})
