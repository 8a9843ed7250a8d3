"""What the first screen says of a fit, in words that follow from the numbers."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayestissue.inference.results.meanings import UNITS
from bayestissue.report.fit.estimates import apparent_exponent, dds_ratio, held_by_intervals, mass_varies
from bayestissue.report.fit.population import differing_words
from bayestissue.report.fit.run import FitRun
from bayestissue.report.posterior import (
    COMMON_DEPTH,
    CONSTANT,
    FIXED,
    OWN_DEPTH,
    QUANTITIES,
    SURE,
    Spread,
    exponent,
    hypothesis_probability,
    spread,
)
from bayestissue.report.wording import likelihood_words, listed, relative, significant

_SECANT = (
    "It is force over depth at the greatest depth, the tissue's stiffness; K in tables is the element's own "
    "part of the force."
)
_ASSUMED = (
    "Beside a discrepancy the damper's part of the force at that depth is told by the force's slope at the "
    "greatest depth, where the velocity is 0. It is assumed that the damper is the same at all depths."
)
_IF = ", if the damper is the same at all depths"
_OWN_ALONE = Markup(
    "K is force over depth at each impact's own greatest depth: where heavier impactors go deeper, depth "
    "alone may make its exponent, and C's. These traces do not tell K at one depth that all impacts reach."
)
_OTHER_DAMPER = (
    "C is the damping constant of the element beside the discrepancy: where the tissue's damping depends on "
    "depth, depth has a part in C's exponent."
)
_DAMPER = "C's exponent is that of the damping constant in the element's law, so the depth has no part in it."


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
    common, deepest = exponent(run, COMMON_DEPTH), exponent(run, OWN_DEPTH)
    if deepest is None:
        return Markup()
    if not has_common_depth(run) or common is None:
        return _OWN_ALONE
    sentence = Markup(
        "Here K is force over depth at {}, which every impact reaches{}. At each impact's own greatest depth "
        "K ∝ M<sup>{}</sup> ({})."
    ).format(depth_words(run), _IF if run.record.get("discrepancy") else "", deepest.value, deepest.range)
    return (sentence + " " + _explanation(run, common, deepest)).strip()


def _explanation(run: FitRun, common: Spread, deepest: Spread) -> Markup:
    where = _direction(run, deepest)
    if deepest.holds(0) or not where:
        return Markup()
    if not common.holds(0):
        said = f"Heavier impactors go {where}, but the law itself differs between the masses too."
    elif hypothesis_probability(run, COMMON_DEPTH, FIXED) > SURE:
        said = f"The tissue's law is the same for every mass: heavier impactors go {where}."
    else:
        said = f"One law of the tissue for every mass explains this: heavier impactors go {where}."
    return Markup(said)  # noqa: S704 - words of this module alone


def _direction(run: FitRun, deepest: Spread) -> str:
    """Where heavier impactors go, if that is what makes the exponent; else empty."""
    depth = np.nanmax(run.groups["observed_data"]["displacement"].to_numpy(), axis=1)
    log_mass = np.log(run.constant("mass_kg"))
    deeper = float(np.cov(log_mass, np.log(depth))[0, 1]) > 0
    if deeper == (deepest.median > 0):
        return "deeper, where it is stiffer" if deeper else "less deep, where it is softer"
    return ""


def further_words(run: FitRun) -> list[str]:
    """What is assumed of the force at the common depth, and what C's exponent is; nothing for other runs."""
    if not run.has(f"mass_exponent_{OWN_DEPTH}"):
        return []
    if not run.record.get("discrepancy"):
        return [_DAMPER]
    return [_ASSUMED, _OTHER_DAMPER] if has_common_depth(run) else [_OTHER_DAMPER]


# A slope of the point estimates this far off zero is spoken of, if its interval excludes zero too.
_WORTH_A_WORD = 0.1
# As many as a card can show.
_MOST_CATEGORIES = 4


def person_words(run: FitRun) -> dict[str, str]:
    """Who the intervals are of, in words: a "typical" and a "new" one, and who stands in a "condition"."""
    if run.people_count == 1:
        return {"typical": "this person", "new": "new impact", "new_impact": "A new impact on this person"}
    return {
        "typical": "typical person",
        "new": "new person",
        "new_impact": "A new impact on a new person",
    }


def the_only_impact(run: FitRun) -> list[tuple[str, str, Spread]]:
    """K and C of a single impact, each with its unit; empty where there are several impacts."""
    if len(run.impacts) > 1:
        return []
    ends = ["median", "eti90_low", "eti90_high"]
    return [
        (run.symbols[q], UNITS[q], Spread(*table[ends].to_numpy()[0]))
        for q, table in run.side_by_side.items()
    ]


def secant_sentence(run: FitRun) -> str:
    """What K_secant is beside the element's own K; empty of other runs."""
    return _SECANT if run.element_alone else ""


def averaged_over(run: FitRun, variable: str) -> str:
    """The columns that a variable is averaged over; empty where none, or an earlier version made it."""
    return str(run.groups["posterior"][variable].attrs.get("averaged_over", ""))


