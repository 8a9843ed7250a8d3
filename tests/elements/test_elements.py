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
    after_contact,
    power_lost,
    solved,
    tangent,
)
from scipy.linalg import expm

from bayestissue.mechanics.elements import element, element_names, impact, linear, outcomes, solver
from bayestissue.mechanics.elements.element import Collision, complete
from bayestissue.mechanics.oscillator import impact_motion, spring_damper_inverse
from tissues import arm, hertz

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


@pytest.mark.parametrize("name", NAMES)
def test_flight_before_and_after_contact_is_free(name: str) -> None:
    made = impact(name, VALUES[name], MASS, VELOCITY, TIME - 0.002)
    time = TIME - 0.002
    before, after = time < 0, time > np.asarray(made.leaves)[:, None]
    assert before.any(1).all()
    np.testing.assert_allclose(
        np.where(before, made.x, 0), np.where(before, time * VELOCITY[:, None], 0), atol=1e-15
    )
    assert not np.where(before | after, made.deceleration, 0).any()
    left = np.asarray(made.v)[:, -1]
    later = np.linspace(1e-4, 0.01, TIME.shape[1])
    beyond = impact(name, VALUES[name], MASS, VELOCITY, np.asarray(made.leaves)[:, None] + later)
    np.testing.assert_allclose(beyond.v[:, 0], beyond.v[:, -1], rtol=1e-12)
    np.testing.assert_allclose(beyond.x[:, -1] - beyond.x[:, 0], beyond.v[:, 0] * 0.0099, rtol=1e-9)
    assert np.isfinite(left).all()


