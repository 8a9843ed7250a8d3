from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from element_values import (
    ADDED,
    MASS,
    NAMES,
    VALUES,
    VELOCITY,
    solved,
    tangent,
)

from bayestissue.mechanics.elements import element, element_names, impact, linear, outcomes, solver
from bayestissue.mechanics.elements.element import Collision
from tissues import hertz

pytestmark = pytest.mark.slow

TIME = np.linspace(0.0, 0.03, 91) + np.zeros((3, 1))
_BY_DEFAULT = (("standard_linear", "none"), ("stiffening", "drop"))
# Of the largest value: the cubic between nodes, and the Hertz force, which has no smooth start.
SOLVED = 1e-6
EXACT = 1e-10


def test_every_element_is_tried_here() -> None:
    assert set(VALUES) == set(element_names())


@pytest.mark.parametrize("gravity", [None, 9.80665])
@pytest.mark.parametrize("name", NAMES)
def test_path_agrees_with_an_independent_solution_until_the_tissue_stops_pushing(
    name: str, gravity: float | None
) -> None:
    made = impact(name, VALUES[name], MASS, VELOCITY, TIME, gravity=gravity)
    tolerance = EXACT if element(name).linear else SOLVED
    for row in range(len(MASS)):
        inside = TIME[row] <= float(made.leaves[row])
        assert inside.sum() > 20
        for ours, theirs in zip(made[:3], solved(name, row, TIME[row], gravity or 0.0)[:3], strict=True):
            error = np.abs(np.asarray(ours)[row] - theirs)[inside].max()
            assert error < tolerance * np.abs(theirs[inside]).max()


