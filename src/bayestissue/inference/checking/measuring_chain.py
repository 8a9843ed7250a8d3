"""Outlier test of the measuring chain's errors: each estimated from its trace alone, and standardised.

An error e of velocity and gain together, or of the offset, is estimated from an impact's trace with its
declared standard deviation s taken away: a normal so wide that it says nothing stands in its place, and all
else stays as it was. With t the standard deviation of the estimate,

    z = e / (s^2 + t^2)^1/2

is standard normal under the right model, and independent from impact to impact, since nothing in it comes
from the population. (The posterior's own mean of e is e s^2 / (s^2 + t^2) at most, pulled to 0 by what was
declared, and where e is far out the noise takes up a part of it besides: it alarms later.) In 4000 simulated
impacts z had the mean -0.01 and the standard deviation 1.02 by the likelihood "impact", 0.00 and 0.88 by
"arma".

A gain that errs alike in all impacts is no error of each: they are judged at the gain that all recordings
together tell, if that is credible by what was declared, or else at the declared one.

A wrong mass does not show: it makes K and C of an impact wrong by one factor, and its trace no other.

Whether z are credible together is asked with a known rate of false alarms. Four kinds of departure from
independent standard normals are looked for, each with the same share of the whole rate, by Bonferroni's
inequality: a mean of all impacts away from 0, one of a group (all impacts of a person, or of a condition), a
single impact far out, and a sum of squares too great for chi-square. A mean is to be `LEAST_SHIFT` at least
and a root mean square `LEAST_SPREAD`: where impacts are many, less of either is sure too, but does little to
intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jax import Array
from jaxtyping import Bool, Float
from scipy.stats import chi2, norm

from bayestissue.base.impact_arrays import (
    IndexPerImpact,
    JaxPerParameter,
    MaskPerImpact,
    PerImpact,
    PerParameter,
)
from bayestissue.base.outline import first_of
from bayestissue.base.remedies import sentence
from bayestissue.inference.checking.findings import ALL_ROWS, Finding
from bayestissue.inference.checking.model_form import LIMIT, judged_at
from bayestissue.inference.execution.compiling import by_row, padded
from bayestissue.inference.execution.kept import some_impacts, some_of
from bayestissue.inference.factors.conditional import ConditionalPrior
from bayestissue.inference.factors.expansions import first_guess, laplace_of_all, rows_of
from bayestissue.inference.factors.sites import weak_prior
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.priors import Normal, normal
from bayestissue.model.hierarchy.responses import intercept
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import (
    GAIN,
    TraceData,
    TraceModel,
    trace_likelihood,
    with_normal_errors,
)

AMPLITUDE, OFFSET, CONTACT = "velocity and gain", "offset", "contact"
# Errors that are judged; contact, whose error is not normal, can only turn out to explain what they show.
JUDGED = (AMPLITUDE, OFFSET)
_COLUMN = {
    AMPLITUDE: ("velocity_error", "ramp_error"),
    OFFSET: ("offset_error",),
    CONTACT: ("contact_time_error", "level_error"),
}
_DRAWS = 64
# Of a normal's draws none is this many median deviations off: five standard deviations.
_FARTHEST = 8.0
# Of log likelihood, e to the power of 10 to 1; and a share of what the best account explains: errors are
# taken to first order, and of velocities 6 to 10 % off a zero explained as much as they, or up to 16 % more.
_CLEAR, _CLEAR_SHARE = 10.0, 0.2
# Of the velocity, of the mean deceleration and of the time to peak: wider than any error that is one.
_WIDE = {AMPLITUDE: 0.5, OFFSET: 1.0, CONTACT: 0.3}
_MOST_NAMED = 12
_GROUPS = ("trial", "subject")
# Of false alarms, over everything that is looked at.
RATE = 0.005
# An interval that rests on nothing but a normal error holds 86 % where that error's mean is half its standard
# deviation off, and 75 % where it is half as wide again as declared.
LEAST_SHIFT = 0.5
LEAST_SPREAD = 1.5
ALL, IMPACT, SCATTER = "all", "impact", "scatter"

# By kind ("subject", "trial"), the number of each impact's group, from 0.
Groups = Mapping[str, IndexPerImpact]


def alarms(z: PerImpact, groups: Groups, rate: float = RATE) -> dict[str, Bool[np.ndarray, " group"]]:
    """Which departures of ``z`` from independent standard normals are incredible.

    Args:
        z: standardised errors.
        groups: of the impacts.
        rate: at most this share of right models raises any alarm.

    Returns:
        `ALL`, of their mean; by kind of group, of the mean of each of its groups; `IMPACT`, of each by
        itself; `SCATTER`, of their sum of squares.
    """
    count, share = len(z), rate / (3 + len(groups))
    raised = {ALL: _shifted(z, np.zeros(count, int), share)}
    for kind, codes in groups.items():
        size = np.bincount(codes)
        # One group is all impacts, and a group of one impact that impact.
        raised[kind] = _shifted(z, codes, share) & (size > 1) & (len(size) > 1)
    raised[IMPACT] = np.abs(z) > norm.isf(share / (2 * count))
    raised[SCATTER] = np.array([(z**2).sum() > max(chi2.isf(share, count), LEAST_SPREAD**2 * count)])
    return raised


def alarmed(z: PerImpact, groups: Groups, rate: float = RATE) -> bool:
    """Whether anything of ``z`` is incredible: see `alarms`."""
    return any(flags.any() for flags in alarms(z, groups, rate).values())


def _shifted(z: PerImpact, codes: IndexPerImpact, rate: float) -> Bool[np.ndarray, " group"]:
    """Of each group whether the mean is incredibly far from 0."""
    size = np.bincount(codes)
    mean = np.bincount(codes, weights=z) / np.maximum(size, 1)
    limit = norm.isf(rate / (2 * len(size))) / np.sqrt(np.maximum(size, 1))
    return np.abs(mean) > np.maximum(limit, LEAST_SHIFT)


@dataclass(frozen=True)
class ErrorPattern:
    """The simplest account of incredible errors.

    Attributes:
        kind: `ALL`, a kind of group, or `IMPACT`.
        impacts: which are concerned.
        common: whether those of a group (or all of them) share one factor.
    """

    kind: str
    impacts: MaskPerImpact
    common: bool


def pattern_of(
    error: PerImpact, sd: PerImpact, unit: PerImpact, groups: Groups, rate: float = RATE
) -> ErrorPattern | None:
    """What impacts' errors have in common, if they are incredible: None if they are not.

    One factor of all impacts is the simplest, then one of each of some groups, which after it is taken off
    leaves nothing incredible; then single impacts.

    Args:
        error: of each impact.
        sd: what its standard deviation would be under the right model.
        unit: what a common factor multiplies, such as the velocity.
        groups: as of `alarms`.
        rate: as of `alarms`.
    """
    raised = alarms(error / sd, groups, rate)
    if not any(flags.any() for flags in raised.values()):
        return None
    for kind, codes in {ALL: np.zeros(len(error), int), **groups}.items():
        weight = np.bincount(codes, weights=unit**2 / sd**2)
        factor = np.bincount(codes, weights=error * unit / sd**2) / np.maximum(weight, 1e-300)
        concerned = raised[kind][codes]
        left = error - np.where(concerned, factor[codes] * unit, 0.0)
        if concerned.any() and not alarmed(left / sd, groups, rate):
            return ErrorPattern(kind, concerned, common=True)
    if raised[IMPACT].any():
        return ErrorPattern(IMPACT, raised[IMPACT], common=False)
    return ErrorPattern(ALL, np.ones(len(error), bool), common=False)


@dataclass(frozen=True)
class ErrorEstimate:
    """One error of the chain as the traces have it, each [impact].

    Attributes:
        error: true less stated velocity [m/s], the gain's error times the velocity counted in; or the
            offset [m/s^2]; or the contact time [s].
        sd: of that estimate, t.
        declared: standard deviation as declared, s.
        unit: the velocity, the mean deceleration or the time to peak, to which ``error`` is relative.
        centre: the impact's parameters, [impact, parameter], with this error free.
        gain: in log likelihood over as declared, what the wide normal takes off wherever the error lies
            put back.
    """

    error: PerImpact
    sd: PerImpact
    declared: PerImpact
    unit: PerImpact
    centre: PerParameter
    gain: PerImpact

    @property
    def expected_sd(self) -> PerImpact:
        """Of ``error``, where the model is right: (s^2 + t^2)^1/2."""
        return np.hypot(self.sd, self.declared)

    @property
    def z(self) -> PerImpact:
        """The standardised error, no farther from 0 than what it gains in likelihood allows.

        Of a normal likelihood the gain is z^2 / 2. One that has a long tail, as where an element's further
        parameters and the velocity do much the same, gains less than its bend at the top promises.
        """
        size = np.minimum(np.abs(self.error) / self.expected_sd, np.sqrt(2 * np.maximum(self.gain, 0.0)))
        return np.sign(self.error) * size

    def pattern(self, groups: Groups) -> ErrorPattern | None:
        """What the impacts' errors have in common: see `pattern_of`."""
        # An error without a z has no weight either.
        sd = np.maximum(np.abs(self.error) / np.maximum(np.abs(self.z), 1e-6), self.expected_sd)
        return pattern_of(self.error, sd, self.unit, groups, RATE / len(JUDGED))

    def relative(self, impacts: MaskPerImpact) -> PerImpact:
        """The error of some impacts over its unit."""
        return (self.error / self.unit)[impacts]


