"""Log densities of traces given the population, each impact's own parameters integrated out.

Of each impact, and of all impacts of a person or a condition with the effects integrated out that these
impacts alone have: what cross-validation asks for. Of a person the effects are those on log K, log C and what
else has a formula, a mass exponent of the person, and the effects of all that lies within the person, such as
each side; without the traces only the prior tells them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int

from bayestissue.base.impact_arrays import bucket
from bayestissue.inference.execution.compiling import by_row, in_parts
from bayestissue.inference.factors.conditional import conditional_priors, log_evidence
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import Grouping, stem_of
from bayestissue.model.hierarchy.gaussian.arrangement import expected_by_cell
from bayestissue.model.hierarchy.gaussian.effects import Covariances, SitesByCell
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import MASS_ERROR, Population
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import TraceModel, sites_by_cell

# Draws at a time: what a matrix of each impact under each of them takes stays small.
_AT_ONCE = 64


def log_densities(
    prepared: Prepared,
    sites: GaussianFactor,
    population: Population,
    log_ratios: Mapping[str, Float[np.ndarray, "chain draw one"]],
    rows: Int[np.ndarray, " shown"],
) -> dict[str, Float[np.ndarray, "chain draw ..."]]:
    """Log densities under each draw: "trace" [chain, draw, impact], "traces_of_subject" and so on.

    Of an impact it is the evidence Z of its site q given the draw's population, times L / q at the u that the
    draw has. Its reciprocal is the density of everything with u drawn by the site instead of the trace, over
    the posterior's: just the weight with which the posterior's draws stand for those without the trace,
    whatever q is. So of a group, with the evidence of its sites once all effects that only its traces tell
    are integrated out, and the product of its impacts' L / q.

    "traces" is of all sites together.

    Args:
        prepared: the fit.
        sites: q of every trace.
        population: draws, [chain, draw, ...].
        log_ratios: log L / q at each draw, of these impacts under "impact", and its sums over the levels of
            each grouping.
        rows: numbers of the impacts that "trace" is of.
    """
    model, data = prepared.model, prepared.data
    shown = GaussianFactor(*(np.asarray(leaf)[rows] for leaf in sites))
    priors = conditional_priors(model, data.design, population, rows)
    evidence = in_parts(partial(log_evidence, shown), (priors,), _AT_ONCE, axes=2)
    traces = sites_by_cell(data, sites)
    cell, places = np.asarray(data.design.cell), traces.design.members.shape[2]
    of_levels = own_effects(model, prepared.design, prepared.mass_group)
    effects = {name: effect.at_places(cell, places) for name, effect in of_levels.items()}
    of_impacts = log_ratios["impact"]
    # Of more impacts there may be ratios than are shown.
    of_impacts = of_impacts if of_impacts.shape[-1] == len(rows) else of_impacts[..., rows]
    scores = {"trace": evidence + of_impacts} | _of_groups(model, traces, effects, population)
    for name, grouping in prepared.design.groupings.items():
        stem = f"traces_of_{stem_of(name)}"
        scores[stem] = scores[stem][..., : len(grouping.levels)] + log_ratios[name]
    return scores


@by_row(_AT_ONCE, constant=3, axes=2)
def _of_groups(
    model: TraceModel, data: SitesByCell, effects_of: dict[str, OwnEffects], population: Population
) -> dict[str, Array]:
    """Of groups by the sites, and of all traces together."""
    covariances, b = model.covariances(population.hyperparameters), population.b
    sums = data.sums(covariances)
    expected = expected_by_cell(data.design, b)
    scores = {"traces": sums.recentred(expected).log_scale.sum()}
    for name, effect in effects_of.items():
        own = data.design.of_parameters(effect.expected(b, len(data.design.inner)))
        without = sums.recentred(expected - own)
        gained = effect.gained(covariances, *data.design.of_parts(sums.precision, without.shift))
        scores[f"traces_of_{stem_of(name)}"] = effect.total(without.log_scale) + gained
    return scores


class OwnEffects(NamedTuple):
    """A level's own effects, as many slots for each; of a level that has fewer some are empty.

    Attributes:
        parameter: of an impact, by its number, that each slot's effect is on: 0 is log K, 1 log C. One past
            the last is the error of log mass, see `PopulationDesign.of_parameters`.
        element: of b, in each slot of each level; one past the last where it is empty.
        value: what each slot's effect multiplies in each row of the design; 0 where the row lacks it.
        level: of each row.
    """

    parameter: Int[np.ndarray | Array, " slot"]
    element: Int[np.ndarray | Array, "slot group"]
    value: Float[np.ndarray | Array, "slot row"]
    level: Int[np.ndarray | Array, " row"]

    def at_places(self, cell: np.ndarray, places: int) -> OwnEffects:
        """The same of each place of a `PopulationDesign`, and of a `bucket` of levels.

        An empty place has level 0 and adds nothing.
        """
        level, value = np.zeros(places, int), np.zeros((len(self.value), places))
        level[cell], value[:, cell] = self.level, self.value
        more = bucket(self.element.shape[1]) - self.element.shape[1]
        return OwnEffects(self.parameter, np.pad(self.element, ((0, 0), (0, more))), value, level)

    def expected(self, b: Float[Array, " location"], size: int) -> Float[Array, "parameter row"]:
        """What the levels' own effects add to each parameter, of ``size`` parameters."""
        added = jnp.append(b, 0.0)[jnp.asarray(self.element)][:, self.level] * self.value
        return jax.ops.segment_sum(added, jnp.asarray(self.parameter), size)

    def total(self, values: Float[Array, "*batch row"]) -> Float[Array, "*batch group"]:
        """Sums over each level's rows."""
        sums = jax.ops.segment_sum(jnp.moveaxis(values, -1, 0), self.level, self.element.shape[1])
        return jnp.moveaxis(sums, 0, -1)

    def gained(
        self,
        covariances: Covariances,
        precision: Float[Array, "parameter parameter row"],
        shift: Float[Array, "parameter row"],
    ) -> Float[Array, " group"]:
        """What the log density of each level's traces gains by the level's effects e being integrated out.

        The log of the mean of exp(e'p - e'W e / 2) over e ~ N(0, D^-1) is p'(D + W)^-1 p / 2 + log det D / 2
        - log det(D + W) / 2, with p and W summed over the level's rows.

        Args:
            covariances: of which those of b count.
            precision: with which the traces of each row tell X b.
            shift: the slopes of their log evidence by X b, the level's own effects being 0.
        """
        parameters = self.parameter
        if not len(parameters):
            return jnp.zeros(self.element.shape[1])
        W = self.total(
            jnp.asarray(precision)[parameters[:, None], parameters] * (self.value[:, None] * self.value)
        )
        p = self.total(jnp.asarray(shift)[parameters] * self.value)
        D = covariances.precision_among(jnp.asarray(self.element))
        prior, posterior = (jnp.linalg.cholesky(jnp.moveaxis(matrix, -1, 0)) for matrix in (D, D + W))
        half = solve_triangular(posterior, p.T[..., None], lower=True)
        scale = jnp.log(jnp.diagonal(prior, 0, 1, 2) / jnp.diagonal(posterior, 0, 1, 2)).sum(1)
        return (half**2).sum((1, 2)) / 2 + scale