def averaged_sentence(run: FitRun, *, by_level: bool = True) -> str:
    """A sentence on what a typical or new person is averaged over, ``by_level`` with K and C by category."""
    over = averaged_over(run, "C_new" if run.element_alone else "K_new")
    if not over:
        return ""
    sentences = [f"Averaged over {over}, each level with equal weight."]
    for name in over.split(" and ") if by_level else ():
        variables = {q: variable for q in QUANTITIES if (variable := run.of_levels(q, name))}
        if not variables or len(run.labels(name)) > _MOST_CATEGORIES:
            continue
        levels = []
        for index, label in enumerate(run.labels(name)):
            spreads = {q: spread(run.draws(variable)[:, index]) for q, variable in variables.items()}
            values = [f"{q} {value.value} {UNITS[q]} ({value.range})" for q, value in spreads.items()]
            levels.append(f"{label} {listed(values)}")
        sentences.append(f"By {name}, of a typical person: {'; '.join(levels)}.")
    return " ".join(sentences)


def impact_sureness(run: FitRun, quantity: str) -> str:
    """How closely the median impact's own K (K_secant, C) is known, as "±0.8 %": half its 90 % interval."""
    table = run.of_impacts(quantity)
    return relative(float(np.sqrt((table["eti90_high"] / table["eti90_low"]).median()) - 1))


def held_sentence(run: FitRun) -> str:
    """For simulated data, how many 90 % intervals hold the truth; empty otherwise."""
    intervals = [one for quantity in QUANTITIES for one in held_by_intervals(run, quantity)]
    parts = [f"{one.held} of {one.impacts} for {one.quantity}" for one in intervals if one.level == 90]
    return f"Simulated data: the 90 % intervals hold the true value in {listed(parts)}." if parts else ""


def method_sentence(run: FitRun) -> str:
    """How the thesis's point estimates compare in size with the posterior."""
    ratios = [f"{significant(dds_ratio(run, q), 2)} times this {run.symbols[q]}" for q in QUANTITIES]
    return f"The thesis's method gives {listed(ratios)} on the same traces (median impact)."


def mass_conclusion(run: FitRun) -> str:
    """Whether K and C depend on the mass, and whether people differ in it where the model asks."""
    return f"{_typical_conclusion(run)} {differing_words(run)}".strip()


def _typical_conclusion(run: FitRun) -> str:
    """Whether K and C of a typical person depend on it, by the probabilities of the hypotheses."""
    if not mass_varies(run):
        return "The mass of the impactor never varies here, so nothing can be said of its part."
    if exponent(run, "K") is None and exponent(run, "C") is None:
        return "This model has no mass exponent, so it can't tell whether K and C depend on the mass."
    by = answering(run)
    fixed = {
        q: hypothesis_probability(run, by[q], FIXED) for q in QUANTITIES if exponent(run, by[q]) is not None
    }
    if min(fixed.values()) > SURE and len(fixed) > 1:
        word = likelihood_words(min(fixed.values()))
        return f"No dependence: {word} neither K nor C depends on the mass in practice."
    return " ".join(_one_conclusion(run, quantity) for quantity in fixed)


def _one_conclusion(run: FitRun, quantity: str) -> str:
    which = answering(run)[quantity]
    beta = exponent(run, which)
    fixed = hypothesis_probability(run, which, FIXED)
    constant = hypothesis_probability(run, which, CONSTANT)
    if beta is None:
        return ""
    if fixed > SURE:
        return f"{quantity} {likelihood_words(fixed)} does not depend on the mass in practice."
    if constant > SURE:
        return (
            f"{quantity} {likelihood_words(constant)} grows in proportion to the mass: what a method gives "
            "whose ωₙ carries no information on the tissue."
        )
    if beta.holds(0):
        also = " or from proportion to the mass" if beta.holds(1) else ""
        return f"{quantity}: not told from no dependence on the mass{also}."
    return f"{quantity} {'grows' if beta.low > 0 else 'falls'} with the mass."


def contrast_sentence(run: FitRun) -> Markup:
    """What the thesis's point estimates of the same traces show, and where that is the method's making."""
    apparent = {quantity: apparent_exponent(run, quantity) for quantity in QUANTITIES}
    shown = [
        Markup("{} ∝ M<sup>{}</sup> ({})").format(quantity, line.slope.value, line.slope.range)
        for quantity, line in apparent.items()
        if line
    ]
    if not shown:
        return Markup()
    artefacts: list[str] = [quantity for quantity in QUANTITIES if _made_by_method(run, quantity)]
    blame = f": the trend of {listed(artefacts)} is made by the method" if artefacts else ""
    return Markup("Thesis's method on the same traces: {}{}.").format(Markup(", ").join(shown), blame)


def _made_by_method(run: FitRun, quantity: str) -> bool:
    # The thesis's K is force over depth too, and no common depth's.
    name = OWN_DEPTH if quantity == "K" and exponent(run, OWN_DEPTH) is not None else quantity
    apparent, beta = apparent_exponent(run, quantity), exponent(run, name)
    if apparent is None or beta is None:
        return False
    slope = apparent.slope
    return (
        hypothesis_probability(run, name, FIXED) > SURE
        and not slope.holds(0)
        and abs(slope.median) > _WORTH_A_WORD
        and (slope.low > beta.high or slope.high < beta.low)
    )