def common_gain(prepared: Prepared, posterior: xr.DataTree) -> Normal | None:
    """The log of the gain that all impacts share, as they are judged at it; None where each has its own.

    It is the fit's, if its distance from 0 is credible by what was declared of it. What the recordings alone
    say of it, m with a standard deviation t, is the posterior less the prior.
    """
    if not prepared.model.gain:
        return None
    declared, drawn = prepared.model.priors.log_gain, posterior["posterior"][intercept(GAIN)].to_numpy()
    precision = 1 / drawn.var()
    gained = precision - declared.sd**-2
    if gained > 0:
        z = drawn.mean() * precision / gained / np.hypot(declared.sd, gained**-0.5)
        # As rarely as any one of the departures that `alarms` looks for, on either side.
        if abs(z) > norm.isf(RATE / len(JUDGED) / (3 + len(_GROUPS)) / 2):
            return declared
    return normal(float(drawn.mean()), float(drawn.std()))


def judge(
    prepared: Prepared, expansions: GaussianFactor | None = None, log_gain: Normal | None = None
) -> dict[str, Any]:
    """The entry ``measuring_chain`` of ``diagnostics.json``.

    Args:
        prepared: a model of recorded decelerations, without a discrepancy, and its data; of many impacts
            some are asked.
        expansions: `expanded` of the same, if it is at hand; of impacts that share a gain none are used.
        log_gain: of the gain that all impacts share, see `common_gain`; left out, as declared.

    Returns:
        Nothing of an element with further parameters, which may do much the same to a trace as another
        velocity (of twenty good impacts on a standard linear solid z had a root mean square of 1.4); nor
        where displacements are measured from their own mean, which makes K and C wrong by itself.
        Else ``passed`` and ``of`` how many impacts. If it is not true: ``error``, which the traces
        contradict; ``alike``, others that explain them as well or nearly, and their size; the ``kind`` of
        `ErrorPattern`, whether one factor is ``common``, and the names of ``groups`` and ``impacts``;
        ``relative``, to the velocity, the mean deceleration or the time to peak (median there, and
        ``greatest``); ``declared_sds``, how many of them that is (median; None where none was declared);
        ``change_K`` and ``change_C``, with the error as the traces have it, over as declared, less 1
        (medians); ``structure_left`` and ``words``. ``passed`` is None where decelerations stay structured
        even so: what the traces then ask of the chain may be the tissue's law.
    """
    # The rate of false alarms is known of a spring and damper side by side alone.
    if prepared.model.element != SIDE_BY_SIDE or prepared.model.discrepancy:
        return {}
    rows = some_impacts(len(prepared.impacts))
    prepared = some_of(prepared, rows)
    groups = {kind: pd.factorize(prepared.impacts[kind].astype(str))[0] for kind in _GROUPS}
    log_gain = log_gain or prepared.model.priors.log_gain
    if expansions is None or prepared.model.gain:
        expansions = _at_gain(prepared, with_normal_errors(prepared.data), log_gain)[0]
    else:
        expansions = rows_of(expansions, rows)
    errors: dict[str, ErrorEstimate] = {}
    patterns: dict[str, ErrorPattern] = {}
    for name in (*JUDGED, CONTACT):
        if name == CONTACT and not patterns:
            return {"passed": True, "of": len(prepared.impacts)}
        errors[name] = estimated_error(prepared, name, expansions, log_gain)
        if pattern := errors[name].pattern(groups):
            patterns[name] = pattern
    return _contradiction(prepared, expansions, errors, patterns)


