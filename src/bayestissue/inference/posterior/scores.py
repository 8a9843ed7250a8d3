"""Log densities of traces given the population, each impact's own parameters integrated out.

Of each impact, and of all impacts of a person or a condition with the effects of that integrated out too:
what cross-validation asks for. They are the evidence of the sites, times the
ratio of the traces' own evidence to it.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.hierarchy.gaussian import blocks
from bayestissue.hierarchy.gaussian.impacts import CellSums, Sites
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.execution.compiling import compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.conditional import ConditionalPrior, normals
from bayestissue.inference.factors.conditional_prior import ConditionalPriors
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    log_evidence_corrections,
    ratios_among,
)
from bayestissue.inference.posterior.own_effects import OwnEffects, Slots, gained, own_effects

# Draws at a time: what a matrix of each impact under each of them takes stays small.
_AT_ONCE = 64


class LikelihoodApproximation(NamedTuple):
    """All that is known of the traces' likelihoods.

    Attributes:
        summaries: of the traces.
        profile: of the last parameter, where the summaries are cleared of it.
        ratios: of likelihood over summary and profile; found by `of_draws` unless given.
        corrections: what the ratios make of each impact's evidence at the draws that are scored, as
            `log_evidence_corrections` has it; found by `of_draws` unless given.
    """

    summaries: Sites
    profile: LikelihoodGrid | None = None
    ratios: ImportanceRatios | None = None
    corrections: Float[np.ndarray, "draw impact"] | None = None


def of_draws(
    prepared: Prepared,
    told: LikelihoodApproximation,
    expected: ConditionalPriors,
    groups: dict[str, tuple[Slots, OwnEffects]] | None = None,
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
        groups: groupings with their levels' own effects; all of the design unless given.
    """
    besides = log_evidence_ratios(prepared.model, prepared.data, told, expected.anchors)
    groups = own_effects(prepared.model, prepared.design) if groups is None else groups
    parts = [
        _of_some(prepared, groups, told.summaries, expected, besides, slice(begin, begin + _AT_ONCE))
        for begin in range(0, len(besides), _AT_ONCE)
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def log_evidence_ratios(
    model: TraceModel, data: TraceData, told: LikelihoodApproximation, anchors: ConditionalPrior
) -> Float[np.ndarray, "draw impact"]:
    """Log of each trace's evidence over its summary's, where draws of the population expect its impact."""
    ratios, found = told.ratios, told.corrections
    if ratios is None:
        ratios = ratios_among(model, data, told.summaries, anchors, told.profile)
    if found is None:
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
    groups: dict[str, tuple[Slots, OwnEffects]],
    summaries: Sites,
    expected: ConditionalPriors,
    besides: Float[np.ndarray, "draw impact"],
    some: slice,
) -> dict[str, np.ndarray]:
    anchors = ConditionalPrior(*(part[some] for part in expected.anchors))
    sites = {name: values[some] for name, values in expected.sites.items()}
    b, besides = expected.b[some], besides[some]
    given, about = normals(summaries, anchors)
    scores = {"trace": given.log_density(about) + besides}
    for name, (slots, own) in groups.items():
        mean = without(slots, own, b, about)
        alone = given.log_density(mean) + besides
        member = (own.level[:, None] == np.arange(own.element.shape[1])).astype(float)

        def total(values: Any, member: Any = member) -> Any:
            return values @ member

        added = gained(prepared.model, slots, own, sites, given.weight, given.pull(mean), total)
        scores[f"traces_of_{stem_of(name)}"] = total(alone) + added
    return scores


def scores_of_groups(
    model: TraceModel,
    sums: CellSums,
    moved: Float[Array, "parameter place"],
    groups: tuple[tuple[str, Slots], ...],
    own_of: dict[str, OwnEffects],
    sites: dict[str, Array],
    b: Float[Array, " location"],
) -> dict[str, Array]:
    """The same of one draw from the sums of cells, and that of all traces together.

    Args:
        model: the model.
        sums: what the impacts of each place say of X b.
        moved: X b of each place, less that at b's prior mean.
        groups: what each grouping's own effects are.
        own_of: where they are, with places for impacts.
        sites: the standard deviations.
        b: the effects.
    """

    def at(away: Array) -> tuple[Array, Array]:
        bent = jnp.stack(blocks.times(sums.weight, away))
        return sums.constant + (away * (sums.pull - bent / 2)).sum(0), sums.pull - bent

    scores = {"traces": at(moved)[0].sum()}
    for name, slots in groups:
        own = own_of[name]
        if not slots.spread:
            continue

        def total(values: Array, own: OwnEffects = own) -> Array:
            return jax.ops.segment_sum(values, own.level, own.element.shape[1])

        value, pull = at(without(slots, own, b, moved))
        added = gained(model, slots, own, sites, sums.weight, pull, total)
        scores[f"traces_of_{stem_of(name)}"] = total(value) + added
    return scores


def without(slots: Slots, own: OwnEffects, b: Any, about: Any) -> Any:
    """X b less what levels' own effects add to it."""
    return about.__array_namespace__().stack([v - own.in_impacts(slots, b, a) for a, v in enumerate(about)])
