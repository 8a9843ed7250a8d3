"""The nine experimental conditions and their covariates: Tables 5.10 and 5.11, printed and recomputed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

import numpy as np
import pandas as pd

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import PublishedNumber, Recomputed, half_unit, line_of

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
    statistics = groups[quantity].agg(["count", "mean", "std", "min", "max"]).reindex(table.index)
    h = groups["rounding"].max().reindex(table.index)
    n = statistics["count"]
    has_rows = n.gt(1)
    recomputed = {
        "average": (statistics["mean"], h),
        "sd": (statistics["std"], h * np.sqrt(n / (n - 1).clip(lower=1))),
        "range": (statistics["max"] - statistics["min"], 2 * h),
    }
    result = table.drop(columns=list(recomputed)).assign(
        impacts=n.where(has_rows, n.max()),
        minimum=statistics["min"],
        maximum=statistics["max"],
        from_rows=has_rows,
    )
    for name, (value, rounding) in recomputed.items():
        result[name] = value.where(has_rows, table[name])
        result[f"{name}_rounding"] = rounding.where(has_rows, table[f"{name}_text"].map(half_unit))
    return result


def grand_mean(table: pd.DataFrame) -> float:
    """The mean over all impacts, which follows from the averages of the conditions."""
    return float(np.average(table["average"], weights=table["impacts"]))


def sum_of_squares(table: pd.DataFrame) -> float:
    """Σ n (average - grand mean)² + Σ (n - 1) s²: the sum of squares between conditions and within them."""
    n = table["impacts"]
    between = (n * (table["average"] - grand_mean(table)) ** 2).sum()
    return float(between) + float(((n - 1) * table["sd"] ** 2).sum())


def rounding_norm(table: pd.DataFrame) -> float:
    """The largest Euclidean norm that the rounding errors of all impacts together can have.

    A condition known by its rows contributes n h²; one known by its average and standard deviation only
    contributes n h² + (n - 1) h², since the two move orthogonal parts of its impacts.
    """
    n, average = table["impacts"], table["average_rounding"]
    lost = (~table["from_rows"]) * (n - 1) * table["sd_rounding"] ** 2
    return float(np.sqrt((n * average**2 + lost).sum()))


def unrounded_mass(table: pd.DataFrame) -> pd.Series:
    """2 E / V'² with V' = V + 0.25 m/s (kg), of which every printed mass is the number cut off.

    The printed masses don't follow from the printed velocities, but do, all nine, from velocities 0.25 m/s
    higher; they then are 2/3, 0.4898, 0.5625 ... cut to three decimals.
    """
    return 2 * table["energy_J"] / (table["velocity_m_s"] + 0.25) ** 2


_FACTORS = {"energy": "energy_J", "velocity": "velocity_m_s", "mass": "mass_kg"}

NEVER_TABULATED = "skin fold and muscle thickness were never tabulated"


def factors(name: str) -> tuple[str, ...]:
    """The factors, sorted, of a variable as the thesis writes it, such as ``"Energy* Mass *Velocity"``.

    ``"Velocity*Energy"`` and ``"Energy * Velocity"`` come out the same; ``"Mass Sq"`` is mass twice. What
    isn't made of energy, velocity and mass is its own single factor.
    """
    words = name.lower().strip()
    squared = re.fullmatch(r"(\w+) se?q", words)
    parts = [squared[1]] * 2 if squared else [part.strip() for part in words.split("*")]
    return tuple(sorted(parts))


def covariate(name: str, table: pd.DataFrame) -> np.ndarray | None:
    """The product of the factors of ``name`` for every condition of ``table``; None for skin and muscle."""
    parts = factors(name)
    if any(part not in _FACTORS for part in parts):
        return None
    return np.prod([table[_FACTORS[part]].to_numpy(float) for part in parts], axis=0)


_NAMES = {"average": "average", "sd": "standard deviation", "range": "range"}


def summary_lines(published: PublishedTables) -> Iterator[PublishedNumber]:
    """Average, standard deviation (with n - 1) and range of K and C in every trial, printed and recomputed.

    The masses of the first of the two tables are set beside 2E/V², which defines them (section 6.4).
    """
    for trial, condition in conditions(published, QUANTITIES[0]).iterrows():
        yield line_of(condition, "mass_kg", f"mass, trial {trial}", _mass(condition))
    for quantity in QUANTITIES:
        for trial, condition in conditions(published, quantity).iterrows():
            for name, label in _NAMES.items():
                number = f"{label} of {quantity}, trial {trial}"
                yield line_of(condition, name, number, _summary(condition, name))


def _summary(condition: pd.Series, name: str) -> Recomputed:
    if not condition["from_rows"]:
        return Recomputed(None, note=f"the impacts of trial {condition.name} are lost")
    repeated = name == "sd" and condition["sd_text"] == condition["range_text"]
    return Recomputed(
        condition[name],
        rounding=condition[f"{name}_rounding"],
        hint="repeats the range printed beside it" if repeated else "",
    )


def _mass(condition: pd.Series) -> Recomputed:
    # Energy and velocity are levels of a designed experiment (section 2.1): exact, whatever their digits.
    energy = condition["energy_J"]
    needed = np.sqrt(2 * energy / condition["mass_kg"])
    return Recomputed(
        2 * energy / condition["velocity_m_s"] ** 2,
        hint=f"E = ½MV² with the printed mass needs V = {needed:.3f} m/s",
    )
