"""What the first screen says of a fit, in words that follow from the numbers."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayestissue.inference.results.meanings import UNITS
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.groups import differing_words
from bayestissue.reports.pages.fit.method_agreement import (
    apparent_exponent,
    dds_ratio,
    mass_varies,
)
from bayestissue.reports.pages.fit.sentences import SENTENCES, said
from bayestissue.reports.pages.fit.study_answers import equivalence, first_contrasts
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.page_settings import LIMITS, WORTH
from bayestissue.reports.pages.posterior import (
    COMMON_DEPTH,
    CONSTANT,
    FIXED,
    OWN_DEPTH,
    QUANTITIES,
    SURE,
    Levels,
    exponent,
    hypothesis_probability,
    levels,
    spread,
    sureness,
)
from bayestissue.reports.pages.wording import Spread, listed, percent, relative, significant


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


def depth_sentence(run: FitRun) -> Markup:
    """What K's exponent is at each impact's own greatest depth, and why that is another one; empty without.

    That heavier impactors go deeper is read off the recorded displacements.
    """
    deepest = exponent(run, OWN_DEPTH)
    if deepest is None:
        return Markup()
    common = exponent(run, COMMON_DEPTH) if has_common_depth(run) else None
    where = _direction(run, deepest) if common else ""
    one_law = hypothesis_probability(run, COMMON_DEPTH, FIXED) > SURE
    facts = (deepest, common, depth_words(run), where, one_law, bool(run.record.get("discrepancy")))
    return Markup(worded("fit", "depth", *facts))  # noqa: S704 - sentences of the program, and numbers


def _direction(run: FitRun, deepest: Spread) -> str:
    """Where heavier impactors go, if that is what makes the exponent; else empty."""
    depth = np.nanmax(run.groups["observed_data"]["displacement"].to_numpy(), axis=1)
    log_mass = np.log(run.constant("mass_kg")[run.predicted])
    deeper = float(np.cov(log_mass, np.log(depth))[0, 1]) > 0
    if deeper == (deepest.median > 0):
        return "deeper, where it is stiffer" if deeper else "less deep, where it is softer"
    return ""


def further_words(run: FitRun) -> list[str]:
    """What is assumed of the force at the common depth, and what C's exponent is; nothing for other runs."""
    if not run.has(f"mass_exponent_{OWN_DEPTH}"):
        return []
    if not run.record.get("discrepancy"):
        return [said("depth.damper")]
    return [*[said("depth.same_damper")] * has_common_depth(run), said("depth.damper_beside")]


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


def who_sentence(run: FitRun, quantity: str) -> str:
    """What differs, or else K (or C) of new people; of one impact how well its own is known."""
    level, words = level_of(run, quantity), person_words(run)
    if len(run.impacts) == 1:
        return worded("fit", "who_alone", run.symbols[quantity], impact_sureness(run, quantity))
    shaded = bool(compared(run, quantity))
    for contrast in first_contrasts(run):
        if level.quantity in contrast["rows"]:
            near = percent(equivalence(run))
            new = not level.these and not of_each_level(run, quantity)
            return worded("fit", "who_differs", level, words, contrast, near, (SURE, new, shaded))
    return worded("fit", "who", level, words, shaded, _spread_between(run, quantity, "subject"))


def scatter_sentence(run: FitRun, quantity: str) -> str:
    """How well each impact is known, and how impacts of one person and condition scatter."""
    scatter = _spread_between(run, quantity, "impact")
    return worded("fit", "scatter", run.symbols[quantity], impact_sureness(run, quantity), scatter)


def _spread_between(run: FitRun, quantity: str, level: str) -> str:
    """By how much K (or C) differs between levels, as "±23 %"; empty where the model does not have that."""
    return next(row for row in sureness(run) if row["quantity"] == run.symbols[quantity]).get(level, "")


def mass_sentence(run: FitRun, quantity: str) -> str:
    """Whether K (or C) depends on the mass, and what the thesis's method finds in the same recordings."""
    which = answering(run)[quantity]
    # Beside a discrepancy the picture has K at each impact's own greatest depth.
    drawn = exponent(run, OWN_DEPTH) if run.element_alone and which == COMMON_DEPTH else None
    exponents = (exponent(run, which), drawn, apparent_exponent(run, quantity))
    probabilities = [hypothesis_probability(run, which, name) for name in (FIXED, CONSTANT)]
    what = f"K at {depth_words(run)}" if which == COMMON_DEPTH else run.symbols[quantity]
    made = made_by_method(run, quantity)
    return worded("fit", "mass_at_once", what, exponents, probabilities, made, SURE)


def secant_sentence(run: FitRun) -> str:
    """What K_secant is beside the element's own K; empty of other runs."""
    return said("model.secant") if run.element_alone else ""


def averaged_over(run: FitRun, variable: str) -> str:
    """The columns that a variable is averaged over; empty where none."""
    return str(run.groups["posterior"][variable].attrs.get("averaged_over", ""))


def averaged_sentence(run: FitRun, *, by_level: bool = True) -> str:
    """A sentence on what a typical or new person is averaged over, ``by_level`` with K and C by category."""
    over = averaged_over(run, "C_new" if run.element_alone else "K_new")
    levels = {}
    for name in over.split(" and ") if over and by_level else ():
        variables = {q: variable for q in QUANTITIES if (variable := run.of_levels(q, name))}
        if not variables or len(run.labels(name)) > LIMITS.categories:
            continue
        levels[name] = {
            label: [(q, UNITS[q], spread(run.draws(variable)[:, at])) for q, variable in variables.items()]
            for at, label in enumerate(run.labels(name))
        }
    return worded("fit", "averaged", over, levels)


def impact_sureness(run: FitRun, quantity: str) -> str:
    """How closely the median impact's own K (K_secant, C) is known, as "±0.8 %": half its 90 % interval."""
    table = run.of_impacts(quantity)
    return relative(float(np.sqrt((table["eti90_high"] / table["eti90_low"]).median()) - 1))


def method_sentence(run: FitRun) -> str:
    """How the thesis's point estimates compare in size with the posterior."""
    ratios = [f"{significant(dds_ratio(run, q), 2)} times this {run.symbols[q]}" for q in QUANTITIES]
    return f"The thesis's method gives {listed(ratios)} on the same traces (median impact)."


def mass_conclusion(run: FitRun) -> str:
    """Whether K and C depend on the mass, by the hypotheses; and whether people differ in it where asked."""
    by = answering(run)
    exponents = [
        {
            "quantity": q,
            "beta": beta,
            "fixed": hypothesis_probability(run, by[q], FIXED),
            "constant": hypothesis_probability(run, by[q], CONSTANT),
        }
        for q in QUANTITIES
        if (beta := exponent(run, by[q])) is not None
    ]
    typical = worded("fit", "mass", mass_varies(run), exponents, SURE)
    return f"{typical} {differing_words(run)}".strip()


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
