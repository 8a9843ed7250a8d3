"""What a posterior of K and C says, in numbers, words and figures, whatever data it came from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded
from bayestissue.inference.results.meanings import NAMES, SECANTS, TOGETHER, UNITS
from bayestissue.model.hierarchy.formulas.group_terms import stem_of
from bayestissue.reports.figures.intervals import intervals, quantiles
from bayestissue.reports.figures.study_comparisons import histogram
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.run_folder import PosteriorRun
from bayestissue.reports.pages.wording import Spread, listed, relative, said

Quantity = Literal["K", "C"]
QUANTITIES: tuple[Quantity, ...] = ("K", "C")
# Of these K there is a mass exponent where K depends on depth.
COMMON_DEPTH, OWN_DEPTH = "K_common_depth", "K_secant"
FIXED, CONSTANT = "fixed stiffness", "constant natural frequency"
# Above this a hypothesis is spoken of as what the data say; below one minus this, as what they rule out.
SURE = 0.9
# A difference tells two models apart above both: below four nats it is small, and its standard error is no
# guide (Sivula, Magnusson, Matamoros and Vehtari 2020).
DECISIVE_SE, DECISIVE_NATS = 2.0, 4.0


def spread(draws: np.ndarray) -> Spread:
    """Median and 90 % equal-tailed interval of ``draws`` [draw]."""
    low, median, high = np.percentile(draws, [5, 50, 95])
    return Spread(float(median), float(low), float(high))


def exponent(run: PosteriorRun, quantity: str) -> Spread | None:
    """The slope of log K (or log C) on log mass, or None if the model has none."""
    name = f"mass_exponent_{quantity}"
    return spread(run.draws(name)) if run.has(name) else None


def hypothesis_probability(run: PosteriorRun, quantity: str, hypothesis: str) -> float:
    """The posterior probability of one row of `hypotheses.csv`; NaN if it has no such row."""
    table = run.hypotheses
    chosen = table.loc[(table["quantity"] == quantity) & (table["hypothesis"] == hypothesis), "probability"]
    return float(chosen.iloc[0]) if len(chosen) else float("nan")


def mass_curve(run: PosteriorRun, quantity: str, masses: np.ndarray, reference: float) -> pd.DataFrame:
    """K (or C) of a typical person over the range of ``masses`` [kg], as `over_mass` draws it.

    ``reference`` is the mass at which people are reported. Beside a discrepancy the curve is that of K_secant
    of the recorded impacts, about their mean log mass.
    """
    grid = np.geomspace(0.93 * masses.min(), 1.07 * masses.max(), LIMITS.curve)
    if quantity == "K" and run.has(TOGETHER):
        quantity, drawn = OWN_DEPTH, run.draws(TOGETHER)
        reference = float(np.exp(np.log(masses).mean()))
    else:
        drawn = run.draws(f"{quantity}_typical_person")
    ratio, level = grid / reference, float(np.median(drawn))
    curve = pd.DataFrame({"mass_kg": grid, "exponent 0": level, "exponent 1": level * ratio})
    if not run.has(f"mass_exponent_{quantity}"):
        return curve
    drawn = drawn[:, None] * np.exp(run.draws(f"mass_exponent_{quantity}")[:, None] * np.log(ratio))
    low, median, high = np.percentile(drawn, [5, 50, 95], axis=0)
    return curve.assign(eti90_low=low, median=median, eti90_high=high)


class Levels(NamedTuple):
    """K or C of a typical person, and of a new one; or of ``these`` impacts together, which then is new."""

    quantity: str
    unit: str
    typical: Spread
    new: Spread
    these: bool = False


def levels(run: PosteriorRun) -> list[Levels]:
    """For K and for C: the typical person's value and interval, and a new person's.

    Beside a discrepancy K_secant of these impacts together stands in place of K, the element's own.
    """
    rows = [
        Levels(q, UNITS[q], spread(run.draws(f"{q}_typical_person")), spread(run.draws(f"{q}_new")))
        for q in QUANTITIES
    ]
    if run.has(TOGETHER):
        together = spread(run.draws(TOGETHER))
        rows[0] = Levels(OWN_DEPTH, UNITS["K"], together, together, these=True)
    return rows


def sureness(run: PosteriorRun) -> list[dict[str, str]]:
    """For K and for C: the relative half-widths of the intervals and the spreads, as text.

    Of K_secant, in place of a K that is the element's own, none.
    """
    rows = []
    for level in levels(run):
        row = {"quantity": level.quantity}
        if not level.these:
            row |= {"typical": relative(level.typical.factor), "new": relative(level.new.factor)}
            sds = {of: f"sd_{of}_{level.quantity}" for of in ("subject", "trial", "impact")}
            known = {of: run.draws(sd) for of, sd in sds.items() if run.has(sd)}
            row |= {of: relative(np.expm1(np.median(draws))) for of, draws in known.items()}
        rows.append(row)
    return rows


def mass_exponents(run: PosteriorRun, answering: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """For K and for C the mass exponent ``beta``, and the probabilities that it counts as 0 and as 1.

    ``answering`` says by whose exponent, such as that of `COMMON_DEPTH` for K; by their own unless given.
    """
    whose = {quantity: (answering or {}).get(quantity, quantity) for quantity in QUANTITIES}
    return [
        {
            "quantity": quantity,
            "beta": beta,
            "fixed": hypothesis_probability(run, which, FIXED),
            "constant": hypothesis_probability(run, which, CONSTANT),
        }
        for quantity, which in whose.items()
        if (beta := exponent(run, which)) is not None
    ]


_FINE = ("✓", "")
_WORDS = {"subject": ("person", "people"), "trial": ("condition", "conditions")}


def group_words(level: str) -> tuple[str, str]:
    """What one and what several of a grouping's levels are called."""
    return _WORDS.get(level, (f"level of {level}", f"levels of {level}"))


