"""Log densities of traces given the population, each impact's own parameters integrated out.

Of each impact, and of all impacts of a person or a condition with the effects of that integrated out too:
what cross-validation asks for. They are those of the summaries, times what the traces themselves make of
them.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.conditional import Sites
from bayestissue.hierarchy.group_terms import stem_of
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.execution.compiling import compiled_quickly, compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    importance_ratios,
    log_evidence_corrections,
)
from bayestissue.inference.factors.laplace import ConditionalPrior, times
from bayestissue.inference.factors.moments import inverse_of_whole, log_evidence, standard_points
from bayestissue.inference.posterior.conditional_prior import ConditionalPriors
from bayestissue.inference.posterior.own_effects import gained, own_effects

# Draws at a time: what a matrix of each impact under each of them takes stays small.
_AT_ONCE = 64


class LikelihoodApproximation(NamedTuple):
    """All that is known of the traces' likelihoods.

    Attributes:
        summaries: of the traces.
        profile: of the last parameter, where the summaries are cleared of it.
        ratios: of likelihood over summary and profile; found by `of_draws` unless given.
    """

    summaries: Sites
    profile: LikelihoodGrid | None = None
    ratios: ImportanceRatios | None = None


def of_draws(
    prepared: Prepared, told: LikelihoodApproximation, expected: ConditionalPriors
) -> dict[str, np.ndarray]:
    """Log densities under each draw of the population: "trace" [draw, impact], "traces_of_subject" and so on.

    That of an impact is its summary's evidence, times the profile's, times the mean of likelihood over both:
    see `bayestissue.inference.factors.importance_ratios`. Of a person's or condition's traces all effects
    that only these have are integrated out of the summaries (see
    `bayestissue.inference.posterior.own_effects`), and the factors besides are those at the effects that the
    draw has: these being a draw of the posterior, the mean of one over such a density, which leaving out
    asks for, is the true one.

    Args:
        prepared: the fit.
        told: of the traces' likelihoods.
        expected: what the draws expect; its sites are those of the draws.
    """
    besides = log_evidence_ratios(prepared.model, prepared.data, told, expected.anchors)
    parts = [
        _of_some(prepared, told.summaries, expected, besides, slice(begin, begin + _AT_ONCE))
        for begin in range(0, len(besides), _AT_ONCE)
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def log_evidence_ratios(
    model: TraceModel, data: TraceData, told: LikelihoodApproximation, anchors: ConditionalPrior
) -> Float[np.ndarray, "draw impact"]:
    """Log of each trace's evidence over its summary's, where draws of the population expect its impact."""
    ratios = told.ratios
    if ratios is None:
        standard = standard_points(told.summaries.centre.shape[1])
        some = np.linspace(0, len(anchors.mean) - 1, len(standard)).astype(int)
        few = ConditionalPrior(*(part[some] for part in anchors))
        ratios = importance_ratios(model, data, told.summaries, few, standard, told.profile)
    found = log_evidence_corrections(told.summaries, ratios, anchors)
    return found if told.profile is None else found + _of_profile(told.profile, anchors)


def _of_profile(profile: LikelihoodGrid, anchors: ConditionalPrior) -> Float[np.ndarray, "draw impact"]:
    sd = anchors.precision[:, 0, -1, -1] ** -0.5
    return in_calls(partial(_profile_evidence, profile), (anchors.mean[..., -1], sd), _AT_ONCE)


@compiled_sooner()
def _profile_evidence(
    profile: LikelihoodGrid, mean: Float[Array, "draw impact"], sd: Array, number: int
) -> Float[Array, "draw impact"]:
    return first_rows(lambda place: profile.log_evidence(mean[place], sd[place]), _AT_ONCE, number)


def _of_some(
    prepared: Prepared,
    summaries: Sites,
    expected: ConditionalPriors,
    besides: Float[np.ndarray, "draw impact"],
    some: slice,
) -> dict[str, np.ndarray]:
    model, design = prepared.model, prepared.design
    anchors = ConditionalPrior(*(part[some] for part in expected.anchors))
    sites = {name: values[some] for name, values in expected.sites.items()}
    b, besides = expected.b[some], besides[some]
    centre, slope, own, _ = (np.asarray(part) for part in summaries)
    inverse = inverse_of_whole(summaries, anchors)
    scores = {"trace": log_evidence(summaries, anchors, inverse) + besides}
    # W = D V P, the precision with which a trace tells X b, and D V g, with V = (P + D)^-1.
    half = (anchors.precision @ inverse.matrix)[..., :2, :]
    weight, pull = half @ own, times(half, slope[None])
    for name, (slots, own_of) in own_effects(model, design).items():
        mean = anchors.mean.copy()
        for a in (0, 1):
            mean[..., a] -= own_of.in_impacts(slots, b, a)
        alone = log_evidence(summaries, anchors._replace(mean=mean), inverse) + besides
        here = pull - times(weight, mean - centre)
        member = (own_of.level[:, None] == np.arange(own_of.element.shape[1])).astype(float)
        of = slots.response
        sums = {
            (s, t): (weight[..., of[s], of[t]] * (own_of.value[s] * own_of.value[t])) @ member
            for s, t in slots.together
        }
        score = [(here[..., a] * value) @ member for a, value in zip(of, own_of.value, strict=True)]
        added = gained_by_integration(model, slots, sites, sums, score)
        scores[f"traces_of_{stem_of(name)}"] = alone @ member + np.asarray(added)
    return scores


gained_by_integration = compiled_quickly("slots")(gained)