def _at_gain(
    prepared: Prepared, data: TraceData, log_gain: Normal
) -> tuple[GaussianFactor, ConditionalPrior]:
    """Expansions of these traces, errors normal, at a gain that all impacts share, and the prior used.

    Their logs are with the gain integrated out, by Laplace's method.
    """
    model, start = prepared.model, first_guess(prepared)
    prior = weak_prior(start)
    if not model.gain:
        return laplace_of_all(model, data, start, prior), prior
    number = model.parameters.index(GAIN)
    start[:, number] = log_gain.mean
    prior.precision[number, number] = log_gain.sd**-2
    sites = laplace_of_all(model, data, start, prior)
    off, bend = (sites.centre[:, number] - log_gain.mean) / log_gain.sd, sites.precision[:, number, number]
    lost = off**2 + np.log1p(log_gain.sd**2 * bend)
    return sites._replace(log_scale=sites.log_scale - lost / 2), prior


def estimated_error(
    prepared: Prepared, name: str, expansions: GaussianFactor | None = None, log_gain: Normal | None = None
) -> ErrorEstimate:
    """One error of the chain, its declared standard deviation taken away.

    Args:
        prepared: the model and its data.
        name: `AMPLITUDE`, `OFFSET` or `CONTACT`.
        expansions: of the same, if they are at hand: see `judge`.
        log_gain: as of `judge`.
    """
    data, of_chain = with_normal_errors(prepared.data), [*prepared.data.record.errors]
    column = next(number for number, error in enumerate(of_chain) if error in _COLUMN[name])
    sign = -1.0 if of_chain[column] == "ramp_error" else 1.0
    sd = np.asarray(data.record.error_sd)
    unit, declared = _unit(prepared, name), sd[:, column]
    log_gain = log_gain or prepared.model.priors.log_gain
    wide = np.where(np.arange(sd.shape[1]) == column, _WIDE[name] * unit[:, None], sd)
    before = _at_gain(prepared, data, log_gain)[0] if expansions is None else expansions
    if name == AMPLITUDE and prepared.model.gain:
        declared = np.hypot(declared, log_gain.sd * unit)
    data = replace(data, record=data.record._replace(error_sd=jnp.asarray(wide)))
    sites, prior = _at_gain(prepared, data, log_gain)
    centre = np.asarray(sites.centre)
    root = np.linalg.cholesky(np.linalg.inv(np.asarray(sites.precision) + prior.precision))
    z = np.random.default_rng(0).standard_normal((_DRAWS, *centre.shape))
    u = centre + np.einsum("iab,dib->dia", root, z)
    keys = jax.random.split(jax.random.PRNGKey(0), _DRAWS)
    # The chain's errors come last.
    errors = sign * _errors(prepared.model, data, u, keys)[..., column - sd.shape[1]]
    # Where velocity and K do nearly the same to a trace the normal that is drawn from is wide, and one draw
    # may lie where no impact is: its error is none, or thousands of times the others'.
    drawn = np.ma.masked_invalid(errors)
    error = np.ma.median(drawn, axis=0).filled(np.nan)
    farthest = _FARTHEST * np.ma.median(np.abs(drawn - error), axis=0).filled(np.nan)
    near = drawn.clip(error - farthest, error + farthest)
    # Undeclared and known without an error there would be nothing to divide by.
    spread = np.maximum(np.ma.filled(near.std(axis=0), np.nan), 1e-12 * unit)
    # With an error so wide a normal likelihood is z^2 / 2 - log(wide / expected sd) above that as declared.
    occam = np.log(_WIDE[name] * unit / np.hypot(spread, declared))
    gain = np.asarray(sites.log_scale) + occam - np.asarray(before.log_scale)
    return ErrorEstimate(error, spread, declared, unit, centre, gain)


