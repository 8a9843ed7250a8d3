"""The nine experimental conditions: recomputed where the impacts remain, as printed where they are lost."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import half_unit

Quantity = Literal["K", "C"]
QUANTITIES: tuple[Quantity, ...] = ("K", "C")


def conditions(published: PublishedTables, quantity: Quantity) -> pd.DataFrame:
    """One row per trial, in the order of Tables 5.10 and 5.11, for K or C.

    ``average``, ``sd`` (with n - 1) and ``range`` are recomputed from the impacts of the trial where they
    remain (``from_rows``) and are the printed ones where they are lost; ``minimum`` and ``maximum`` are then
    NaN. ``average_rounding``, ``sd_rounding`` and ``range_rounding`` bound how far the rounding of the
    printed numbers can have moved each of them: an average of n numbers that are each off by at most h is
    off by at most h, their standard deviation by h √(n/(n-1)), their range by 2h. ``impacts`` is n; a lost
    trial is taken to have as many as the largest that remains. Energy (J), velocity (m/s), mass (kg) and
    the ``_text`` columns are those of the printed table.
    """
    table = published.averages.query("quantity == @quantity").set_index("trial").sort_values("row")
    rows = published.estimates
    groups = rows.assign(rounding=rows[f"{quantity}_text"].map(half_unit)).groupby("trial")
    found = groups[quantity].agg(["count", "mean", "std", "min", "max"]).reindex(table.index)
    h = groups["rounding"].max().reindex(table.index)
    n = found["count"]
    kept = n.gt(1)
    recomputed = {
        "average": (found["mean"], h),
        "sd": (found["std"], h * np.sqrt(n / (n - 1).clip(lower=1))),
        "range": (found["max"] - found["min"], 2 * h),
    }
    result = table.drop(columns=list(recomputed)).assign(
        impacts=n.where(kept, n.max()), minimum=found["min"], maximum=found["max"], from_rows=kept
    )
    for name, (value, rounding) in recomputed.items():
        result[name] = value.where(kept, table[name])
        result[f"{name}_rounding"] = rounding.where(kept, table[f"{name}_text"].map(half_unit))
    return result


def within_sum_of_squares(table: pd.DataFrame) -> float:
    """Σ (n - 1) s²: the sum of squares of the impacts about the averages of their conditions."""
    return float(((table["impacts"] - 1) * table["sd"] ** 2).sum())


def grand_mean(table: pd.DataFrame) -> float:
    """The mean over all impacts, which follows from the averages of the conditions."""
    return float(np.average(table["average"], weights=table["impacts"]))


def between_sum_of_squares(table: pd.DataFrame) -> float:
    """Σ n (average - grand mean)²: the sum of squares of the conditions."""
    return float((table["impacts"] * (table["average"] - grand_mean(table)) ** 2).sum())


def rounding_norm(table: pd.DataFrame) -> float:
    """The largest Euclidean norm that the rounding errors of all impacts together can have.

    A condition known by its rows contributes n h²; one known by its average and standard deviation only
    contributes n h² + (n - 1) h², since the two move orthogonal parts of its impacts.
    """
    n, average = table["impacts"], table["average_rounding"]
    lost = (~table["from_rows"]) * (n - 1) * table["sd_rounding"] ** 2
    return float(np.sqrt((n * average**2 + lost).sum()))


def unrounded_mass(table: pd.DataFrame) -> pd.Series | None:
    """2 E / V'² with V' = V + 0.25 m/s (kg), if every printed mass is that number cut off; else None.

    The printed masses don't follow from the printed velocities, but do, all nine, from velocities 0.25 m/s
    higher; they then are 2/3, 0.4898, 0.5625 ... cut to three decimals.
    """
    mass = 2 * table["energy_J"] / (table["velocity_m_s"] + 0.25) ** 2
    return mass if bool(((mass - table["mass_kg"]).abs() < 1e-3).all()) else None
