"""Elements with values, and what their equations, written a second time, make of an impact."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from tissues import FORCE, arm, path

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
# Of tissue that moves along [kg].
ADDED = {"moving_mass": 0.2}


def force(name: str, x: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
    return FORCE[name](VALUES[name], x, v, f)


def power_lost(name: str, x: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
    """What dampers take [W]: one beside the spring pushes with F(x, v) - F(x, 0), that of an arm with f."""
    return (force(name, x, v, f) - force(name, x, 0 * v, f)) * v + f**2 / arm(name, VALUES[name])[1]


def tangent(name: str) -> float:
    """The force's slope where penetration begins, all dampers at rest; of a step over which nothing bends."""
    step = np.array(1e-60)
    return float(force(name, step, 0 * step, arm(name, VALUES[name])[0] * step) / step)


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
    found = path(name, VALUES[name], MASS[row], VELOCITY[row], time[-1], gravity)
    x, v, f = found.states(time)
    return Motion(x, v, found.deceleration(time), power_lost(name, x, v, f))
