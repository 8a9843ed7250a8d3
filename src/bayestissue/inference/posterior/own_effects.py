"""Effects that the impacts of one level of a grouping alone have: without them only the prior tells these.

Of a person these are the person's effects on log K, log C and what else has a formula, a mass exponent of
the person's own, and the effects of all that lies within the person, such as each side.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formulas.group_terms import Grouping
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.traces import TraceModel
from bayestissue.padding import bucket


class OwnEffects(NamedTuple):
    """A level's own effects, as many slots for each; of a level that has fewer some are empty.

    Attributes:
        parameter: of an impact, by its number, that each slot's effect is on: 0 is log K, 1 log C.
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
        weight: Float[Array, "parameter parameter row"],
        pull: Float[Array, "parameter row"],
    ) -> Float[Array, " group"]:
        """What the log density of each level's traces gains by the level's effects e being integrated out.

        The log of the mean of exp(e'p - e'W e / 2) over e ~ N(0, D^-1) is p'(D + W)^-1 p / 2 + log det D / 2
        - log det(D + W) / 2, with p and W summed over the level's rows.

        Args:
            covariances: of which those of b count.
            weight: the precision with which the traces of each row tell X b.
            pull: the slopes of their log evidence by X b, the level's own effects being 0.
        """
        of = self.parameter
        if not len(of):
            return jnp.zeros(self.element.shape[1])
        W = self.total(jnp.asarray(weight)[of[:, None], of] * (self.value[:, None] * self.value))
        p = self.total(jnp.asarray(pull)[of] * self.value)
        D = covariances.of_effects().among(jnp.asarray(self.element))
        prior, both = (jnp.linalg.cholesky(jnp.moveaxis(each, -1, 0)) for each in (D, D + W))
        half = solve_triangular(both, p.T[..., None], lower=True)
        scale = jnp.log(jnp.diagonal(prior, 0, 1, 2) / jnp.diagonal(both, 0, 1, 2)).sum(1)
        return (half**2).sum((1, 2)) / 2 + scale


def own_effects(model: TraceModel, design: Design) -> dict[str, OwnEffects]:
    """Of every grouping of a design the effects that its levels do not share."""
    return {name: _of(model, design, grouping) for name, grouping in design.groupings.items()}


def _of(model: TraceModel, design: Design, grouping: Grouping) -> OwnEffects:
    levels, parameters = len(grouping.levels), (*RESPONSES, *model.nuisance)
    slots: list[tuple[int, np.ndarray, np.ndarray]] = []
    for q, part in design.responses.items():
        for term, column in part.terms.items():
            inner = design.groupings[term.grouping]
            pairs = np.unique(np.stack([inner.code, grouping.code]), axis=1)
            if pairs.shape[1] > len(inner.levels):
                continue
            # The how-manieth inner level of its own outer level each inner level is.
            outer = pairs[1]
            rank = pd.Series(outer).groupby(outer).cumcount().to_numpy()
            begin = model.locations.parts[term.effect(q)].start
            for number in range(rank.max() + 1):
                element = np.full(levels, model.locations.size)
                element[outer[rank == number]] = begin + np.flatnonzero(rank == number)
                value = np.where(rank[inner.code] == number, column.covariate, 0.0)
                slots.append((parameters.index(part.parameter), element, value))
    elements = np.array([element for _, element, _ in slots], int).reshape(-1, levels)
    values = np.array([value for _, _, value in slots]).reshape(-1, len(grouping.code))
    return OwnEffects(np.array([a for a, _, _ in slots], int), elements, values, grouping.code)
