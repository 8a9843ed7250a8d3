"""Force over depth at one depth and at the greatest, of elements and of elements with a discrepancy."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from bayestissue.inference.quantities.whole import (
    Whole,
    at_common_depth,
    static_force,
    whole_at_common_depth,
    whole_impact,
)
from bayestissue.mechanics.elements import element, impact, outcomes
from bayestissue.mechanics.elements.element import GRAVITY, Element
from bayestissue.model.likelihood.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.record import Contact, DecelerationRecord
from bayestissue.model.likelihood.response import motion

pytestmark = pytest.mark.slow

MASS, VELOCITY, DT = np.array([0.5, 1.2]), np.array([1.5, 1.0]), np.full(2, 2e-4)
FIRST, DEPTH = np.array([5e-5, 1.5e-4]), jnp.full(2, 0.012)
STIFF = {"K": 2000.0, "C": 20.0, "stiffening_depth_m": 0.02}
BALL = {"K": 2500.0, "C": 30.0}
WALL = {"K": 2000.0, "C": 25.0, "thickness_m": 0.05}
SIDE_BY_SIDE = {"K": 2600.0, "C": 25.0}
NONE = jnp.zeros(2)
# a goes to the peak along a parabola through three samples, up to three samples past the middle one: this
# leaves 4 * 3 * 2 / 6 of (omega dt)^3 of it, and twice that for a spring that stiffens, with the greatest
# tangent stiffness over mass, omega^2 = 1.06e4 / s^2.
TOLERANCE = 8 * (1.06e4 * 2e-4**2) ** 1.5
# Between contact and the first sample, of up to 80, a discrepancy is taken as constant; the rest is trapezia.
OF_DISCREPANCY = 1e-3
# Its slope is off by (3 * 2^2 - 1) / 6 of (omega dt)^2, several times that where force goes with depth^(3/2).
OF_DAMPING = 3e-3
EPSILON = np.finfo(float).eps
# Of all records, so that they share what is compiled: past the longest window.
WIDTH = 160


def measured(
    name: str, values: dict[str, float], to_peak: np.ndarray, off: int = 0, gravity: float | None = None
) -> MeasuredImpact:
    """A record whose window ends so many samples after the last before the greatest penetration."""
    count = np.floor((to_peak - FIRST) / DT).astype(int) + 1 + off
    still = np.zeros((2, WIDTH))
    surroundings = {"diameter_m": np.full(2, 0.0318)}
    if gravity is not None:
        surroundings[GRAVITY] = np.full(2, gravity)
    given = (FIRST, DT, VELOCITY, np.zeros((2, 4)), MASS, surroundings, Contact.known(np.zeros(2, bool)))
    parameters = jnp.array([np.full(2, value) for value in values.values()])
    record = DecelerationRecord.from_arrays(still, count, *given)
    return MeasuredImpact(element(name), parameters, NoiseParameters(NONE), record)


@partial(jax.jit, static_argnums=0)
def _whole(
    which: Element, parameters: Array, record: DecelerationRecord, delta: Array, error: Array
) -> Whole:
    return whole_impact(MeasuredImpact(which, parameters, NoiseParameters(NONE), record), delta, error)


def whole(given: MeasuredImpact, delta: Array, error: Array) -> Whole:
    return _whole(given.element, given.parameters, given.record, delta, error)


@jax.jit
def _motion(given: MeasuredImpact) -> Any:
    return motion(given.collision, given.record)


def as_discrepancy(
    tissue: str, values: dict[str, float], gravity: float | None = None
) -> tuple[MeasuredImpact, Whole]:
    """A tissue's impacts as spring and damper, with all that these lack of it as discrepancy."""
    true = outcomes(tissue, values, MASS, VELOCITY, gravity=gravity)
    given = measured("kelvin_voigt", SIDE_BY_SIDE, np.asarray(true["time_to_peak"]), gravity=gravity)
    *_, own = _motion(given)
    all_of_it = impact(tissue, values, MASS, VELOCITY, given.record.time(), gravity=gravity).deceleration
    return given, whole(given, all_of_it - own, NONE)


