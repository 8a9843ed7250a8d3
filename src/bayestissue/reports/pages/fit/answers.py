"""What the first screen says of a fit, in words that follow from the numbers."""

from __future__ import annotations

import numpy as np

from bayestissue.inference.results.meanings import UNITS
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.method_agreement import apparent_exponent
from bayestissue.reports.pages.fit.study_answers import first_contrasts
from bayestissue.reports.pages.page_settings import LIMITS, WORTH
from bayestissue.reports.pages.posterior import (
    COMMON_DEPTH,
    FIXED,
    OWN_DEPTH,
    QUANTITIES,
    SURE,
    Levels,
    Quantity,
    exponent,
    hypothesis_probability,
    levels,
    spread,
    sureness,
)
from bayestissue.reports.pages.wording import SENTENCES, Spread, relative, significant


def has_common_depth(run: FitRun) -> bool:
    """Whether the run tells K's mass exponent at a depth that all impacts reach."""
    return run.has(f"mass_exponent_{COMMON_DEPTH}") and "common_depth_m" in run.groups["constant_data"]


def answering(run: FitRun) -> dict[str, str]:
    """For K and for C, by whose mass exponent the page answers: K's is that at a common depth, if any."""
    return run.symbols | ({"K": COMMON_DEPTH} if has_common_depth(run) else {})


def depth_words(run: FitRun) -> str:
    """The common depth, as "6.9 mm"; empty where K does not depend on depth."""
    if not has_common_depth(run):
        return ""
    return f"{significant(1e3 * float(run.constant('common_depth_m')), 2)}\N{NO-BREAK SPACE}mm"


def direction(run: FitRun, deepest: Spread) -> str:
    """Where heavier impactors go, if that is what makes the exponent; else empty."""
    depth = np.nanmax(run.groups["observed_data"]["displacement"].to_numpy(), axis=1)
    log_mass = np.log(run.constant("mass_kg")[run.predicted])
    deeper = float(np.cov(log_mass, np.log(depth))[0, 1]) > 0
    if deeper == (deepest.median > 0):
        return "deeper, where it is stiffer" if deeper else "less deep, where it is softer"
    return ""


def person_words(run: FitRun) -> dict[str, str]:
    """Who the intervals are of, in words: a "typical" and a "new" one, and who stands in a "condition"."""
    return dict(SENTENCES["one_person" if run.people_count == 1 else "people"])


def level_of(run: FitRun, quantity: str) -> Levels:
    """K (or C) of a typical person and of a new one, of K beside a discrepancy K_secant of these impacts."""
    return levels(run)[QUANTITIES.index(quantity)]


def of_each_level(run: FitRun, quantity: str) -> tuple[str, ...]:
    """K (or C) of each pad that one tower hits, or the like, and how sure they are at least; else nothing.

    Their mean is nobody's.
    """
    factor = next(iter(run.levels["factor"]), "")
    variable = run.of_levels(quantity, factor)
    if run.people_count > 1 or not variable:
        return ()
    spreads = [spread(draws) for draws in run.draws(variable).T]
    labels = zip(run.labels(factor), spreads, strict=True)
    shown = (f"{label}\N{NO-BREAK SPACE}{significant(one.median)}" for label, one in labels)
    return ", ".join(shown), relative(max(one.factor for one in spreads))


def only_impact(run: FitRun, quantity: str) -> Spread:
    """K (or C) of the impact of a run that has one."""
    ends = ["median", "eti90_low", "eti90_high"]
    return Spread(*run.estimates_by_method[quantity][ends].to_numpy()[0])


def compared(run: FitRun, quantity: str) -> list[tuple[str, str]]:
    """Whose K (or C) the first picture has: dimensions, people the last, each with its variable."""
    factors = [*run.levels["factor"], *(one["factor"] for one in first_contrasts(run))]
    people = ["subject"] * (run.people_count > 1)
    dimensions = [*[*dict.fromkeys(factors)][: LIMITS.comparisons], *people]
    return [(name, variable) for name in dimensions if (variable := run.of_levels(quantity, name))]


def spread_between(run: FitRun, quantity: str, level: str) -> str:
    """By how much K (or C) differs between levels, as "±23 %"; empty where the model does not have that."""
    return next(row for row in sureness(run) if row["quantity"] == run.symbols[quantity]).get(level, "")


def averaged_over(run: FitRun) -> str:
    """The columns that a typical or new person is averaged over, such as "side and pad"; empty where none."""
    variable = run.groups["posterior"]["C_new" if run.element_alone else "K_new"]
    return str(variable.attrs.get("averaged_over", ""))


def averaged_levels(run: FitRun) -> dict[str, dict[str, list[tuple[Quantity, str, Spread]]]]:
    """K and C of a typical person by the levels of each column that it is averaged over, of few levels."""
    levels = {}
    for name in averaged_over(run).split(" and "):
        variables = {q: variable for q in QUANTITIES if (variable := run.of_levels(q, name))}
        if variables and len(run.labels(name)) <= LIMITS.categories:
            levels[name] = {
                label: [
                    (q, UNITS[q], spread(run.draws(variable)[:, at])) for q, variable in variables.items()
                ]
                for at, label in enumerate(run.labels(name))
            }
    return levels


def impact_sureness(run: FitRun, quantity: str) -> str:
    """How closely the median impact's own K (K_secant, C) is known, as "±0.8 %": half its 90 % interval."""
    table = run.of_impacts(quantity)
    return relative(float(np.sqrt((table["eti90_high"] / table["eti90_low"]).median()) - 1))


def made_by_method(run: FitRun, quantity: str) -> bool:
    """Whether the thesis's method makes a trend of K (or C) over the mass that the tissue does not have."""
    # The thesis's K is force over depth too, and no common depth's.
    name = OWN_DEPTH if quantity == "K" and exponent(run, OWN_DEPTH) is not None else quantity
    apparent, beta = apparent_exponent(run, quantity), exponent(run, name)
    if apparent is None or beta is None:
        return False
    slope = apparent.slope
    return (
        hypothesis_probability(run, name, FIXED) > SURE
        and not slope.holds(0)
        and abs(slope.median) > WORTH.slope
        and (slope.low > beta.high or slope.high < beta.low)
    )
