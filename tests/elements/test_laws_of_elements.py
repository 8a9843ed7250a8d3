"""Laws that hold of every element whatever its parameters are: no data, no second implementation.

All elements and all variants of the impacts are computed by one compiled function.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from element_values import VALUES
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from bayestissue.mechanics.elements import element
from bayestissue.mechanics.elements.element import Collision, Outcomes
from bayestissue.mechanics.elements.outcomes import outcomes_of

pytestmark = pytest.mark.slow

CASES = 8
VARIANTS = ("drop", "other units", "lossless", "level", "fast", "heavy", "spring and damper")
# Exponents of mass, length and time.
BASE = {"N": (1, 1, -2), "kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "1": (0, 0, 0)}


def dimensions(unit: str) -> tuple[int, ...]:
    """Those of a unit such as N s/m."""
    above, _, below = unit.partition("/")
    signed = [(1, one) for one in above.split()] + [(-1, one) for one in below.split()]
    return tuple(sum(sign * BASE[one][axis] for sign, one in signed) for axis in range(3))


OF_OUTCOMES = {
    "K_tangent": dimensions("N/m"),
    "K_secant": dimensions("N/m"),
    "C_equivalent": dimensions("N s/m"),
    "energy_lost": dimensions("1"),
    "energy_share": dimensions("1"),
    "energy_share_with_gravity": dimensions("1"),
    "peak_depth": dimensions("m"),
    "time_to_peak": (0, 0, 1),
    "peak_force": (1, 1, -2),
    "contact_duration": (0, 0, 1),
    "rebound_velocity": (0, 1, -1),
    "impulse": (1, 1, -1),
    "peak_jerk": (0, 1, -3),
}
# Its K is that of a ball of one size at one depth.
WITH_A_LENGTH_OF_ITS_OWN = ("hunt_crossley",)
# The factors at which nothing is lost: a damper in series must not yield, and no mass be taken along.
LOSSLESS = {"maxwell": {"C": 1e9}, "moving_mass": {"C": 1e-9, "moving_mass_kg": 1e-9}}
# What makes an element a spring and damper.
RIGID = {
    "standard_linear": {"arm_ratio": 1e7},
    "stiffening": {"stiffening_depth_m": 1e5},
    "wall": {"thickness_m": 1e7},
    "moving_mass": {"moving_mass_kg": 1e-9},
}
HEAVY, FAST = 100.0, 3.0
# The cubic between nodes of a path that is solved, as in test_elements.
SOLVED = 1e-6
# The same path on the same nodes but for rounding, which its end, where a force fades, makes greater.
UNITS_ALIKE = 1e-7
# Shares of energy are squares of the velocity at leaving: of a Hertz contact 2e-5 off, of a hard wall 2e-4.
ENERGY = 1e-3


class Impacts(NamedTuple):
    """Parameters by name, mass [kg], velocity [m/s], diameter [m] and gravity [m/s^2], each [impact]."""

    parameters: dict[str, np.ndarray]
    mass: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray
    gravity: np.ndarray


@jax.jit
def all_outcomes(impacts: dict[str, Impacts]) -> dict[str, Outcomes]:
    return {
        name: {"mass": mass, "velocity": velocity}
        | outcomes_of(Collision.of(element(name), p, mass, velocity, diameter=diameter, gravity=gravity))
        for name, (p, mass, velocity, diameter, gravity) in impacts.items()
    }


def variants(name: str, numbers: np.ndarray, units: np.ndarray) -> Impacts:
    """From logs of factors impacts, and what laws compare them with, one variant below the other."""
    values = {key: value * np.exp(numbers[:, k]) for k, (key, value) in enumerate(VALUES[name].items())}
    mass, velocity, gravity = (
        0.7 * np.exp(numbers[:, 3]),
        1.5 * np.exp(numbers[:, 4]),
        9.81 * (1 + numbers[:, 5]),
    )
    level = np.zeros(CASES)
    case = Impacts(values, mass, velocity, np.full(CASES, 0.0318), gravity)
    scale, lossless = of_units(name, units), LOSSLESS.get(name, {"C": 1e-9})
    parameter_units = {each.name: each.unit for each in element(name).parameters}
    made = {
        "drop": case,
        "other units": Impacts(
            {key: value * scale(dimensions(parameter_units[key])) for key, value in values.items()},
            mass * scale((1, 0, 0)),
            velocity * scale((0, 1, -1)),
            case.diameter * scale((0, 1, 0)),
            gravity * scale((0, 1, -2)),
        ),
        "lossless": case._replace(
            parameters=values | {key: values[key] * factor for key, factor in lossless.items()}
        ),
        "level": case._replace(gravity=level),
        "fast": case._replace(gravity=level, velocity=FAST * velocity),
        "heavy": case._replace(gravity=level, mass=HEAVY * mass),
        "spring and damper": case._replace(
            parameters=values | {key: np.full(CASES, value) for key, value in RIGID.get(name, {}).items()}
        ),
    }
    return jax.tree.map(lambda *each: np.concatenate(each), *(made[key] for key in VARIANTS))


def of_units(name: str, units: np.ndarray) -> Any:
    """The factor of a quantity with these exponents, in units of mass, length and time so much smaller."""
    log_sizes = 3 * units * np.array([1.0, name not in WITH_A_LENGTH_OF_ITS_OWN, 1.0])
    return lambda exponents: float(np.exp(log_sizes @ np.array(exponents)))


def holds(numbers: np.ndarray, units: np.ndarray) -> None:
    impacts = {name: variants(name, numbers, units) for name in VALUES}
    plain = impacts["kelvin_voigt"]
    of_limits = [
        Impacts({key: of.parameters[key] for key in "KC"}, *of[1:])
        for of in (jax.tree.map(lambda values: values[:CASES], impacts[name]) for name in RIGID)
    ]
    impacts["kelvin_voigt"] = jax.tree.map(lambda *each: np.concatenate(each), plain, *of_limits)
    found = jax.device_get(all_outcomes(impacts))
    for name in VALUES:
        each = {
            variant: {key: v[k * CASES : (k + 1) * CASES] for key, v in found[name].items()}
            for k, variant in enumerate(VARIANTS)
        }
        nothing_comes_from_nothing(name, each)
        other_units_are_no_other_impact(name, each, of_units(name, units))
        without_loss_time_may_run_backwards(name, each["lossless"])
        linear_elements_scale_with_velocity(name, each)
        heavy_impactors_lose_what_the_law_says(name, each)
        if name in RIGID:
            a_rigid_limit_is_spring_and_damper(name, each["spring and damper"], found["kelvin_voigt"])


def nothing_comes_from_nothing(name: str, each: dict[str, Outcomes]) -> None:
    """Passivity: what leaves has no more energy than came, and no more is kept than was given."""
    for variant, of in each.items():
        label = f"{name}, {variant}"
        assert (of["energy_share_with_gravity"] >= -ENERGY).all(), label
        assert (of["energy_share_with_gravity"] <= 1 + ENERGY).all(), label
        assert (of["C_equivalent"] >= -ENERGY * np.sqrt(of["K_secant"] * of["mass"])).all(), label
        assert (of["peak_depth"] > 0).all(), label
        assert (of["peak_force"] > 0).all(), label
        assert (of["rebound_velocity"] <= of["velocity"] * (1 + ENERGY)).all(), label


def other_units_are_no_other_impact(name: str, each: dict[str, Outcomes], scale: Any) -> None:
    """The same impact in grams, milliseconds or feet: times, masses and forces scale the outcomes."""
    for outcome, exponents in OF_OUTCOMES.items():
        here, there = (each[variant][outcome] for variant in ("drop", "other units"))
        np.testing.assert_array_equal(np.isfinite(here), np.isfinite(there), err_msg=f"{name} {outcome}")
        inside = np.isfinite(here)
        # Velocities at leaving and shares of energy are differences: of what came.
        size = (
            each["drop"]["velocity"] if outcome == "rebound_velocity" else np.full(CASES, "energy" in outcome)
        )
        scaled, size = (scale(exponents) * values[inside] for values in (here, size))
        away = np.abs(there[inside] - scaled)
        assert (away <= UNITS_ALIKE * np.maximum(np.abs(scaled), size)).all(), (name, outcome, away)


def without_loss_time_may_run_backwards(name: str, of: Outcomes) -> None:
    """From the deepest point on, the motion is that before it, backwards."""
    assert_allclose(of["contact_duration"], 2 * of["time_to_peak"], rtol=1e-4, err_msg=name)
    assert_allclose(of["rebound_velocity"], of["velocity"], rtol=ENERGY, err_msg=name)
    assert_allclose(of["energy_share_with_gravity"], 0, atol=ENERGY, err_msg=name)
    assert (np.abs(of["C_equivalent"]) < ENERGY * np.sqrt(of["K_secant"] * of["mass"])).all(), name


def linear_elements_scale_with_velocity(name: str, each: dict[str, Outcomes]) -> None:
    """Three times the velocity: three times the depth and force, the same times. Others do not."""
    if not element(name).linear:
        return
    for outcome in ("peak_depth", "peak_force", "rebound_velocity", "peak_jerk", "impulse"):
        here, there = (each[variant][outcome] for variant in ("level", "fast"))
        assert_allclose(
            there,
            FAST * here,
            rtol=1e-9,
            atol=1e-9 * np.abs(here[np.isfinite(here)]).max(initial=0),
            err_msg=name,
        )
    for outcome in ("time_to_peak", "contact_duration", "K_secant", "C_equivalent"):
        here, there = (each[variant][outcome] for variant in ("level", "fast"))
        assert_allclose(there, here, rtol=1e-8, err_msg=f"{name} {outcome}")


def heavy_impactors_lose_what_the_law_says(name: str, each: dict[str, Outcomes]) -> None:
    """A hundred times the mass: the motion is slower, and a damper beside a spring takes a smaller share.

    A damper of a Hertz contact, whose force is x^1.5 times one of v, takes a share that no mass changes.
    """
    light, heavy = each["level"]["energy_share"], each["heavy"]["energy_share"]
    if name == "hunt_crossley":
        assert_allclose(heavy, light, atol=ENERGY, err_msg=name)
    elif name in ("kelvin_voigt", "stiffening", "wall"):
        # Of a spring the share is 1 - exp(-2 pi zeta) or so, and zeta a tenth.
        assert (np.log1p(-heavy) > np.log1p(-light) / 3).all(), (name, light, heavy)


def a_rigid_limit_is_spring_and_damper(name: str, limit: Outcomes, found: Outcomes) -> None:
    """The last impacts of spring and damper have the K and C of the others' limits."""
    first = (len(VARIANTS) + list(RIGID).index(name)) * CASES
    for outcome in ("peak_depth", "time_to_peak", "contact_duration", "energy_share_with_gravity"):
        here, there = limit[outcome], np.asarray(found[outcome])[first : first + CASES]
        assert_allclose(
            here, there, rtol=1e-5, atol=ENERGY * ("energy" in outcome), err_msg=f"{name} {outcome}"
        )


# Logs of factors. Beyond these, what an overdamped impactor does long after its deepest point is decided by
# the end of a path, and laws hold to a thousandth only.
between = st.floats(-0.6, 0.6, allow_subnormal=False)
laws = given(
    numbers=arrays(float, (CASES, 6), elements=between, fill=st.nothing()),
    units=arrays(float, 3, elements=between),
)
plainly = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow, HealthCheck.data_too_large]}


@laws
@settings(max_examples=5, derandomize=True, phases=[Phase.generate], **plainly)
def test_laws_hold_of_every_element(numbers: np.ndarray, units: np.ndarray) -> None:
    holds(numbers, units)


@pytest.mark.long
@laws
@settings(max_examples=500, **plainly)
def test_laws_hold_of_thousands_of_impacts(numbers: np.ndarray, units: np.ndarray) -> None:
    holds(numbers, units)