def _unit(prepared: Prepared, name: str) -> PerImpact:
    signal = prepared.signal
    if name == AMPLITUDE:
        return signal.velocity
    if name == OFFSET:
        return signal.velocity / signal.time_to_peak
    is_time = "contact_time_error" in prepared.data.record.errors
    return signal.time_to_peak * (1.0 if is_time else signal.velocity)


@padded(1, None)
@by_row(_DRAWS, constant=2)
def _errors(
    model: TraceModel, data: TraceData, u: JaxPerParameter, key: Array
) -> Float[Array, "impact error"]:
    """Draws of the chain's errors given the traces, of each draw of the impacts' parameters."""
    return trace_likelihood(model, data, list(u.T)).draw_errors(key)


def _contradiction(
    prepared: Prepared,
    expansions: GaussianFactor,
    errors: dict[str, ErrorEstimate],
    patterns: dict[str, ErrorPattern],
) -> dict[str, Any]:
    """Which error explains best what the traces contradict, and what it does."""
    # Over the way to the peak they do much the same to a trace: the velocity is named first unless another
    # is clearly the better account.
    gain = {key: errors[key].gain.sum() for key in patterns}
    greatest = max(gain.values())
    least = greatest - max(_CLEAR, _CLEAR_SHARE * greatest)
    name, *equivalent = [key for key, explained in gain.items() if explained > least]
    estimate, pattern, names = errors[name], patterns[name], prepared.impacts.astype(str)
    left = structure_left(prepared, name, estimate) if prepared.model.kind == "impact" else 0.0
    which = pattern.impacts
    change = np.expm1(np.median((estimate.centre - np.asarray(expansions.centre))[which], axis=0))
    sds = np.abs(estimate.error) / np.where(estimate.declared > 0, estimate.declared, np.nan)
    impacts, relative = names["impact"][which].tolist(), estimate.relative(which)
    account = {
        "error": name,
        "alike": {key: float(np.median(errors[key].relative(which))) for key in equivalent},
        "kind": pattern.kind,
        "common": pattern.common,
        "impacts": impacts,
        "groups": names[pattern.kind][which].unique().tolist() if pattern.kind in _GROUPS else [],
        "of": len(which),
        "relative": float(np.median(relative)),
        "greatest": float(np.abs(relative).max()),
        "declared_sds": None if np.isnan(sds[which]).all() else float(np.nanmedian(sds[which])),
        "structure_left": left,
        "change_K": float(change[0]),
        "change_C": float(change[1]),
    }
    if left > LIMIT:
        return account | {"passed": None, "words": sentence("measuring-chain.undecided", error=name)}
    first, rows = sentence("measuring-chain.first"), ALL_ROWS if which.all() else impacts
    return Finding("measuring-chain", passed=False, words=in_words(account), first=first, rows=rows).record(
        **account
    )