@pytest.mark.parametrize("gravity", [None, 9.80665])
def test_the_secant_is_that_of_element_and_discrepancy_together(gravity: float | None) -> None:
    """What spring and damper lack of a stiffening element, given as discrepancy, makes up its secant."""
    true = outcomes("stiffening", STIFF, MASS, VELOCITY, gravity=gravity)
    _, found = as_discrepancy("stiffening", STIFF, gravity)
    np.testing.assert_allclose(found.secant, true["K_secant"], rtol=OF_DISCREPANCY)
    np.testing.assert_allclose(found.peak, true["peak_depth"], rtol=OF_DISCREPANCY)
    np.testing.assert_allclose(found.damping, STIFF["C"], rtol=OF_DAMPING)
    assert (np.abs(SIDE_BY_SIDE["K"] / true["K_secant"] - 1) > 0.02).all()


def test_a_faster_impactor_goes_deeper() -> None:
    faster = outcomes("stiffening", STIFF, MASS, VELOCITY + 0.05)
    given = measured("stiffening", STIFF, np.asarray(faster["time_to_peak"]))
    found = whole(given, jnp.zeros_like(given.record.d), jnp.full(2, 0.05))
    np.testing.assert_allclose(found.secant, faster["K_secant"], rtol=TOLERANCE)
    np.testing.assert_allclose(found.peak, faster["peak_depth"], rtol=TOLERANCE)


@pytest.mark.parametrize(
    ("name", "values", "viscous"),
    [
        ("stiffening", STIFF, 20.0),
        pytest.param("wall", WALL, 25.0, marks=pytest.mark.long),
        ("hunt_crossley", BALL, 30.0 * 1.2**1.5),
    ],
)
def test_an_element_s_stiffness_at_one_depth_is_its_simulated_force_there(name, values, viscous) -> None:
    """The same for every mass, whatever the impactor's size, and its impacts' force less the damper's."""
    which, p = element(name), {key: jnp.full(2, value) for key, value in values.items()}
    sizes: Any = {**p, "diameter_m": jnp.array([0.02, 0.05])}
    found = jax.jit(partial(at_common_depth, which))(sizes, DEPTH)
    np.testing.assert_allclose(found[0], found[1], rtol=4 * EPSILON)
    time = np.linspace(0, np.asarray(outcomes(name, values, MASS, VELOCITY)["time_to_peak"]), 2001).T
    path = impact(name, values, MASS, VELOCITY, time)
    for row, stiffness in enumerate(found):
        x = np.asarray(path.x)[row]
        force, speed = (
            np.interp(DEPTH[row], x, values)
            for values in (MASS[row] * np.asarray(path.deceleration)[row], np.asarray(path.v)[row])
        )
        # The solver's 1e-6, and 1e-7 of a straight line between one of 2000 samples and the next.
        np.testing.assert_allclose(force, stiffness * DEPTH[row] + viscous * speed, rtol=3e-6)


@pytest.mark.parametrize(
    ("name", "values"), [("stiffening", STIFF), pytest.param("wall", WALL, marks=pytest.mark.long)]
)
def test_beside_a_discrepancy_the_law_at_one_depth_is_found_whatever_the_mass(name, values) -> None:
    given, found = as_discrepancy(name, values)
    np.testing.assert_allclose(found.damping, values["C"], rtol=OF_DISCREPANCY)
    p: Any = {key: jnp.full(2, value) for key, value in values.items()}
    true = static_force(element(name), {**p, "diameter_m": NONE}, DEPTH) / DEPTH
    np.testing.assert_allclose(whole_at_common_depth(given, found, DEPTH), true, rtol=OF_DISCREPANCY)