@pytest.mark.parametrize("name", ["kelvin_voigt", "stiffening"])
def test_flight_along_gravity_is_a_fall(name: str) -> None:
    made = impact(name, VALUES[name], MASS, VELOCITY, TIME - 0.002, gravity=9.80665)
    time = TIME - 0.002
    for free in (time < 0, time > np.asarray(made.leaves)[:, None]):
        bend = np.diff(made.v, axis=1) / np.diff(time, axis=1)
        within = free[:, 1:] & free[:, :-1]
        np.testing.assert_allclose(bend[within], 9.80665, rtol=1e-9)
    before = time < 0
    x = time * VELOCITY[:, None] + 9.80665 * time**2 / 2
    np.testing.assert_allclose(np.where(before, made.x, 0), np.where(before, x, 0), atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_a_drops_energy_is_stored_lost_or_still_there(name: str) -> None:
    """What C_equivalent takes over the independent path is what came in less what is stored.

    M V^2 / 2 + M g x, or where tissue moves along what is left of that after contact.
    """
    found, begins = outcomes(name, VALUES[name], MASS, VELOCITY, gravity=9.80665), after_contact(name)
    for row in range(len(MASS)):
        peak = float(found.time_to_peak[row])
        time = np.linspace(0, peak, 2001)
        x, v, force, lost = solved(name, row, time, 9.80665)
        assert abs(v[-1]) < 1e-6 * VELOCITY[row]
        np.testing.assert_allclose(found.peak_depth[row], x[-1], rtol=1e-6)
        taken = MASS[row] * (begins[row] ** 2 / 2 + 9.80665 * x[-1])
        np.testing.assert_allclose(np.trapezoid(MASS[row] * force, x), taken, rtol=1e-5)
        damping = np.trapezoid(lost, time) / np.trapezoid(v**2, time)
        np.testing.assert_allclose(found.C_equivalent[row], damping, rtol=1e-5)
    # Until it leaves: what it has lost of its kinetic energy, and the work of the force over the path.
    leaves = np.asarray(impact(name, VALUES[name], MASS, VELOCITY, TIME, gravity=9.80665).leaves)
    assert np.isfinite(leaves).any()
    for row in np.flatnonzero(np.isfinite(leaves)):
        x, v, force, _ = solved(name, row, np.linspace(0, leaves[row], 4001), 9.80665)
        np.testing.assert_allclose(found.energy_lost[row], 1 - (v[-1] / VELOCITY[row]) ** 2, rtol=1e-5)
        # What the blow took away is work on the tissue too.
        blow = MASS[row] * (VELOCITY[row] ** 2 - begins[row] ** 2) / 2
        work = (blow + np.trapezoid(MASS[row] * force, x)) / (MASS[row] * VELOCITY[row] ** 2 / 2)
        np.testing.assert_allclose(found.energy_share[row], work, rtol=1e-4)
    assert (found.energy_share >= found.energy_lost).all()


@partial(jax.jit, static_argnames=("name", "count"))
def even_grid(name: str, p: Any, mass: Any, velocity: Any, *times: Any, count: int) -> Any:
    collision = Collision(element(name), p, mass, velocity)
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
    values = {key: np.full(3, value) for key, value in VALUES[name].items()}
    peak = np.asarray(outcomes(name, VALUES[name], MASS, VELOCITY).time_to_peak)
    dt, first = peak / (count - 1), peak / (count - 1) * np.array([0.0, 0.4, 1.0])
    y = even_grid(name, complete(which, values, None, gravity), MASS, VELOCITY, first, dt, count=count)
    time = first[:, None] + dt[:, None] * np.arange(count)
    made = impact(name, VALUES[name], MASS, VELOCITY, time, gravity=gravity)
    tolerance = EXACT if which.linear else SOLVED
    for ours, theirs in zip(y[:2], made[:2], strict=True):
        assert np.abs(ours - theirs).max() < tolerance * np.abs(theirs).max()


@pytest.mark.parametrize("name", VALUES)
def test_energy_given_up_is_stored_or_spent(name: str) -> None:
    """F v = d(stored)/dt + what the dampers take, which is never negative."""
    which = element(name)
    p = {k: np.asarray(v) + np.zeros(1) for k, v in complete(which, VALUES[name], None).items()}
    x, v = jnp.array([0.008]), jnp.array([0.6])
    s = (jnp.array([0.003]),) * which.states

    @jax.jit
    def taken(x: jax.Array, v: jax.Array, s: tuple[jax.Array, ...]) -> jax.Array:
        flow = which.rates(x, v, s, p)
        _, kept = jax.jvp(lambda x, v, s: which.stored(x, v, s, p), (x, v, s), (v, jnp.zeros(1), flow))
        return which.force(x, v, s, p) * v - kept

    # An arm's spring is what penetration is beyond the internal length.
    stretched = arm(name, VALUES[name])[0] * (0.008 - 0.003)
    lost = power_lost(name, 0.008, 0.6, stretched)
    assert lost > 0
    np.testing.assert_allclose(taken(x, v, s), lost, rtol=1e-10)


def test_kelvin_voigt_is_the_closed_form() -> None:
    made = impact("kelvin_voigt", {"K": 3000.0, "C": 25.0}, MASS, VELOCITY, TIME)
    omega_n, zeta = spring_damper_inverse(3000.0, 25.0, MASS)
    closed = impact_motion(TIME, omega_n[:, None], zeta[:, None], VELOCITY[:, None])
    inside = np.asarray(made.leaves)[:, None] >= TIME
    for ours, theirs in zip(made[:3], closed, strict=True):
        assert np.abs(np.where(inside, ours - theirs, 0)).max() < EXACT * np.abs(theirs).max()


def test_standard_linear_goes_from_maxwell_to_kelvin_voigt() -> None:
    """Its arm rigid it is a spring and damper side by side; its lone spring gone, a Maxwell element."""

    at_times = jax.jit(
        lambda name, *given: linear.at_times(Collision(element(name), *given[:-1]), given[-1]),
        static_argnums=0,
    )

    def x(name: str, **values: float) -> np.ndarray:
        which = element(name)
        return np.asarray(at_times(name, complete(which, values, None), MASS, VELOCITY, TIME)[0])

    # The arm's relaxation time, C / (1e7 K), is 1e-9 s: a millionth of the time to peak, as is the lone
    # spring's share of the force below.
    rigid, side_by_side = (
        x("standard_linear", K=3000.0, C=25.0, arm_ratio=1e7),
        x("kelvin_voigt", K=3000.0, C=25.0),
    )
    assert np.abs(rigid - side_by_side).max() < 1e-6 * side_by_side.max()
    alone, in_series = x("standard_linear", K=3e-4, C=150.0, arm_ratio=1e7), x("maxwell", K=3000.0, C=150.0)
    assert np.abs(alone - in_series).max() < 1e-6 * in_series.max()


def test_stiffening_and_wall_without_their_depths_are_linear() -> None:
    plain = impact("kelvin_voigt", {"K": 3000.0, "C": 25.0}, MASS, VELOCITY, TIME)
    for name, extra in (("stiffening", {"stiffening_depth_m": 1e4}), ("wall", {"thickness_m": 1e6})):
        made = impact(name, {"K": 3000.0, "C": 25.0, **extra}, MASS, VELOCITY, TIME)
        assert np.abs(made.deceleration - plain.deceleration).max() < SOLVED * plain.deceleration.max()


def test_hertz_force_follows_the_balls_diameter() -> None:
    which = element("hunt_crossley")
    for diameter in (0.0254, 0.0318, 0.0381):
        p = complete(which, VALUES["hunt_crossley"], diameter)
        force = which.force(jnp.array([0.004]), jnp.array([0.5]), (), p)
        np.testing.assert_allclose(force, hertz(VALUES["hunt_crossley"], 0.004, 0.5, diameter), rtol=1e-12)


def test_wall_grows_on_behind_itself_without_a_seam() -> None:
    which, edge = element("wall"), 0.95 * 0.03
    p = complete(which, VALUES["wall"], None)

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
def test_derivatives_agree_with_differences(name: str) -> None:
    names, which = list(VALUES[name]), element(name)
    base = jnp.log(jnp.array([VALUES[name][each] for each in names] + [1.0]))
    time = 0.6 * TIME[:, ::9]

    def made(logs: jax.Array) -> dict[str, jax.Array]:
        p = dict(zip(names, jnp.exp(logs[:-1]), strict=True))
        velocity = VELOCITY + logs[-1]
        path = impact(name, p, MASS, velocity, time)
        found = outcomes(name, p, MASS, velocity)
        return {"d": path.deceleration, "K": found.K_secant, "C": found.C_equivalent, "e": found.energy_lost}

    # Compiled once, slopes and values.
    both = jax.jit(jax.jacfwd(lambda logs: (made(logs),) * 2, has_aux=True))
    slopes, _ = both(base)
    step = 1e-5
    # A linear element: rounding over the step. Another: K moves the solver's nodes, and so its error, 1e-9.
    tolerance = 1e-6 if which.linear else 1e-4
    for k in range(len(names) + 1):
        change = step * np.eye(len(names) + 1)[k]
        high, low = both(base + change)[1], both(base - change)[1]
        for key, slope in slopes.items():
            difference = (high[key] - low[key]) / (2 * step)
            scale = max(np.abs(difference).max(), np.abs(high[key]).max())
            assert np.abs(slope[..., k] - difference).max() < tolerance * scale


@pytest.mark.parametrize(
    "name", ["kelvin_voigt", pytest.param("maxwell", marks=pytest.mark.long), "standard_linear"]
)
def test_derivatives_are_finite_where_roots_repeat(name: str) -> None:
    """Kelvin-Voigt at zeta = 1, Maxwell at its own double root, and a standard linear solid beside them."""
    mass = np.array([0.7])
    values = {
        "kelvin_voigt": {"K": 2800.0, "C": 2 * np.sqrt(2800.0 * 0.7)},
        "maxwell": {"K": 2800.0, "C": np.sqrt(2800.0 * 0.7) / 2},
        # A triple root: the arm a = 8 K, its damper c = 8 K sqrt(M / (27 K)).
        "standard_linear": {"K": 2800.0, "C": 8 * 2800.0 * np.sqrt(0.7 / (27 * 2800.0)), "arm_ratio": 8.0},
    }[name]
    names = list(values)

    def d(logs: jax.Array) -> jax.Array:
        p = dict(zip(names, jnp.exp(logs), strict=True))
        return impact(name, p, mass, 1.5, TIME[:1, ::9]).deceleration

    base = jnp.log(jnp.array([values[each] for each in names]))
    both = jax.jit(jax.jacfwd(lambda logs: (d(logs),) * 2, has_aux=True))
    slopes, _ = both(base)
    for k in range(len(names)):
        change = 1e-5 * np.eye(len(names))[k]
        difference = (both(base + change)[1] - both(base - change)[1]) / 2e-5
        assert np.abs(slopes[..., k] - difference).max() < 1e-6 * np.abs(slopes).max()


@pytest.mark.parametrize("name", NAMES)
def test_outcomes_are_what_they_say(name: str) -> None:
    found = outcomes(name, VALUES[name], MASS, VELOCITY)
    row = 1
    time = np.linspace(0, float(found.time_to_peak[row]), 4001)
    x, v, d, lost = solved(name, row, time)
    tolerance = 1e-6
    np.testing.assert_allclose(v[-1], 0, atol=tolerance * VELOCITY[row])
    np.testing.assert_allclose(found.peak_depth[row], x[-1], rtol=tolerance)
    np.testing.assert_allclose(
        found.K_secant[row], (MASS[row] + ADDED.get(name, 0.0)) * d[-1] / x[-1], rtol=1e-5
    )
    np.testing.assert_allclose(found.K_tangent[row], tangent(name), rtol=1e-12, atol=1e-12)
    damping = np.trapezoid(lost, time) / np.trapezoid(v**2, time)
    np.testing.assert_allclose(found.C_equivalent[row], damping, rtol=1e-5)
    assert (found.C_equivalent > 0).all()
    assert ((found.energy_lost > 0) & (found.energy_lost < 1)).all()
    np.testing.assert_allclose(found.energy_share, found.energy_lost, rtol=1e-12)


def test_an_impact_that_leaves_at_the_surface_loses_what_units_allow() -> None:
    """Of 4 K, 2 C and 2 V the path is the same in half the time, and the share of energy lost too.

    With little damping the force of a wall ends at the surface, where it bends.
    """

    def lost(logs: jax.Array) -> jax.Array:
        p = {"K": 1500.0 * jnp.exp(logs[0]), "C": jnp.exp(logs[1]), "thickness_m": 0.03}
        return outcomes("wall", p, MASS, VELOCITY * jnp.exp(logs[2])).energy_lost

    slopes = jax.jit(jax.jacfwd(lost))(jnp.zeros(3))
    np.testing.assert_allclose(slopes @ np.array([1.0, 0.5, 0.5]), 0.0, atol=1e-4 * np.abs(slopes).max())


def test_wrong_names_are_told() -> None:
    with pytest.raises(KeyError, match=f"there are {', '.join(element_names())}"):
        element("voigt")
    with pytest.raises(KeyError, match="maxwell has the parameters"):
        impact("maxwell", {"K": 1.0}, MASS, VELOCITY, TIME)


@pytest.mark.parametrize("absurd", [1e12, 1e300, np.inf, np.nan])
def test_an_absurd_impact_is_no_concern_of_the_others(absurd):
    """Of the exponentials of several matrices each is what it is alone."""
    sound = np.array([[[0.0, 1.0], [-2.0, -0.3]], [[0.0, 1.0], [-40.0, -5.0]]])
    other = np.array([[[0.0, 1.0], [-absurd, -absurd]]])
    exponential = jax.jit(linear._exponential)
    alone = np.stack([np.asarray(exponential(matrix)) for matrix in sound])
    among = np.asarray(exponential(np.concatenate([sound, other])))[:2]
    # Sums of a dozen products in another order.
    np.testing.assert_allclose(among, alone, rtol=1e-14)
    np.testing.assert_allclose(alone, [expm(matrix) for matrix in sound], rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_an_absurd_impact_leaves_the_others_their_motion(name):
    made = element(name)
    sound = {key: np.full(3, value) for key, value in VALUES[name].items()}
    first = next(iter(sound))
    absurd = sound | {first: np.array([1.0, 1e200, 1.0]) * sound[first]}
    count = TIME.shape[1]
    times = MASS, VELOCITY, np.full(3, 5e-5), np.full(3, 0.02 / count)
    among, alone = (
        np.asarray(even_grid(name, complete(made, each, None), *times, count=count))[:, [0, 2]]
        for each in (absurd, sound)
    )
    np.testing.assert_allclose(among, alone, rtol=1e-9, atol=1e-12 * np.abs(alone).max())
