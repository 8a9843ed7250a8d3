"""Every impact's posterior beside its point estimates and, where known, the truth; how methods agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.inference.answers.reliability import agreement
from bayestissue.inference.results.meanings import COLUMNS, UNITS
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.page_settings import LIMITS, WORTH
from bayestissue.reports.pages.page_tables import Field, Table, shown, table_of
from bayestissue.reports.pages.posterior import QUANTITIES
from bayestissue.reports.pages.wording import Spread

# What `agreement_table` has the ratio of.
TITLE = "thesis's method over posterior median"


def shown_rows(table: pd.DataFrame) -> pd.DataFrame:
    """The rows that a figure shows: all, or a thousand evenly spaced ones if there are more."""
    return table.iloc[evenly_spaced(len(table), LIMITS.impacts_drawn)]


def held_by_intervals(run: FitRun) -> pd.DataFrame:
    """By quantity and ``level`` of interval, in how many of the ``impacts`` of known truth it ``held``."""
    rows = []
    for q, known in ((q, table.dropna(subset="truth")) for q, table in run.estimates_by_method.items()):
        for level in (50, 90) if len(known) else ():
            held = known["truth"].between(known[f"eti{level}_low"], known[f"eti{level}_high"]).sum()
            rows.append((run.symbols[q], level, int(held), len(known)))
    return pd.DataFrame(rows, columns=["quantity", "level", "held", "impacts"])


def held_table(rows: pd.DataFrame) -> Table:
    """How many intervals hold the truth: ``rows`` with quantity, level, held and impacts."""
    return shown("coverage", rows.assign(share=rows["held"] / rows["impacts"]))


def dds_ratio(run: FitRun, quantity: str) -> float:
    """Median over impacts of the thesis's estimate divided by the posterior's median."""
    table = run.estimates_by_method[quantity]
    return float((table["dds"] / table["median"]).median())


def mass_varies(run: FitRun) -> bool:
    """Whether the impactors' masses differ by more than a hundredth."""
    mass = run.constant("mass_kg")
    return bool(mass.max() > WORTH.masses * mass.min())


@dataclass(frozen=True)
class ApparentExponent:
    """A straight line through log estimates over log M/M_ref: ``slope`` with its 90 % interval."""

    intercept: float
    slope: Spread


def apparent_exponent(run: FitRun, quantity: str) -> ApparentExponent | None:
    """The mass exponent that the thesis's point estimates show by least squares; None if mass is constant.

    The interval takes impacts for independent, which those of one person are not: it is too narrow.
    """
    from scipy.special import stdtrit

    table = run.point_estimates[["mass_kg", COLUMNS[quantity]]].dropna()
    table = table[(table > 0).all(axis=1)]
    mass = table["mass_kg"].to_numpy()
    if len(table) < 3 or mass.max() <= WORTH.masses * mass.min():
        return None
    x, y = np.log(mass / run.reference_mass), np.log(table[COLUMNS[quantity]].to_numpy())
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


_ENDS = ["median", "eti90_low", "eti90_high"]


def estimates_table(run: FitRun) -> Table:
    """Posterior beside the point estimates and, where known, the truth, of the first 300 impacts."""
    fields = [*map(Field, ("impact", "person", "condition")), Field("M (kg)", "{:.3f}", of=["mass_kg"])]
    table = run.impacts_table[["impact", "person", "condition", "mass_kg"]]
    for q, values in run.estimates_by_method.items():
        symbol, values = run.symbols[q], values.reset_index(drop=True)
        ranges = values[_ENDS].mask(pd.Series(no_interval(run)))
        table = table.join(values.add_prefix(f"{q} ")).join(ranges.add_prefix(f"{q} range "))
        points = {f"{q} dds": f"{q} dds"}
        points |= {} if run.truth.empty else {f"true {symbol}": f"{q} truth"}
        of_range = [f"{q} range {end}" for end in _ENDS]
        fields += [
            Field(f"{symbol} ({UNITS[q]})", "spread", of=[f"{q} {end}" for end in _ENDS]),
            Field(f"{symbol}, 90 %", "range", of=of_range, missing="not an interval"),
            *(Field(title, "4", of=[column], missing="not known") for title, column in points.items()),
        ]
    return table_of(table[: LIMITS.rows], *fields)


def method_values(run: FitRun, quantity: str) -> pd.DataFrame:
    """The value of every impact by the thesis's method, ``dds``, and its ``posterior`` median."""
    return run.estimates_by_method[quantity].rename(columns={"median": "posterior"})[["dds", "posterior"]]


def agreement_table(run: FitRun) -> Table:
    """The ratio of the two with its limits of agreement."""
    ratios = agreement({run.symbols[quantity]: method_values(run, quantity) for quantity in QUANTITIES})
    return shown("agreement", ratios.assign(method=TITLE))
