"""What a force beside the deceleration, known springs and the motion say of masses, and what was declared."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import linregress

from bayestissue.base.impact_arrays import PerImpact
from bayestissue.base.outline import first_of
from bayestissue.base.remedies import sentence
from bayestissue.inference.checking.findings import ALL_ROWS, Finding
from bayestissue.inference.checking.model_form import NAMED, SMALL_P
from bayestissue.inference.results.meanings import MOSTLY
from bayestissue.inference.results.summary import prior_overlap
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.force_data import PreparedForce, tells_added_mass
from bayestissue.model.hierarchy.reference import HALF_WIDTH, Reference
from bayestissue.model.hierarchy.responses import intercept, parameter_of
from bayestissue.model.hierarchy.trace_data import Prepared

# Of standard deviations, beyond which a force, or phantoms, contradict what is declared: once in 370.
_LIMIT = 3.0
# Impacts, and a range of log mass, from which on a slope on mass is asked for; how often chance may make one;
# and a slope that is worth a word.
_FEWEST, _LEAST_RANGE, _BY_CHANCE, _LEAST_SLOPE = 6, 0.2, 0.001, 0.01
_INTERVAL = (0.05, 0.5, 0.95)


def judge_force(
    force: PreparedForce, posterior: xr.Dataset, declared_kg: PerImpact, form: dict[str, Any]
) -> dict[str, Any]:
    """The entry ``channels`` of ``diagnostics.json``, of a fit with a force.

    The mean over impacts of a = log F / (M d) has the posterior mean m and standard deviation v, which a wide
    prior leaves to the recordings. With what is declared of the mass and of both gains, D together,
    m / (D^2 + v^2)^1/2 is standard normal under the right declaration.

    Args:
        force: with what is declared of masses and gains.
        posterior: of the fit.
        declared_kg: mass of each impact.
        form: what the force's residuals say, as `bayestissue.inference.checking.model_form.with_impacts`
            has it.

    Returns:
        ``passed``: whether it is below 3, the masses are off by one factor, and the force follows the law of
        the deceleration; ``form`` as it was given, ``follows`` whether its residuals are noise, and
        ``agrees``, of the others; ``slope``, of the log of what each declared mass is to be multiplied by on
        the log of that mass, where it is no chance, else 0: one factor does not put such masses right, and
        the mass exponents are wrong by as much; ``apart``, where ratios differ between impacts, from which
        to which in words; ``ratio``, exp(m); ``ratio_sd``, its relative standard
        deviation; ``declared_sd``, D; ``mass_factor``, its 90 % interval about the median; ``first``, what
        the first line of the run is to say, if anything; ``words``.
    """
    channel, a = force.comparison.channel.name, posterior["log_force_ratio_mean"].to_numpy()
    low, middle, high = np.quantile(posterior["mass_factor"].to_numpy(), _INTERVAL)
    declared = float(np.hypot(force.mass_sd, force.gain_sd))
    mean, sd = float(a.mean()), float(a.std())
    slope = _slope(posterior, declared_kg) if force.share else 0.0
    apart = force.comparison.between if force.comparison.apart.any() else ""
    agrees = abs(mean) <= _LIMIT * np.hypot(declared, sd) and not slope and not apart
    follows = not (form["structured"] or form["impacts"]["structured"])
    account = {
        "channel": channel,
        "agrees": bool(agrees),
        "follows": follows,
        "form": form | {"words": _form_words(channel, form)},
        "slope": slope,
        "apart": apart,
        "ratio": float(np.exp(mean)),
        "ratio_sd": sd,
        "declared_sd": declared,
        "mass_factor": [float(low), float(middle), float(high)],
    }
    first, words = _sentences(account, of_mass=force.mass_sd > 0)
    if not agrees and force.rows.below:
        words = f"{words} {sentence('channels-disagree.below')}"
    # An impact's own mass is put right where one factor is not.
    rows = "mass_exponent.*" if slope and follows else ALL_ROWS
    passed, code = bool(agrees and follows), "force-form" if agrees and not follows else "channels-disagree"
    return Finding(code, passed, words, first, "" if passed else rows).record(**account)


def _sentences(account: dict[str, Any], *, of_mass: bool) -> tuple[str, str]:
    """What the first line of a run says, if anything, and the whole of it."""
    low, middle, high = account["mass_factor"]
    off = account["ratio"] - 1
    numbers = {
        "channel": account["channel"],
        "ratio": f"{account['ratio']:.4g}",
        "declared": f"{100 * account['declared_sd']:.2g} %",
        "size": f"{100 * abs(off):.2g} % {'more' if off > 0 else 'less'}",
        "factor": f"{middle:.4g} ({low:.4g} to {high:.4g})",
        "slope": f"{account['slope']:.2g}",
        "between": account["apart"],
    }
    kinds = {
        "by_mass": account["slope"],
        "apart": account["apart"],
        "contradicted": not account["agrees"],
        "mass": of_mass,
        "exact": True,
    }
    kind = next(name for name, holds in kinds.items() if holds)
    words = sentence(f"channels-disagree.{kind}", **numbers)
    if not account["follows"]:
        return sentence("force-form.first", **numbers), f"{account['form']['words']} {words}"
    says = not account["agrees"] or (of_mass and not low <= 1 <= high)
    return sentence(f"channels-disagree.first.{kind}", **numbers) if says else "", words


def _form_words(channel: str, form: dict[str, Any]) -> str:
    """What the residuals of the force say of it."""
    impacts = form["impacts"]
    numbers = {key: impacts[key] for key in ("below", "tested", "combined")}
    counted = sentence("force-form.counted", small=SMALL_P, **numbers)
    score = sentence("model-form.score", score=form["score"])
    named = f" ({first_of(impacts['names'], NAMED)})" if impacts["names"] else ""
    kind = "form" if form["structured"] or impacts["structured"] else "follows"
    return sentence(f"force-form.{kind}", channel=channel, counted=counted + named, score=score)


def _slope(posterior: xr.Dataset, declared_kg: PerImpact) -> float:
    """Of the log of each impact's mass over the declared one on the log of that; 0 where it may be chance."""
    log_declared, mass = np.log(declared_kg), posterior["mass"].to_numpy()
    if len(declared_kg) < _FEWEST or np.ptp(log_declared) < _LEAST_RANGE:
        return 0.0
    line = linregress(log_declared, np.median(np.log(mass / declared_kg), axis=(0, 1)))
    return float(line.slope) if line.pvalue < _BY_CHANCE and abs(line.slope) > _LEAST_SLOPE else 0.0