def own_effects(
    model: TraceModel, design: Design, mass_group: Int[np.ndarray, " impact"] | None = None
) -> dict[str, OwnEffects]:
    """Of every grouping of a design the effects that its levels do not share.

    Args:
        model: whose b the effects are elements of.
        design: the formulas over the impacts.
        mass_group: which error of its mass each impact has, where impacts share these.
    """
    parameters = (*RESPONSES, *model.nuisance)
    parts = [
        (
            parameters.index(p.parameter),
            term.effect(q),
            design.groupings[term.grouping].code,
            column.covariate,
        )
        for q, p in design.responses.items()
        for term, column in p.terms.items()
    ]
    if mass_group is not None:
        parts.append((len(parameters), MASS_ERROR, mass_group, np.ones(len(mass_group))))
    return {name: _of(model, parts, grouping) for name, grouping in design.groupings.items()}


def _of(
    model: TraceModel, parts: Sequence[tuple[int, str, np.ndarray, np.ndarray]], grouping: Grouping
) -> OwnEffects:
    """Of one grouping; a part has its parameter's number, its name, and of each impact a code and a value."""
    levels = len(grouping.levels)
    slots: list[tuple[int, np.ndarray, np.ndarray]] = []
    for parameter, name, code, covariate in parts:
        pairs = np.unique(np.stack([code, grouping.code]), axis=1)
        if pairs.shape[1] > code.max() + 1:
            continue
        # The how-manieth inner level of its own outer level each inner level is.
        outer = pairs[1]
        rank = pd.Series(outer).groupby(outer).cumcount().to_numpy()
        begin = model.locations.parts[name].start
        for number in range(rank.max() + 1):
            element = np.full(levels, model.locations.size)
            element[outer[rank == number]] = begin + np.flatnonzero(rank == number)
            value = np.where(rank[code] == number, covariate, 0.0)
            slots.append((parameter, element, value))
    elements = np.array([element for _, element, _ in slots], int).reshape(-1, levels)
    values = np.array([value for _, _, value in slots]).reshape(-1, len(grouping.code))
    return OwnEffects(np.array([a for a, _, _ in slots], int), elements, values, grouping.code)
