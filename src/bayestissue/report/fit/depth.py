"""K's dependence on the mass where K depends on depth: at one depth, and at each impact's greatest depth."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayestissue.report.fit.run import FitRun
from bayestissue.report.posterior import (
    COMMON_DEPTH,
    FIXED,
    OWN_DEPTH,
    QUANTITIES,
    SURE,
    Spread,
    exponent,
    hypothesis_probability,
)
from bayestissue.report.wording import significant

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
    return {q: COMMON_DEPTH if q == "K" and has_common_depth(run) else q for q in QUANTITIES}


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