def judge_reference(reference: Reference) -> dict[str, Any]:
    """The entry ``reference`` of ``diagnostics.json``, of a fit with phantoms.

    Returns:
        ``passed``: whether what phantoms say of log f is within three standard deviations of 0, that of
        the declared mass counted in; ``mass_factor``, its 90 % interval about the median; ``impacts``, how
        many were of phantoms, and ``phantoms`` their names; ``first``, what the first line of the run says;
        ``words``.
    """
    mean, sd = reference.by_phantoms
    passed = abs(mean) <= _LIMIT * np.hypot(sd, reference.mass_sd)
    low, middle, high = np.exp(reference.log_mean + reference.log_sd * HALF_WIDTH * np.array([-1, 0, 1]))
    off = 100 * (np.exp(-mean) - 1)
    numbers = {
        "size": f"{abs(off):.2g} % {'high' if off > 0 else 'low'}",
        "give": f"{100 * HALF_WIDTH * sd:.2g} %",
        "impacts": len(reference.table),
        "factor": f"{middle:.4g} ({low:.4g} to {high:.4g})",
        "declared": f"{100 * reference.mass_sd:.2g} %",
    }
    words = sentence(f"reference-contradicted.{'corrected' if passed else 'contradicted'}", **numbers)
    first = sentence("reference-contradicted.first", **numbers)
    return Finding("reference-contradicted", passed=bool(passed), words=words, first=first).record(
        impacts=len(reference.table),
        phantoms=reference.table["impact"].astype(str).tolist(),
        mass_factor=[float(low), float(middle), float(high)],
    )


def judge_added_mass(prepared: Prepared, posterior: xr.Dataset, prior: xr.Dataset) -> dict[str, Any]:
    """The entry ``added_mass`` of ``diagnostics.json``; empty where no tissue moves along by the element.

    A deceleration is that of K / (M + m) and C / (M + m), met at V M / (M + m): only its height over V tells
    m, and K and C with it. A force below the tissue is (1 + m / M) M d and tells m by itself.

    Args:
        prepared: the fit.
        posterior: of it.
        prior: of it.

    Returns:
        ``parameter``, m's name; ``by``, what tells it: "force" or "velocity"; ``overlap``, of the posterior
        of its mean over impacts with the prior; ``passed``, whether that is less than half; ``first``, what
        the first line of the run is to say, if anything; ``words``.
    """
    which = element(prepared.model.element)
    if which.added_mass is None:
        return {}
    name = next(one.name for one in which.extra if one.of_mass)
    mean = intercept(parameter_of(name))
    overlap = prior_overlap(posterior[mean].to_numpy(), prior[mean].to_numpy())
    by_force = prepared.force is not None and tells_added_mass(prepared.force, which.name)
    informed = bool(overlap <= MOSTLY)
    low, middle, high = np.quantile(np.exp(posterior[mean].to_numpy()), _INTERVAL)
    numbers = {
        "name": name,
        "overlap": f"{100 * overlap:.0f} %",
        "mass": f"{middle:.2g} kg (90 % interval {low:.2g} to {high:.2g} kg)",
    }
    kind = "prior" if not informed else "force" if by_force else "velocity"
    words = sentence(f"prior-sensitive.{kind}", **numbers)
    words += "" if by_force else f" {sentence('prior-sensitive.remedy')}"
    first = "" if kind == "force" else sentence(f"prior-sensitive.first.{kind}", **numbers)
    by = "force" if by_force else "velocity"
    finding = Finding("prior-sensitive", passed=informed, words=words, first=first)
    return finding.record(parameter=name, by=by, overlap=overlap)