def structure_left(prepared: Prepared, name: str, estimate: ErrorEstimate) -> float:
    """The score of `bayestissue.inference.checking.model_form` with an error taken as the traces have it."""
    data, offset = with_normal_errors(prepared.data), np.zeros((1, 1))
    record: Any = data.record
    if name == OFFSET:
        offset = estimate.error[:, None]
    elif name == CONTACT:
        record = record.with_first_time(jnp.maximum(record.first_time - estimate.error, 0.0))
    else:
        record = record._replace(velocity=jnp.asarray(prepared.signal.velocity + estimate.error))
    key = jax.random.PRNGKey(0)
    return float(judged_at(prepared, replace(data, record=record), estimate.centre, key, offset)["score"])


def in_words(account: dict[str, Any]) -> str:
    """Sentences on the error that the traces contradict: where, how large it is, and what to check."""
    error, kind, rivals, size = (account[name] for name in ("error", "kind", "alike", "relative"))
    single = len(account["impacts"]) == 1
    common, of_group = account["common"] or single, error == AMPLITUDE and kind in _GROUPS
    share = _percent(size) if common else f"up to {_percent(account['greatest'])}"
    if error != AMPLITUDE:
        what = _said("asked", error=_said(f"error.{error}", share=share))
    elif common:
        what = _said("velocity.higher" if size > 0 else "velocity.lower", share=share)
        what += "" if single else _said("velocity.one_factor")
    else:
        what = _said("velocities", share=share)
    alone = kind == ALL and account["of"] == 1
    named = first_of(account["groups"] or account["impacts"], _MOST_NAMED)
    counts = {"count": len(account["impacts"]), "of": account["of"]}
    sds = account["declared_sds"]
    others = " or ".join(_said(f"error.{name}", share=_percent(size)) for name, size in rivals.items())
    checks = _said(f"check.{error}") + (_said(f"check.{kind}") if of_group else "")
    return _said(
        "contradicted",
        where=_said(f"where.{'only' if alone else kind}", named=named, **counts),
        what=what,
        sds=_said("sds.none" if sds is None else "sds.one" if single else "sds.median", sds=sds),
        K=_change(account["change_K"]),
        C=_change(account["change_C"]),
        equivalents=_said("equivalents", others=others) if others else "",
        checks=". ".join([checks, *(_said(f"check.{name}") for name in rivals)]),
    )


def _said(name: str, **numbers: object) -> str:
    return sentence(f"measuring-chain.{name}", **numbers)


def _change(ratio: float) -> str:
    return f"{_percent(ratio)} {'higher' if ratio > 0 else 'lower'}"


def _percent(ratio: float) -> str:
    return f"{100 * abs(ratio):.2g} %"
