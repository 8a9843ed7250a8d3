"""Whether what was found is usual: published values of impacts like these, beside this study's own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from bayestissue.base.literature import FACTOR, MEASURED, Comparable, Measurement, Range, comparable
from bayestissue.base.outcome_table import OUTCOME_COLUMNS
from bayestissue.inference.results.meanings import COLUMNS, outcome_name
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.level_outcomes import quantity_title, scaled
from bayestissue.reports.pages.page_tables import Field, Table, table_of
from bayestissue.reports.pages.wording import significant

# Of an impact, what means the same for every element, where its own has it.
_ACROSS_ELEMENTS = {"K": "K_secant", "C": "C_equivalent"}
# What is lost of the energy that was put in has the weight's work in it, where an impactor falls.
_NAMES = {column: name for name, column in (COLUMNS | OUTCOME_COLUMNS).items()} | {
    "energy_share": "energy_share_with_gravity"
}
# Of this study's impacts, nine in ten.
_MOST = (0.05, 0.95)


class Line(NamedTuple):
    """A published value beside this study's.

    Attributes:
        measurement: what it is of.
        quantity: what was measured, by the name of the variable.
        published: the published value, in the unit of the variable.
        estimates: posterior medians of the impacts that compare, in that unit.
    """

    measurement: Measurement
    quantity: str
    published: Range
    estimates: Float64[np.ndarray, " impact"]

    @property
    def median(self) -> float:
        """That of this study's impacts."""
        return float(np.median(self.estimates))

    @property
    def ratio(self) -> float:
        """That median over the published value, or over the nearest of a published range."""
        return self.published.ratio(self.median)

    @property
    def unusual(self) -> str:
        """What the ratio says where it is beyond a factor of two; else empty."""
        if 1 / FACTOR <= self.ratio <= FACTOR:
            return ""
        return "less than half" if self.ratio < 1 else "more than twice"

    def words(self, values: Iterable[float]) -> str:
        """Values of it as the page has them: a number, or a range."""
        _, _, factor = scaled(self.quantity)
        return _span(factor * value for value in values)


def site(run: FitRun) -> str:
    """What was hit; empty where the dataset does not state it."""
    return str(run.record.get("site", ""))


def is_answered(run: FitRun) -> bool:
    """Whether the page answers it: a site is stated, or published values compare."""
    return not run.undescribed and bool(site(run) or lines(run))


def comparable_measurements(run: FitRun) -> list[Comparable]:
    """The published measurements of impacts like this run's."""
    return comparable(run.constant("mass_kg"), run.constant("velocity_m_s"), site(run))


def lines(run: FitRun) -> list[Line]:
    """Their values beside this run's, by quantity, of those quantities that this run has."""
    measurements, compared = comparable_measurements(run), []
    for column in MEASURED:
        quantity = _NAMES[column]
        values = run.of_impacts(_ACROSS_ELEMENTS.get(quantity, quantity))
        values = run.of_impacts(quantity) if values.empty else values
        for one in measurements if len(values) else ():
            estimates = values["median"].to_numpy(float)[one.impacts]
            known, published = estimates[np.isfinite(estimates)], one.measurement.published.get(column)
            if published is not None and len(known):
                compared.append(Line(one.measurement, quantity, published, known))
    return compared


def published_quantities(run: FitRun) -> list[str]:
    """What was measured in impacts like this run's."""
    return list(
        dict.fromkeys(
            outcome_name(_NAMES[name])
            for one in comparable_measurements(run)
            for name in one.measurement.published
        )
    )


def far_off(compared: Iterable[Line]) -> list[str]:
    """Which values are beyond a factor of two of the published ones."""
    return list(
        dict.fromkeys(f"{outcome_name(line.quantity)} ({line.unusual})" for line in compared if line.unusual)
    )


def motion(measurement: Measurement) -> str:
    """Its masses and velocities: "0.6 to 5 kg at 1 m/s"."""
    mass, velocity = (
        _span(values or (), "{:.3g}".format) for values in (measurement.mass, measurement.velocity)
    )
    return f"{mass} kg at {velocity} m/s"


def _span(values: Iterable[float], words: Callable[[float], str] = significant) -> str:
    return " to ".join(dict.fromkeys(map(words, values)))


def usual_table(run: FitRun) -> Table:
    """Published values and this study's side by side, with their ratio."""
    return table_of(
        lines(run),
        Field("quantity", lambda line: quantity_title(line.quantity)),
        Field("published", lambda line: line.words(line.published), "number"),
        Field("here", lambda line: line.words([line.median]), "number"),
        Field("nine in ten", lambda line: line.words(np.quantile(line.estimates, _MOST)), "number"),
        Field("here / published", lambda line: significant(line.ratio, 2), "number"),
        Field("unusual", lambda line: line.unusual, optional=True),
        Field("other site", lambda line: "" if site(run) else line.measurement.site, optional=True),
        Field("published for", lambda line: motion(line.measurement)),
        Field("by", lambda line: line.measurement.source.short),
    )
