"""No two elements have one force law: one that exists is found by its force, and not added once more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scipy.optimize import least_squares

from bayestissue.mechanics.elements import Element, element, element_names
from bayestissue.mechanics.elements.element import Law, Parameter, States

# Half sines of penetration: greatest depth [m], its time [s], and the ball's diameter [m].
DEPTH, TO_PEAK = (0.004, 0.015, 0.012, 0.008), (0.03, 0.02, 0.006, 0.01)
DIAMETER = (0.0318, 0.0318, 0.0318, 0.05)
STEPS = 200
# Draws of one element's parameters, each from its usual values by a factor of up to exp(SPREAD).
DRAWS, SPREAD = 3, 0.5
USUAL = {"K": 3000.0, "C": 25.0}
# Of the greatest force: where a law can take another's place, only rounding is left.
SAME = 1e-6
# Where a search ends: forces so many times too great, parameters by such a factor's log.
TOO_FAR, REACH = 1e6, 6.0


class Tried(NamedTuple):
    """An element's forces under the motions, from the logs of its parameters, and the slopes in these."""

    usual: np.ndarray
    forces: Callable[[np.ndarray], np.ndarray]
    slopes: Callable[[np.ndarray], np.ndarray]


@cache
def tried(one: Element) -> Tried:
    depth, peak, diameter = (np.array(each)[:, None] for each in (DEPTH, TO_PEAK, DIAMETER))
    step = 2 * peak[:, 0] / STEPS
    half = np.arange(2 * STEPS + 1) / (2 * STEPS)
    x = jnp.asarray((depth * np.sin(np.pi * half)).T)
    v = jnp.asarray((depth * np.pi / (2 * peak) * np.cos(np.pi * half)).T)

    def forces(logs: Array) -> Array:
        p = {each.name: jnp.exp(log) for each, log in zip(one.parameters, logs, strict=True)}
        p["diameter_m"] = jnp.asarray(diameter[:, 0])

        def rates(at: Array, s: States) -> States:
            return one.rates(x[at], v[at], s, p)

        def moved(s: States, rate: States, by: Array) -> States:
            return tuple(a + by * b for a, b in zip(s, rate, strict=True))

        def advance(s: States, at: Array) -> tuple[States, Array]:
            first = rates(at, s)
            second = rates(at + 1, moved(s, first, step / 2))
            third = rates(at + 1, moved(s, second, step / 2))
            last = rates(at + 2, moved(s, third, step))
            each = zip(first, second, third, last, strict=True)
            slope = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in each)
            return moved(s, slope, step), one.force(x[at], v[at], s, p)

        still = tuple(jnp.zeros(len(DEPTH)) for _ in range(one.states))
        return jax.lax.scan(advance, still, jnp.arange(0, 2 * STEPS, 2))[1].ravel()

    usual = np.log([USUAL.get(each.name, each.typical) for each in one.parameters])
    return Tried(usual, jax.jit(forces), jax.jit(jax.jacfwd(forces)))


def least_miss(law: Tried, wanted: np.ndarray) -> float:
    """How far from ``wanted`` forces the law's nearest are, of the greatest force."""
    size = np.abs(wanted).max()

    def miss(logs: np.ndarray) -> np.ndarray:
        away = np.asarray(law.forces(logs)) / size - wanted / size
        # Steps are too long for a damper as stiff as that: the search turns back.
        return np.where(np.abs(away) < TOO_FAR, away, np.inf)

    found = least_squares(
        miss,
        law.usual,
        lambda logs: np.asarray(law.slopes(logs)) / size,
        bounds=(law.usual - REACH, law.usual + REACH),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return float(np.abs(found.fun).max())


def holds(law: Element, other: Element) -> bool:
    """Whether ``law`` can have the forces of ``other``, whatever the parameters of that are."""
    theirs = tried(other)
    drawn = theirs.usual + np.random.default_rng(0).uniform(-SPREAD, SPREAD, (DRAWS, len(theirs.usual)))
    return all(least_miss(tried(law), np.asarray(theirs.forces(logs))) < SAME for logs in drawn)


def one_law(first: Element, second: Element) -> bool:
    """Whether each can take the other's place; beside tissue that moves along a force is another law."""
    alike = (first.added_mass is None) == (second.added_mass is None)
    return alike and holds(first, second) and holds(second, first)


REGISTERED = [element(name) for name in element_names()]


def test_no_two_elements_have_one_law() -> None:
    twice = [(a.name, b.name) for a, b in combinations(REGISTERED, 2) if one_law(a, b)]
    assert twice == [], "one law under two names: use the element that is there"


def with_law(name: str, base: str, force: Law, *extra: Parameter, **changed: Any) -> Element:
    like = element(base)
    return replace(like, name=name, force=force, parameters=(*like.parameters[:2], *extra), **changed)


# F = K x + K x^3 / d^2 + C v.
CUBIC = with_law(
    "cubic",
    "stiffening",
    lambda x, v, s, p: p["K"] * x + p["K"] * x**3 / p["d"] ** 2 + p["C"] * v,
    Parameter("d", "m", "depth of the bend", 0.03),
)
# A spring a K in series with a spring K and a damper C side by side, which yield by s.
IN_SERIES = with_law(
    "in_series",
    "standard_linear",
    lambda x, v, s, p: p["a"] * p["K"] * (x - s[0]),
    Parameter("a", "1", "stiffness of the spring in series over K", 3.0),
    rates=lambda x, v, s, p: ((p["a"] * p["K"] * (x - s[0]) - p["K"] * s[0]) / p["C"],),
)
# A force that grows by a fifth power is a law of its own.
QUINTIC = with_law(
    "quintic",
    "stiffening",
    lambda x, v, s, p: p["K"] * x * (1 + (x / p["d"]) ** 4) + p["C"] * v,
    Parameter("d", "m", "depth of the bend", 0.03),
)


@pytest.mark.parametrize(
    ("added", "known"), [(CUBIC, ["stiffening"]), (IN_SERIES, ["standard_linear"]), (QUINTIC, [])]
)
def test_a_law_under_another_name_is_found_by_its_force(added: Element, known: list[str]) -> None:
    assert [one.name for one in REGISTERED if one_law(one, added)] == known
