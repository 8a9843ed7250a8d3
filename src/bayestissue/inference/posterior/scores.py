"""Log densities of traces given the population, each impact's own parameters integrated out.

Of each impact, and of all impacts of a person or a condition with the effects of that integrated out too:
what cross-validation asks for. They are those of the summaries, times what the traces themselves make of
them.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.gaussian import blocks
from bayestissue.hierarchy.gaussian.effects import integrated_levels
from bayestissue.hierarchy.gaussian.impacts import CellSums, Sites
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.execution.compiling import compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    importance_ratios,
    log_evidence_corrections,
)
from bayestissue.inference.factors.laplace import ConditionalPrior
from bayestissue.inference.factors.moments import normals, standard_points
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
    given, about = normals(summaries, anchors)
    scores = {"trace": given.log_density(about) + besides}
    for group in GROUPS:
        codes, count = getattr(design, group), len(getattr(design, f"{group}s"))
        mean = about.copy()
        for place, response in enumerate(RESPONSES):
            name = f"{group}_effect_{response}"
            if name in model.locations.parts:
                mean[place] -= b[:, model.locations.parts[name]][:, codes]
        alone, pull = given.log_density(mean) + besides, given.pull(mean)
        member = (codes[:, None] == np.arange(count)).astype(float)
        root = root_of_effects(model, sites, group)[..., None]
        gained = integrated_levels(given.weight[:2, :2] @ member, pull[:2] @ member, root)
        scores[f"traces_of_{group}"] = alone @ member + gained
    return scores


def scores_of_groups(
    model: TraceModel,
    sums: CellSums,
    moved: Float[Array, "parameter place"],
    codes: dict[str, Int[Array, " place"]],
    sites: dict[str, Array],
    b: Float[Array, " location"],
) -> dict[str, Array]:
    """The same of one draw from the sums of cells, whatever the number of impacts; and of all traces together.

    Args:
        model: the model.
        sums: what the impacts of each place say of X b.
        moved: X b of each place, less that at b's prior mean.
        codes: person and condition of each place.
        sites: the standard deviations.
        b: the effects.
    """
    parts = model.locations.parts

    def at(away: Array) -> tuple[Array, Array]:
        bent = blocks.times(sums.weight, away)
        return sums.constant + (away * (sums.pull - bent / 2)).sum(0), sums.pull - bent

    scores = {"traces": at(moved)[0].sum()}
    for group in GROUPS:
        names = [f"{group}_effect_{q}" for q in RESPONSES]
        count = max((parts[name].stop - parts[name].start for name in names if name in parts), default=0)
        if not count:
            continue
        away = moved
        for place, name in enumerate(names):
            if name in parts:
                away = away.at[place].add(-b[parts[name]][codes[group]])

        def total(values: Array, group: str = group, count: int = count) -> Array:
            summed = jax.ops.segment_sum(jnp.moveaxis(values, -1, 0), codes[group], count)
            return jnp.moveaxis(summed, 0, -1)

        value, pull = at(away)
        root = root_of_effects(model, sites, group)[..., None]
        gained = integrated_levels(total(sums.weight[:2, :2]), total(pull[:2]), root)
        scores[f"traces_of_{group}"] = total(value) + gained
    return scores


def root_of_effects(model: TraceModel, sites: dict[str, Any], group: str) -> Any:
    """The lower Cholesky factor of the covariance of a group's effects on log K and log C."""
    first = next(iter(sites.values()))
    xp = first.__array_namespace__()
    zero = xp.zeros_like(first)
    sd_K, sd_C = (sites.get(f"sd_{group}_{q}", zero) for q in RESPONSES)
    shared = group == "subject" and model.mass_error == "subject"
    variance = model.log_mass_sd**2 if shared else 0.0
    of_K = xp.sqrt(sd_K**2 + variance)
    # C + v - v^2 / (K + v), without the difference of near equals
    across = variance / of_K if shared else zero
    of_C = xp.sqrt(sd_C**2 + across * sd_K**2 / of_K) if shared else sd_C
    return xp.stack([xp.stack([of_K, zero]), xp.stack([across, of_C])])
