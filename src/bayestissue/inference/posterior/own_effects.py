"""Effects that the impacts of one level of a grouping alone have: without them only the prior tells these.

Of a person these are the person's effects on log K, log C and what else has a formula, a mass exponent of
the person's own, and the effects of all that lies within the person, such as each side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formulas.group_terms import SUBJECT, Grouping
from bayestissue.hierarchy.gaussian import blocks
from bayestissue.hierarchy.gaussian.effects import integrated_levels
from bayestissue.hierarchy.traces import TraceModel

# Effects of one level: of more the algebra is a library's, level by level, which compiles in seconds.
_MOST_WRITTEN_OUT = 8


@dataclass(frozen=True)
class Slots:
    """What a level's own effects are, the same for all levels; one with fewer has empty slots.

    Attributes:
        parameter: of an impact, by its number, that the effect is on: 0 is log K, 1 log C.
        sd_names: the names of their standard deviations.
        shared: pairs of slots whose effects a person's error of mass moves alike.
    """

    parameter: tuple[int, ...]
    sd_names: tuple[str, ...]
    shared: tuple[tuple[int, int], ...]


class OwnEffects(NamedTuple):
    """Where a level's own effects are.

    Attributes:
        level: of each impact.
        element: of b, in each slot of each level; 0 where it is empty.
        value: what each slot's effect multiplies in each impact; 0 where the impact lacks it.
    """

    level: Int[np.ndarray | Array, " impact"]
    element: Int[np.ndarray | Array, "slot level"]
    value: Float[np.ndarray | Array, "slot impact"]

    def in_impacts(self, slots: Slots, b: np.ndarray | Array, parameter: int) -> np.ndarray | Array | float:
        """What the levels' own effects add to log K (0), log C (1) ... of each impact, [..., impact]."""
        return sum(
            (
                b[..., self.element[slot]][..., self.level] * self.value[slot]
                for slot, of in enumerate(slots.parameter)
                if of == parameter
            ),
            0.0,
        )


def own_effects(model: TraceModel, design: Design) -> dict[str, tuple[Slots, OwnEffects]]:
    """Of every grouping of a design the effects that its levels do not share."""
    return {name: _of(model, design, grouping) for name, grouping in design.groupings.items()}


def _of(model: TraceModel, design: Design, grouping: Grouping) -> tuple[Slots, OwnEffects]:
    impacts, levels = len(grouping.code), len(grouping.levels)
    elements: list[np.ndarray] = []
    values: list[np.ndarray] = []
    parameter: list[int] = []
    sd_names: list[str] = []
    people: dict[int, list[int]] = {0: [], 1: []}
    parameters = (*RESPONSES, *model.nuisance)
    for q, part in design.responses.items():
        a = parameters.index(part.parameter)
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
                element = np.zeros(levels, int)
                element[outer[rank == number]] = begin + np.flatnonzero(rank == number)
                if term == SUBJECT and model.mass_error == "subject" and q in RESPONSES:
                    people[a].append(len(elements))
                elements.append(element)
                values.append(np.where(rank[inner.code] == number, column.covariate, 0.0))
                parameter.append(a)
                sd_names.append(term.sd(q))
    value = np.array(values).reshape(len(elements), impacts)
    slots = Slots(
        tuple(parameter),
        tuple(sd_names),
        tuple(zip(people[0], people[1], strict=True)),
    )
    return slots, OwnEffects(grouping.code, np.array(elements, int).reshape(len(elements), levels), value)


def gained(
    model: TraceModel,
    slots: Slots,
    own: OwnEffects,
    sites: dict[str, Any],
    weight: blocks.Matrix,
    pull: blocks.Vector,
    total: Callable[[Any], Any],
) -> Any:
    """What the log density of each level's traces gains by the level's own effects being integrated out.

    Args:
        model: the model.
        slots: what the effects are.
        own: where they are.
        sites: the standard deviations, [*draw] each.
        weight: W, the precision with which each impact's trace tells X b, entries [*draw, impact].
        pull: the slopes of its log evidence by X b, the level's own effects being 0.
        total: from values of impacts, along a last axis, to their sums over each level.
    """
    if not slots.sd_names:
        return 0.0
    root = _root(model, slots, sites)
    if len(slots.parameter) > _MOST_WRITTEN_OUT:
        return _gained_by_arrays(slots, own, root, weight, pull, total)
    each = list(zip(slots.parameter, own.value, strict=True))

    def squares(s: int, t: int) -> Any:
        (a, one), (b, other) = each[s], each[t]
        return total(weight[a][b] * (one * other))

    pulled = [total(pull[a] * value) for a, value in each]
    return integrated_levels(blocks.symmetric(len(each), squares), pulled, root)


def _gained_by_arrays(
    slots: Slots,
    own: OwnEffects,
    root: list[list[Any]],
    weight: blocks.Matrix,
    pull: blocks.Vector,
    total: Callable[[Any], Any],
) -> Array:
    """`gained` of levels with dozens of effects: written out entry by entry it would compile for minutes."""
    entries = jnp.array(root)[..., 0]
    R = jnp.moveaxis(entries, (0, 1), (-2, -1))[..., None, :, :]
    of, draws = np.array(slots.parameter), (1,) * (entries.ndim - 2)
    value = jnp.reshape(own.value, (len(of), *draws, -1))
    W = total(jnp.asarray(weight)[of[:, None], of] * (value[:, None] * value))
    p = total(jnp.asarray(pull)[of] * value)
    turned = jnp.swapaxes(R, -1, -2)
    inner = turned @ jnp.moveaxis(W, (0, 1), (-2, -1)) @ R
    factor = jnp.linalg.cholesky(inner + jnp.eye(len(of)))
    half = solve_triangular(factor, turned @ jnp.moveaxis(p, 0, -1)[..., None], lower=True)[..., 0]
    return (half**2).sum(-1) / 2 - jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)


def _root(model: TraceModel, slots: Slots, sites: dict[str, Any]) -> list[list[Any]]:
    """The lower Cholesky factor of the prior covariance of a level's effects, entries [*draw, 1]."""
    sd = [sites[name][..., None] for name in slots.sd_names]
    xp, variance, count = sd[0].__array_namespace__(), model.log_mass_sd**2, range(len(sd))
    entries = {(slot, slot): value for slot, value in enumerate(sd)}
    for K, C in slots.shared:
        first = xp.sqrt(sd[K] ** 2 + variance)
        # C + v - v^2 / (K + v), without the difference of near equals
        last = xp.sqrt(sd[C] ** 2 + variance * sd[K] ** 2 / first**2)
        entries |= {(K, K): first, (C, K): variance / first, (C, C): last}
    return [[entries.get((s, t), xp.zeros_like(sd[0])) for t in count] for s in count]
