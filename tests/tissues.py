"""The laws of tissue written a second time, in numpy, and an impact's motion by scipy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

Parameters = Mapping[str, float]


def hertz(p: Parameters, x: np.ndarray, v: np.ndarray, diameter: float = 0.0318) -> np.ndarray:
    """F on a ball that meets K at a depth of 10 mm if it is one of 31.8 mm."""
    modulus = 0.75 * p["K"] / np.sqrt(0.0159 * 0.01)
    k = 4 / 3 * modulus * np.sqrt(diameter / 2)
    c = p["C"] * np.sqrt(diameter / 0.0318) / 0.01**1.5
    return (k + c * v) * np.maximum(x, 0.0) ** 1.5


# F of penetration, its velocity and the force f of a Maxwell arm.
FORCE: dict[str, Callable[..., np.ndarray]] = {
    "kelvin_voigt": lambda p, x, v, f: p["K"] * x + p["C"] * v,
    "maxwell": lambda p, x, v, f: f,
    "standard_linear": lambda p, x, v, f: p["K"] * x + f,
    "stiffening": lambda p, x, v, f: p["K"] * x + p["K"] / p["stiffening_depth_m"] ** 2 * x**3 + p["C"] * v,
    "hunt_crossley": lambda p, x, v, f: hertz(p, x, v),
    "wall": lambda p, x, v, f: p["K"] * x * p["thickness_m"] / (p["thickness_m"] - x) + p["C"] * v,
    "moving_mass": lambda p, x, v, f: p["K"] * x + p["C"] * v,
}


def arm(name: str, p: Parameters) -> tuple[float, float]:
    """Spring k and damper c of a Maxwell arm, where the program has lengths: f' = k v - f k / c."""
    if name == "maxwell":
        return p["K"], p["C"]
    return (p["arm_ratio"] * p["K"], p["C"]) if name == "standard_linear" else (0.0, 1.0)


class Path(NamedTuple):
    """An impact from contact on; times are arrays [s]."""

    rates: Callable[[np.ndarray], np.ndarray]
    states: Callable[[np.ndarray], np.ndarray]
    gravity: float

    def deceleration(self, time: np.ndarray) -> np.ndarray:
        """The force on the impactor over its mass."""
        return self.gravity - self.rates(self.states(time))[1]

    def jerk(self, time: np.ndarray) -> np.ndarray:
        """Its slope in time, by states a little later and earlier along the tangent."""
        y, step = self.states(time), 1e-6
        ahead, behind = (self.rates(y + sign * step * self.rates(y))[1] for sign in (1, -1))
        return -(ahead - behind) / (2 * step)


def path(name: str, p: Parameters, mass: float, velocity: float, until: float, gravity: float = 0.0) -> Path:
    """(M + m) x'' = M g - F by scipy's eighth-order method; the impactor feels M (g - x'')."""
    moves, (k, c) = mass + p.get("moving_mass_kg", 0.0), arm(name, p)

    def rates(y: np.ndarray) -> np.ndarray:
        x, v, f = y
        return np.stack([v, (mass * gravity - FORCE[name](p, x, v, f)) / moves, k * v - f * k / c])

    # All momentum is still there once tissue moves along.
    start = [0.0, velocity * mass / moves, 0.0]
    solved = solve_ivp(
        lambda _, y: rates(y), (0, until), start, "DOP853", rtol=1e-12, atol=1e-14, dense_output=True
    )
    return Path(rates, solved.sol, gravity)
