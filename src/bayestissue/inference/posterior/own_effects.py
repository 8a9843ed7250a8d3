"""Effects that the impacts of one level of a grouping alone have: without them only the prior tells these.

Of a person these are the person's effects on log K and log C, a mass exponent of the person's own, and the
effects of all that lies within the person, such as each side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.group_terms import SUBJECT, Grouping
from bayestissue.hierarchy.traces import TraceModel


@dataclass(frozen=True)
class Slots:
    """What a level's own effects are, the same for all levels; one with fewer has empty slots.

    Attributes:
        response: 0 of an effect on log K, 1 on log C.
        spread: the names of their standard deviations.
        shared: pairs of slots whose effects a person's error of mass moves alike.
        together: pairs of slots that some impact has both of, the lower first.
    """

    response: tuple[int, ...]
    spread: tuple[str, ...]
    shared: tuple[tuple[int, int], ...]
    together: tuple[tuple[int, int], ...]


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

    def in_impacts(self, slots: Slots, b: np.ndarray | Array, response: int) -> np.ndarray | Array | float:
        """What the levels' own effects add to log K (0) or log C (1) of each impact, [..., impact]."""
        return sum(
            (
                b[..., self.element[slot]][..., self.level] * self.value[slot]
                for slot, of in enumerate(slots.response)
                if of == response
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
    response: list[int] = []
    spread: list[str] = []
    people: dict[int, list[int]] = {0: [], 1: []}
    for a, q in enumerate(RESPONSES):
        for term, column in design.responses[q].terms.items():
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
                if term == SUBJECT and model.mass_error == "subject":
                    people[a].append(len(elements))
                elements.append(element)
                values.append(np.where(rank[inner.code] == number, column.covariate, 0.0))
                response.append(a)
                spread.append(term.sd(q))
    value = np.array(values).reshape(len(elements), impacts)
    touch = (value != 0).astype(float)
    together = np.argwhere(np.tril(touch @ touch.T) > 0)
    slots = Slots(
        tuple(response),
        tuple(spread),
        tuple(zip(people[0], people[1], strict=True)),
        tuple((int(low), int(high)) for high, low in together),
    )
    return slots, OwnEffects(grouping.code, np.array(elements, int).reshape(len(elements), levels), value)


def gained(
    model: TraceModel,
    slots: Slots,
    sites: dict[str, Array],
    weight: dict[tuple[int, int], Float[Array, "*draw level"]],
    score: list[Float[Array, "*draw level"]],
) -> Float[Array, "*draw level"]:
    """What the log density of each level's traces gains by the level's own effects being integrated out.

    It is h' (1 + L' W L)^-1 h / 2 - log det(1 + L' W L) / 2 with h = L' s, and L L' the prior covariance of
    the effects.

    Args:
        model: the model.
        slots: what the effects are.
        sites: the standard deviations, [*draw] each.
        weight: W, each level's sums of the traces' precision of the effects, of `Slots.together`.
        score: s, the slopes of the log evidence by the effects, these being 0.
    """
    if not slots.spread:
        return jnp.zeros(())
    count = range(len(slots.spread))
    zero = jnp.zeros_like(score[0])
    lower = {pair: weight[pair] for pair in slots.together}
    full = jnp.stack(
        [jnp.stack([lower.get((min(s, t), max(s, t)), zero) for t in count], axis=-1) for s in count], axis=-2
    )
    root = _root(model, slots, sites)[..., None, :, :]
    inner = jnp.eye(len(slots.spread)) + jnp.swapaxes(root, -1, -2) @ full @ root
    factor = jnp.linalg.cholesky(inner)
    h = jnp.swapaxes(root, -1, -2) @ jnp.stack(score, axis=-1)[..., None]
    half = solve_triangular(factor, h, lower=True)[..., 0]
    return (half**2).sum(-1) / 2 - jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)


def _root(model: TraceModel, slots: Slots, sites: dict[str, Array]) -> Float[Array, "*draw slot slot"]:
    """The lower Cholesky factor of the prior covariance of a level's effects."""
    sd = {slot: sites[name] for slot, name in enumerate(slots.spread)}
    entries = {(slot, slot): value for slot, value in sd.items()}
    variance = model.log_mass_sd**2
    for K, C in slots.shared:
        first = jnp.sqrt(sd[K] ** 2 + variance)
        # C + v - v^2 / (K + v), without the difference of near equals
        last = jnp.sqrt(sd[C] ** 2 + variance * sd[K] ** 2 / first**2)
        entries |= {(K, K): first, (C, K): variance / first, (C, C): last}
    count, zero = range(len(slots.spread)), jnp.zeros_like(sd[0])
    rows = [jnp.stack([entries.get((s, t), zero) for t in count], axis=-1) for s in count]
    return jnp.stack(rows, axis=-2)