@pytest.mark.parametrize("gravity", [0.0, 9.80665])
@pytest.mark.parametrize("name", NAMES)
def test_flight_before_and_after_contact_is_free(name: str, gravity: float) -> None:
    time = TIME - 0.002
    made = impact(name, VALUES[name], MASS, VELOCITY, time, gravity=gravity or None)
    before, after = time < 0, time > np.asarray(made.leaves)[:, None]
    assert before.any(1).all()
    x = time * VELOCITY[:, None] + gravity * time**2 / 2
    np.testing.assert_allclose(np.where(before, made.x, 0), np.where(before, x, 0), atol=1e-15)
    assert not np.where(before | after, made.deceleration, 0).any()
    for free in (before, after):
        both = free[:, 1:] & free[:, :-1]
        fall, moved = (np.diff(each, axis=1) / np.diff(time, axis=1) for each in (made.v, made.x))
        np.testing.assert_allclose(fall[both], gravity, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(moved[both], ((made.v[:, 1:] + made.v[:, :-1]) / 2)[both], rtol=1e-9)


@partial(jax.jit, static_argnames="count")
def even_grid(collision: Collision, *times: Any, count: int) -> Any:
    return (linear if collision.element.linear else solver).even_grid(collision, *times, count)


# By default one in closed form that flies level, and one solved on a grid that drops; all in the long suite.
_ALONG = [
    pytest.param(
        name, gravity, id=f"{name}-{fall}", marks=[] if (name, fall) in _BY_DEFAULT else pytest.mark.long
    )
    for name in VALUES
    for fall, gravity in (("none", None), ("drop", np.full(3, 9.80665)))
]


@pytest.mark.parametrize(("name", "gravity"), _ALONG)
def test_even_grid_of_the_likelihood_is_the_same_path(name: str, gravity: np.ndarray | None) -> None:
    which, count = element(name), TIME.shape[1]
    peak = np.asarray(outcomes(name, VALUES[name], MASS, VELOCITY)["time_to_peak"])
    dt, first = peak / (count - 1), peak / (count - 1) * np.array([0.0, 0.4, 1.0])
    met = Collision.of(which, VALUES[name], MASS, VELOCITY, gravity=gravity)
    y = even_grid(met, first, dt, count=count)
    time = first[:, None] + dt[:, None] * np.arange(count)
    made = impact(name, VALUES[name], MASS, VELOCITY, time, gravity=gravity)
    tolerance = EXACT if which.linear else SOLVED
    for ours, theirs in zip(y[:2], made[:2], strict=True):
        assert np.abs(ours - theirs).max() < tolerance * np.abs(theirs).max()


def test_hertz_force_follows_the_balls_diameter() -> None:
    which = element("hunt_crossley")
    for diameter in (0.0254, 0.0318, 0.0381):
        p = Collision.of(which, VALUES["hunt_crossley"], 1.0, 1.0, diameter=diameter).parameters
        force = which.force(jnp.array([0.004]), jnp.array([0.5]), (), p)
        np.testing.assert_allclose(force, hertz(VALUES["hunt_crossley"], 0.004, 0.5, diameter), rtol=1e-12)


def test_wall_grows_on_behind_itself_without_a_seam() -> None:
    which, edge = element("wall"), 0.95 * 0.03
    p = Collision.of(which, VALUES["wall"], 1.0, 1.0, shape=()).parameters

    def spring(x: jax.Array) -> jax.Array:
        return which.force(x, 0.0 * x, (), p)

    laws = (spring, jax.grad(spring), jax.grad(jax.grad(spring)))
    for law in map(jax.jit, laws):
        # The third derivative, 6 K h / (h - x)^4 h, over two steps of rounding size.
        np.testing.assert_allclose(law(jnp.array(edge - 1e-12)), law(jnp.array(edge + 1e-12)), rtol=1e-7)
    x = jnp.linspace(0.0, 0.1, 2000)
    assert (jnp.diff(spring(x)) > 0).all()
    energy = which.stored(x, 0 * x, (), p)
    of_energy = jax.jit(jax.vmap(jax.grad(lambda x: which.stored(x, x, (), p))))
    np.testing.assert_allclose(of_energy(x), spring(x), rtol=1e-9)
    assert (jnp.diff(energy) > 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_outcomes_are_what_they_say(name: str) -> None:
    row = 1
    for gravity in (9.80665, 0.0):
        found = outcomes(name, VALUES[name], MASS, VELOCITY, gravity=gravity or None)
        time = np.linspace(0, float(found["time_to_peak"][row]), 4001)
        x, v, d, lost = solved(name, row, time, gravity)
        np.testing.assert_allclose(v[-1], 0, atol=1e-6 * VELOCITY[row])
        np.testing.assert_allclose(found["peak_depth"][row], x[-1], rtol=1e-6)
        damping = np.trapezoid(lost, time) / np.trapezoid(v**2, time)
        np.testing.assert_allclose(found["C_equivalent"][row], damping, rtol=1e-5)
    force = (MASS[row] + ADDED.get(name, 0.0)) * d[-1]
    np.testing.assert_allclose(found["K_secant"][row], force / x[-1], rtol=1e-5)
    np.testing.assert_allclose(found["K_tangent"][row], tangent(name), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found["energy_share"], found["energy_lost"], rtol=1e-12)


def test_wrong_names_are_told() -> None:
    with pytest.raises(KeyError, match=f"there are {', '.join(element_names())}"):
        element("voigt")
    with pytest.raises(KeyError, match="maxwell has the parameters"):
        impact("maxwell", {"K": 1.0}, MASS, VELOCITY, TIME)


@pytest.mark.parametrize("name", NAMES)
def test_an_absurd_impact_leaves_the_others_their_motion(name):
    made = element(name)
    sound = {key: np.full(3, value) for key, value in VALUES[name].items()}
    first = next(iter(sound))
    absurd = sound | {first: np.array([1.0, 1e200, 1.0]) * sound[first]}
    count = TIME.shape[1]
    times = np.full(3, 5e-5), np.full(3, 0.02 / count)
    among, alone = (
        np.asarray(even_grid(Collision.of(made, each, MASS, VELOCITY), *times, count=count))[:, [0, 2]]
        for each in (absurd, sound)
    )
    np.testing.assert_allclose(among, alone, rtol=1e-9, atol=1e-12 * np.abs(alone).max())
