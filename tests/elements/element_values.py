"""Elements with values, and each one's equations written a second time, in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

MASS = np.array([0.375, 0.7, 1.333])
VELOCITY = np.array([1.2, 1.5, 1.0])
VALUES: dict[str, dict[str, float]] = {
    "kelvin_voigt": {"K": 3000.0, "C": 25.0},
    "maxwell": {"K": 3000.0, "C": 150.0},
    "standard_linear": {"K": 2500.0, "C": 30.0, "arm_ratio": 1.5},
    "stiffening": {"K": 2000.0, "C": 20.0, "stiffening_depth_m": 0.015},
    "hunt_crossley": {"K": 3000.0, "C": 60.0},
    "wall": {"K": 1500.0, "C": 20.0, "thickness_m": 0.03},
    "moving_mass": {"K": 3000.0, "C": 25.0, "moving_mass_kg": 0.2},
}

# Two of them by default, one solved in closed form and one on a grid; all in the long suite.
_BY_DEFAULT = ("standard_linear", "stiffening")
NAMES = [name if name in _BY_DEFAULT else pytest.param(name, marks=pytest.mark.long) for name in VALUES]


def hertz(x: float, v: float, diameter: float = 0.0318) -> float:
    """F for a half-space whose modulus gives 3000 N/m at 10 mm under a ball of 31.8 mm."""
    modulus = 0.75 * 3000.0 / np.sqrt(0.0159 * 0.01)
    k = 4 / 3 * modulus * np.sqrt(diameter / 2)
    c = 60.0 * np.sqrt(diameter / 0.0318) / 0.01**1.5
    return (k + c * v) * max(x, 0.0) ** 1.5


FORCE = {
    "kelvin_voigt": lambda x, v, f: 3000.0 * x + 25.0 * v,
    "maxwell": lambda x, v, f: f,
    "standard_linear": lambda x, v, f: 2500.0 * x + f,
    "stiffening": lambda x, v, f: 2000.0 * x + 2000.0 / 0.015**2 * x**3 + 20.0 * v,
    "hunt_crossley": lambda x, v, f: hertz(x, v),
    "wall": lambda x, v, f: 1500.0 * x * 0.03 / (0.03 - x) + 20.0 * v,
    "moving_mass": lambda x, v, f: 3000.0 * x + 25.0 * v,
}
# Of tissue that moves along [kg].
ADDED = {"moving_mass": 0.2}
# A Maxwell arm by its force f, where the program has lengths: f' = k v - f k / c.
ARM = {"maxwell": (3000.0, 150.0), "standard_linear": (3750.0, 30.0)}


NO_ARM = (0.0, 1.0)


def power_lost(name: str, x: float, v: float, f: float) -> float:
    """What dampers take [W]: one beside the spring pushes with F(x, v) - F(x, 0), that of an arm with f."""
    return (FORCE[name](x, v, f) - FORCE[name](x, 0.0, f)) * v + f**2 / ARM.get(name, NO_ARM)[1]


def tangent(name: str) -> float:
    """The force's slope where penetration begins, all dampers at rest; of a step over which nothing bends."""
    step = 1e-60
    return FORCE[name](step, 0.0, ARM.get(name, NO_ARM)[0] * step) / step


def after_contact(name: str) -> np.ndarray:
    """The velocity once tissue moves along: all momentum is still there."""
    return VELOCITY * MASS / (MASS + ADDED.get(name, 0.0))


class Motion(NamedTuple):
    """Penetration, its velocity, force on the impactor over M, and what the dampers take [W], each [time]."""

    x: np.ndarray
    v: np.ndarray
    deceleration: np.ndarray
    power_lost: np.ndarray


def solved(name: str, row: int, time: np.ndarray, gravity: float = 0.0) -> Motion:
    """(M + m) x'' = M g - F by scipy's eighth-order method; the impactor feels M (g - x'')."""
    force, moves = FORCE[name], MASS[row] + ADDED.get(name, 0.0)
    k, c = ARM.get(name, NO_ARM)

    def field(t: float, y: Sequence[float]) -> list[float]:
        x, v, f = y
        return [v, (MASS[row] * gravity - force(x, v, f)) / moves, k * v - f * k / c]

    start = [0.0, after_contact(name)[row], 0.0]
    x, v, f = solve_ivp(field, (0, time[-1]), start, "DOP853", time, rtol=1e-12, atol=1e-14).y
    states = list(zip(x, v, f, strict=True))
    d = np.array([gravity - field(0.0, list(state))[1] for state in states])
    return Motion(x, v, d, np.array([power_lost(name, *state) for state in states]))