def without_zero(draws: np.ndarray, labels: list[str]) -> list[str]:
    """The labels of the ``draws`` [draw, label] whose 90 % interval has no zero."""
    low, high = np.percentile(draws, [5, 95], axis=0)
    return [label for label, sure in zip(labels, (low > 0) | (high < 0), strict=True) if sure]


def differing(run: PosteriorRun, level: str, quantities: Iterable[str] = QUANTITIES) -> dict[str, list[str]]:
    """Whose effect has a 90 % interval without zero, by quantity (``level``: "subject", "subject:side")."""
    names = {quantity: f"{stem_of(level)}_effect_{quantity}" for quantity in quantities}
    return {q: without_zero(run.draws(name), run.labels(level)) for q, name in names.items() if run.has(name)}


def best_explanations(comparison: pd.DataFrame) -> list[str]:
    """For each scheme: the model that predicts best, those about as good, and the warnings."""
    return [_best(str(scheme), rows) for scheme, rows in comparison.groupby("scheme", sort=False)]


def decides(difference: pd.Series, se: pd.Series) -> pd.Series:
    """Whether differences of expected log predictive density tell two models apart."""
    return (difference.abs() > DECISIVE_SE * se) & (difference.abs() > DECISIVE_NATS)


def _best(scheme: str, rows: pd.DataFrame) -> str:
    ordered = rows.sort_values("elpd", ascending=False)
    others = ordered.iloc[1:]
    close = others[~decides(others["elpd_difference"], others["se_difference"])]
    warnings = ordered.loc[ordered["warning"] != "", "warning"].value_counts()
    warned = [f"{warning} ({count} of {len(ordered)} models)" for warning, count in warnings.items()]
    return worded("fit", "best_explanation", scheme, ordered["model"].iloc[0], list(close["model"]), warned)


def prior_remark(sensitivity: pd.DataFrame) -> str:
    """Which posteriors the sensitivity analysis has something to say about."""
    sensitive = sensitivity[~sensitivity["diagnosis"].isin(_FINE)]
    if sensitive.empty:
        return f"No posterior is sensitive to its prior; looked at: {len(sensitivity)}."
    named = [f"{row['variable']} ({row['diagnosis']})" for row in sensitive.to_dict("records")]
    return Coded.stated("prior-sensitive", count=len(sensitivity), named=listed(named))


def exponent_figure(run: PosteriorRun, quantity: str = "K") -> Figure:
    """The posterior of a mass exponent, with the regions that count as 0 and as 1 in practice."""
    name = SECANTS.get(quantity, quantity)
    rows = run.hypotheses.loc[
        (run.hypotheses["quantity"] == quantity) & run.hypotheses["value"].notna(), ["rope_low", "rope_high"]
    ]
    return histogram(
        run.draws(f"mass_exponent_{quantity}"),
        f"mass exponent of {name} (no unit)",
        said("figures.exponent", name=name),
        lines=(0, 1),
        regions=[(float(low), float(high)) for low, high in rows.to_numpy()],
    )


def effects_figure(run: PosteriorRun, quantity: str, level: str) -> Figure:
    """Each person's (``level`` "subject") or condition's ("trial") effect on K or C, in % of the typical."""
    kind, _ = group_words(level)
    return intervals(
        quantiles(100 * np.expm1(run.draws(f"{level}_effect_{quantity}")), run.labels(level)),
        f"{quantity} off the typical {kind} (%)",
        said("figures.effects", kind=kind, name=NAMES[quantity]),
        lines=(0,),
        straight=True,
    )
