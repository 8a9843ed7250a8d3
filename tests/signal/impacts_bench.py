"""Impacts in closed form, from the roots of the equation of motion, and recorded by a perfect lab."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd


@dataclass
class Recorded:
    time_s: np.ndarray
    value: np.ndarray


@dataclass
class Lab:
    impacts: pd.DataFrame
    traces: list[Recorded]
    quantity: str = "deceleration"
    recorder: None = None


@dataclass
class Impact:
    """A mass that meets a spring and a damper; the tissue pushes until twice the time to peak."""

    omega: float
    zeta: float
    velocity: float = 1.5

    @property
    def roots(self) -> tuple[complex, complex]:
        # Two equal roots have another closed form: just beside them this one is right to 1e-8.
        zeta = self.zeta if abs(self.zeta - 1) > 1e-6 else 1 + 1e-6
        root = np.sqrt(complex(zeta**2 - 1))
        return self.omega * (-zeta + root), self.omega * (-zeta - root)

    @property
    def time_to_peak(self) -> float:
        p, q = self.roots
        return float((np.log(q / p) / (p - q)).real)

    def derivative(self, order: int, time: np.ndarray) -> np.ndarray:
        p, q = self.roots
        parts = p**order * np.exp(p * time) - q**order * np.exp(q * time)
        return (self.velocity * parts / (p - q)).real

    def deceleration(self, time: np.ndarray) -> np.ndarray:
        pushes = (time >= -1e-12) & (time < 2 * self.time_to_peak)
        return np.where(pushes, -self.derivative(2, np.maximum(time, 0)), 0)


def record(
    impacts: list[Impact],
    rate: float,
    *,
    before: float = 0.01,
    after: float = 0.005,
    phase: np.ndarray | float = 0.0,
    noise: float = 0.0,
    offset: float = 0.0,
    seed: int = 0,
) -> Lab:
    """Recordings on a clock whose 0 is contact; noise is a fraction of the peak, phase one of an interval."""
    random = np.random.default_rng(seed)
    traces = []
    for impact, part in zip(impacts, np.broadcast_to(phase, len(impacts)), strict=True):
        last = int(np.ceil((2 * impact.time_to_peak + after) * rate))
        time = (np.arange(-round(before * rate), last) + part) / rate
        value = impact.deceleration(time)
        value = value + offset + noise * value.max() * random.standard_normal(len(value))
        traces.append(Recorded(time, value))
    table = pd.DataFrame({"mass_kg": 1.0, "velocity_m_s": [impact.velocity for impact in impacts]})
    return Lab(table, traces)
