"""Every impact's posterior beside its point estimates and, where it is known, the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from bayestissue.hierarchy.specification import SIDE_BY_SIDE
from bayestissue.report.fit.run import COLUMN, COMPARABLE, FitRun
from bayestissue.report.posterior import QUANTITIES, Spread
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import UNITS, significant

METHODS = {"exact": "estimates_exact", "dds": "estimates_dds"}
MOST_ROWS = 300
_MOST_DRAWN = 1000
_MASS_MUST_VARY = 1.01
_NONE = "not an interval"


def side_by_side(run: FitRun, quantity: str) -> pd.DataFrame:
    """One row an impact: posterior ``median``, ``eti50_*`` and ``eti90_*``, ``exact``, ``dds``, ``truth``.

    In N/m (K) or N s/m (C), indexed by impact; what an impact lacks is NaN, ``truth`` for measured data.
    """
    names = ["median", "eti50_low", "eti50_high", "eti90_low", "eti90_high"]
    table = run.of_impacts(quantity)[names].copy()
    for method, source in METHODS.items():
        estimates = getattr(run, source).set_index("impact")[COLUMN[quantity]]
        table[method] = estimates.reindex(table.index)
    known = None if run.truth is None else run.truth.set_index("impact")[_true_column(run, quantity)]
    table["truth"] = np.nan if known is None else known.reindex(table.index)
    return table


def _true_column(run: FitRun, quantity: str) -> str:
    """The column of the truth; of another element's tissue the secant stiffness or equivalent damping."""
    same = run.record.get("model", {}).get("element", SIDE_BY_SIDE) == SIDE_BY_SIDE
    comparable = COMPARABLE[quantity]
    return comparable if same and run.truth is not None and comparable in run.truth else COLUMN[quantity]


def shown_rows(table: pd.DataFrame) -> pd.DataFrame:
    """The rows that a figure shows: all, or a thousand evenly spaced ones if there are more."""
    return table.iloc[np.unique(np.linspace(0, len(table) - 1, min(len(table), _MOST_DRAWN)).astype(int))]


@dataclass(frozen=True)
class Held:
    """How many of ``impacts`` with a known truth have it inside their ``level`` interval of a quantity."""

    quantity: str
    level: int
    held: int
    impacts: int


def held_by_intervals(run: FitRun, quantity: str) -> list[Held]:
    """For the 50 % and the 90 % intervals; empty for data whose truth isn't known."""
    table = side_by_side(run, quantity).dropna(subset="truth")
    if table.empty:
        return []
    return [
        Held(
            quantity,
            level,
            int(table["truth"].between(table[f"eti{level}_low"], table[f"eti{level}_high"]).sum()),
            len(table),
        )
        for level in (50, 90)
    ]


def dds_ratio(run: FitRun, quantity: str) -> float:
    """Median over impacts of the thesis's estimate divided by the posterior's median."""
    table = side_by_side(run, quantity)
    return float((table["dds"] / table["median"]).median())


def mass_varies(run: FitRun) -> bool:
    """Whether the impactors' masses differ by more than a hundredth."""
    mass = run.constant("mass_kg")
    return bool(mass.max() > _MASS_MUST_VARY * mass.min())


@dataclass(frozen=True)
class ApparentExponent:
    """A straight line through log estimates over log M/M_ref: ``slope`` with its 90 % interval."""

    intercept: float
    slope: Spread


def apparent_exponent(run: FitRun, quantity: str) -> ApparentExponent | None:
    """The mass exponent that the thesis's point estimates show by least squares; None if mass is constant.

    The interval takes impacts for independent, which those of one person are not: it is too narrow.
    """
    table = run.estimates_dds[["mass_kg", COLUMN[quantity]]].dropna()
    table = table[(table > 0).all(axis=1)]
    mass = table["mass_kg"].to_numpy()
    if len(table) < 3 or mass.max() <= _MASS_MUST_VARY * mass.min():
        return None
    x, y = np.log(mass / run.reference_mass), np.log(table[COLUMN[quantity]].to_numpy())
    centred, degrees = x - x.mean(), len(x) - 2
    slope = float(centred @ y / (centred @ centred))
    intercept = float(y.mean() - slope * x.mean())
    left = y - intercept - slope * x
    # Half of the 90 % interval of Student's t with n - 2 degrees of freedom.
    half = float(stdtrit(degrees, 0.95) * np.sqrt(left @ left / degrees / (centred @ centred)))
    return ApparentExponent(intercept, Spread(slope, slope - half, slope + half))


def no_interval(run: FitRun) -> list[bool]:
    """Whether no element describes the trace of each impact, so that it has no interval."""
    form = run.diagnostics.get("model_form", {})
    alone = set(form.get("undescribed_impacts", []))
    return [run.undescribed or name in alone for name in run.impacts]


def estimates_table(run: FitRun) -> Table:
    """Posterior beside the point estimates and, where known, the truth, of the first 300 impacts."""
    tables = {quantity: side_by_side(run, quantity)[:MOST_ROWS] for quantity in QUANTITIES}
    known = run.truth is not None
    titles = ["impact", "person", "condition", "M (kg)"]
    cells: list[list[str]] = [
        run.impacts[:MOST_ROWS],
        [str(name) for name in run.constant("impact_subject")[:MOST_ROWS]],
        [str(name) for name in run.constant("impact_trial")[:MOST_ROWS]],
        [f"{mass:.3f}" for mass in run.constant("mass_kg")[:MOST_ROWS]],
    ]
    for quantity, table in tables.items():
        spreads = [Spread(*row) for row in table[["median", "eti90_low", "eti90_high"]].to_numpy()]
        titles += [
            f"{quantity} ({UNITS[quantity]})",
            f"{quantity}, 90 %",
            f"{quantity} exact",
            f"{quantity} dds",
        ]
        ranges = [_NONE if none else one.range for one, none in zip(spreads, no_interval(run), strict=False)]
        cells += [[one.value for one in spreads], ranges]
        cells += [[significant(value, 4) for value in table[method]] for method in METHODS]
        if known:
            titles.append(f"true {quantity}")
            cells.append([significant(value, 4) for value in table["truth"]])
    return Table(columns(*titles, number=titles[3:]), [Row(row) for row in zip(*cells, strict=True)])
