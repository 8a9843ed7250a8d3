"""Log densities of traces given the population, each impact's own parameters integrated out.

Of each impact, and of all impacts of a person or a condition with the effects of that integrated out too:
what cross-validation asks for. They are the evidence of the sites, times the
ratio of the traces' own evidence to it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.hierarchy.gaussian.arrangement import expected_by_cell
from bayestissue.hierarchy.gaussian.conditional import Data
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, population
from bayestissue.inference.execution.chunks import impacts_of
from bayestissue.inference.execution.compiling import by_row, in_parts
from bayestissue.inference.execution.kept import all_fit, some_impacts
from bayestissue.inference.factors.conditional import log_evidence
from bayestissue.inference.factors.conditional_prior import PopulationDraws, of_cells
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import log_evidence_corrections, ratios_among
from bayestissue.inference.posterior.approximate import Approximation
from bayestissue.inference.posterior.own_effects import OwnEffects, own_effects
from bayestissue.likelihood import small

# Draws at a time: what a matrix of each impact under each of them takes stays small.
_AT_ONCE = 64


class LikelihoodApproximation(NamedTuple):
    """All that is known of the traces' likelihoods.

    Attributes:
        approximation: of the traces, with a grid of the last parameter or an expansion of what sites omit.
        corrections: log of each trace's evidence over its site's at the draws that are scored; found by
            `of_draws` unless given.
    """

    approximation: Approximation
    corrections: Float[np.ndarray, "draw impact"] | None = None


def of_draws(
    prepared: Prepared, likelihood: LikelihoodApproximation, draws: PopulationDraws
) -> dict[str, np.ndarray]:
    """Log densities under each draw of the population: "trace" [draw, impact], "traces_of_subject" and so on.

    That of an impact is its site's evidence, times the grid's, times the mean of likelihood over both:
    see `bayestissue.inference.factors.importance_ratios`. Of a person's or condition's traces all effects
    that only these have are integrated out of the sites (see `bayestissue.inference.posterior.own_effects`),
    and the factors besides are those at the effects that the draw has: these being a draw of the posterior,
    the mean of one over such a density, which leaving out asks for, is the true one.

    Where draws times impacts are more than fits, "trace" is of `some_impacts`, what groups have besides
    their sites is the expansion, and "traces" is of all traces together.
    """
    data, approximation, count = prepared.data, likelihood.approximation, len(prepared.impacts)
    whole = all_fit(len(draws.b), count)
    groups = _of_groups(prepared, replace(approximation, expansion=None) if whole else approximation, draws)
    rows = np.arange(count) if whole else some_impacts(count)
    part, (own, grid) = impacts_of(data, rows), approximation.of_rows(rows)
    priors = of_cells(draws.priors(data.design), np.asarray(data.design.cell)[rows])
    besides = likelihood.corrections
    if besides is None:
        ratios = ratios_among(prepared.model, part, own, priors, grid)
        besides = log_evidence_corrections(own, ratios, priors)
    if grid is not None:
        besides = besides + _grid_evidence(grid, priors.mean[..., -1], priors.precision[:, 0, -1, -1] ** -0.5)
    scores = {"trace": besides + in_parts(partial(log_evidence, own), (priors,), _AT_ONCE)}
    if not whole:
        return scores | groups
    for name, grouping in prepared.design.groupings.items():
        member = (grouping.code[:, None] == np.arange(len(grouping.levels))).astype(float)
        stem = f"traces_of_{stem_of(name)}"
        scores[stem] = groups[stem] + besides @ member
    return scores


@by_row(_AT_ONCE, given=1)
def _grid_evidence(grid: LikelihoodGrid, mean: Float[Array, " impact"], sd: Array) -> Float[Array, " impact"]:
    return grid.log_evidence(mean, sd)


def _of_groups(
    prepared: Prepared, approximation: Approximation, draws: PopulationDraws
) -> dict[str, Float[np.ndarray, " draw ..."]]:
    """The same of groups by the sites, and that of all traces together."""
    model, data, design = prepared.model, approximation.data(prepared.data), prepared.design
    cell, places = np.asarray(data.design.cell), data.design.members.shape[2]
    own = {name: each.at_places(cell, places) for name, each in own_effects(model, design).items()}
    made = _group_scores(model, data, own, draws.sites, draws.b)
    for name, grouping in design.groupings.items():
        stem = f"traces_of_{stem_of(name)}"
        made[stem] = made[stem][:, : len(grouping.levels)]
    return made


@by_row(_AT_ONCE, given=3)
def _group_scores(
    model: TraceModel,
    data: Data,
    own_of: dict[str, OwnEffects],
    sites: dict[str, Array],
    b: Float[Array, " location"],
) -> dict[str, Array]:
    """What is compiled of `_of_groups`."""
    covariances = population(model, sites)
    sums = data.sums(covariances)
    moved = expected_by_cell(data.design, b) - expected_by_cell(data.design, data.mean)

    def at(away: Array) -> tuple[Array, Array]:
        bent = jnp.stack(small.times(sums.weight, away))
        return sums.constant + (away * (sums.pull - bent / 2)).sum(0), sums.pull - bent

    scores = {"traces": at(moved)[0].sum()}
    for name, own in own_of.items():
        value, pull = at(moved - own.expected(b, len(moved)))
        scores[f"traces_of_{stem_of(name)}"] = own.total(value) + own.gained(covariances, sums.weight, pull)
    return scores
