"""Rows that look copied, and columns that change their number of digits."""

from __future__ import annotations

from collections.abc import Iterator
from math import comb

import numpy as np
import pandas as pd
from scipy import stats

from bayestissue.thesis.audit.findings import Finding
from bayestissue.thesis.audit.impacts import GENERAL, Impacts


@GENERAL.check(
    severity="minor",
    bearing="tables",
    reason="one impact less changes the averages of its trial, not the conclusions",
)
def rows_that_stand_twice(impacts: Impacts) -> Iterator[Finding]:
    """Two people with the same K and the same C in one trial."""
    keys = ["trial", "K", "C"]
    again = impacts.rows[impacts.rows.duplicated(keys, keep=False)]
    for (trial, stiffness, damping), rows in again.groupby(keys):
        people = _names(rows)
        chance = _chance_of_a_pair(impacts, "K", trial) * _chance_of_a_pair(impacts, "C", trial)
        likely = comb(int((impacts.rows["trial"] == trial).sum()), 2) * chance
        yield Finding(
            impacts.where,
            f"trial {trial}, subjects {people}",
            f"K = {stiffness:g}, C = {damping:g} for each",
            f"chance of such a pair {likely:.1g}" if likely else "no chance",
            f"Subjects {people} of trial {trial} have the same K and the same C to the last digit. Among the "
            f"people of that trial such a pair would come about by chance {_how_often(likely)}; one row is "
            f"probably a copy of the other.",
        )


@GENERAL.check(
    severity="note",
    bearing="tables",
    reason="it may be chance; the C beside it differs",
)
def stiffness_that_stands_twice(impacts: Impacts) -> Iterator[Finding]:
    """The same K with another C, where the printed digits make that unlikely."""
    keys = ["trial", "K"]
    again = impacts.rows[impacts.rows.duplicated(keys, keep=False)]
    sizes = impacts.rows["trial"].value_counts().to_dict()
    for (trial, stiffness), rows in again.groupby(keys):
        likely = comb(int(sizes[trial]), 2) * _chance_of_a_pair(impacts, "K", trial)
        if likely > 0.1 or rows["C"].duplicated(keep=False).all():
            continue
        people = _names(rows)
        values = " and ".join(f"{value:g}" for value in rows["C"])
        yield Finding(
            impacts.where,
            f"trial {trial}, subjects {people}",
            f"K = {stiffness:g} for each",
            f"chance of such a pair {likely:.1g}",
            f"Subjects {people} of trial {trial} share K = {stiffness:g} to the last digit while their "
            f"C is {values}; in this trial two equal K's come about {_how_often(likely)}.",
        )


@GENERAL.check(
    severity="minor",
    bearing="tables",
    reason="a row copied from another trial belongs to another mass",
)
def estimates_in_two_trials(impacts: Impacts) -> Iterator[Finding]:
    """The same K and the same C in trials of different mass."""
    again = impacts.rows[impacts.rows.duplicated(["K", "C"], keep=False)]
    across = again.groupby(["K", "C"]).filter(lambda rows: len(rows["trial"].unique()) > 1)
    if not across.empty:
        yield Finding(
            impacts.where,
            "equal estimates in different trials",
            f"{len(across)} rows",
            "no two expected",
            f"{len(across)} rows share K and C to the last digit with a row of another trial (trials "
            f"{', '.join(str(trial) for trial in across['trial'].unique())}), where the mass differs.",
        )


def _chance_of_a_pair(impacts: Impacts, quantity: str, trial: object) -> float:
    """Chance that two values of ``quantity`` in ``trial`` print alike, if they were normal.

    The difference of two has density 1/(2 s √π) at zero, times the width of the last digit.
    """
    values = impacts.rows.loc[impacts.rows["trial"] == trial, quantity]
    if impacts.digits is None:
        return 0.0
    scatter = float(values.std(ddof=1))
    if not scatter > 0:
        return 1.0
    return float(min(1, 10.0**-impacts.digits * stats.norm.pdf(0) / (np.sqrt(2) * scatter)))


def _how_often(likely: float) -> str:
    return f"once in {float(f'{1 / likely:.1e}'):,.0f} such trials" if likely > 1e-6 else "practically never"


def _names(rows: pd.DataFrame) -> str:
    return " and ".join(str(subject) for subject in rows["subject"])
