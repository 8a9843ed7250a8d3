"""Log densities of traces given the population, each impact's own parameters integrated out.

Of each impact, and of all impacts of a person or a condition with the effects of that integrated out too:
what cross-validation asks for. They are those of the summaries, times what the traces themselves make of
them.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.gaussian.conditional import Sites
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
    see `bayestissue.inference.factors.importance_ratios`. Of a person's or condition's traces the two effects
    are integrated out of the summaries, and the factors besides are those at the effects that the draw has:
    these being a draw of the posterior, the mean of one over such a density, which leaving out asks for, is
    the true one.

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
    for group in GROUPS:
        codes, count = getattr(design, group), len(getattr(design, f"{group}s"))
        mean = anchors.mean.copy()
        for place, response in enumerate(RESPONSES):
            name = f"{group}_effect_{response}"
            if name in model.locations.parts:
                mean[..., place] -= b[:, model.locations.parts[name]][:, codes]
        alone = log_evidence(summaries, anchors._replace(mean=mean), inverse) + besides
        here = pull - times(weight, mean - centre)
        member = (codes[:, None] == np.arange(count)).astype(float)
        sums = [weight[..., a, c] @ member for a, c in ((0, 0), (0, 1), (1, 1))]
        gained = _gained(model, group, sites, sums, [here[..., a] @ member for a in (0, 1)])
        scores[f"traces_of_{group}"] = alone @ member + np.asarray(gained)
    return scores


@compiled_quickly("group")
def _gained(
    model: TraceModel,
    group: str,
    sites: dict[str, Any],
    weight: list[Float[Array, "draw level"]],
    pull: list[Float[Array, "draw level"]],
) -> Float[Array, "draw level"]:
    columns = {name: values[:, None] for name, values in sites.items()}
    return integrated_effects(model, columns, group, weight, pull)


def integrated_effects(
    model: TraceModel, sites: dict[str, Array], group: str, weight: list[Array], pull: list[Array]
) -> Array:
    """What the log density of each level's traces gains by the level's two effects being integrated out.

    Args:
        model: the model.
        sites: the standard deviations.
        group: "subject" or "trial".
        weight: each level's sums of W, as (KK, KC, CC).
        pull: its sums of the log evidence's slopes by log K and log C, the effects being 0.
    """
    (l00, l10), l11 = _factor_of_effects(model, sites, group)
    w00, w01, w11 = weight
    m00 = 1 + l00**2 * w00 + 2 * l00 * l10 * w01 + l10**2 * w11
    m01 = l11 * (l00 * w01 + l10 * w11)
    m11 = 1 + l11**2 * w11
    h0, h1 = l00 * pull[0] + l10 * pull[1], l11 * pull[1]
    determinant = m00 * m11 - m01**2
    return (m11 * h0**2 - 2 * m01 * h0 * h1 + m00 * h1**2) / (2 * determinant) - jnp.log(determinant) / 2


def _factor_of_effects(
    model: TraceModel, sites: dict[str, Array], group: str
) -> tuple[tuple[Array, Array], Array]:
    """Columns of the lower Cholesky factor of the covariance of a group's two effects."""
    sd_K, sd_C = (sites.get(f"sd_{group}_{q}", jnp.zeros(())) for q in RESPONSES)
    if group != "subject" or model.mass_error == "impact":
        return (sd_K, jnp.zeros(())), sd_C
    variance = model.log_mass_sd**2
    first = jnp.sqrt(sd_K**2 + variance)
    # C + v - v^2 / (K + v), without the difference of near equals
    return (first, variance / first), jnp.sqrt(sd_C**2 + variance * sd_K**2 / first**2)
