"""Impacts in closed form, from the roots of the equation of motion, and recorded by a perfect lab."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

import bayestissue as bt
from bayestissue.recordings.dataset.dataset_file import Contact, Uncertainty


@dataclass
class Recorded:
    time_s: np.ndarray
    value: np.ndarray
    clipped: np.ndarray | None = None


@dataclass
class Lab:
    impacts: pd.DataFrame
    traces: list[Recorded]
    quantity: str = "deceleration"
    recorder: None = None
    gravity: float = 0.0
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    contact: Contact | None = None

    def changed(self, change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Lab:
        """The same with other times and values in each recording."""
        pairs = [change(trace.time_s, trace.value.copy()) for trace in self.traces]
        return replace(self, traces=[Recorded(time, value) for time, value in pairs])

    def moved(self, by: float) -> Lab:
        """The same on a clock that is ahead."""
        return self.changed(lambda time, value: (time + by, value))

    def dataset(self, mass: float = 0.5, *, columns: dict[str, Any] | None = None, **said: Any) -> bt.Dataset:
        """The same as a caller in Python has it: impacts of one person, unless the columns say others."""
        names = [f"i{number}" for number in range(len(self.impacts))]
        impacts = self.impacts.assign(impact=names, mass_kg=mass, **{"subject": "s"} | (columns or {}))
        traces = [(trace.time_s, trace.value) for trace in self.traces]
        return bt.dataset(impacts, traces, quantity="deceleration", unit="m/s^2", **said)

    def select(self, rows: slice) -> Lab:
        return replace(self, impacts=self.impacts.iloc[rows], traces=self.traces[rows])


@dataclass
class Impact:
    """A mass that meets a spring and a damper; the tissue pushes until twice the time to peak."""

    omega: float
    zeta: float
    velocity: float = 1.5
    gravity: float = 0.0

    @property
    def roots(self) -> tuple[complex, complex]:
        # Two equal roots have another closed form: just beside them this one is right to 1e-8.
        zeta = self.zeta if abs(self.zeta - 1) > 1e-6 else 1 + 1e-6
        root = np.sqrt(complex(zeta**2 - 1))
        return self.omega * (-zeta + root), self.omega * (-zeta - root)

    @property
    def rest(self) -> float:
        """Where gravity brings the mass to rest."""
        return self.gravity / self.omega**2

    @property
    def time_to_peak(self) -> float:
        p, q = self.roots
        turn = np.log(q * (self.velocity + p * self.rest) / p / (self.velocity + q * self.rest))
        time = (turn / (p - q)).real
        # The logarithm of a turn by more than half of one.
        return float(time if time > 0 else time + 2 * np.pi / (p - q).imag)

    def derivative(self, order: int, time: np.ndarray) -> np.ndarray:
        p, q = self.roots
        parts = (self.velocity + q * self.rest) * p**order * np.exp(p * time)
        parts = parts - (self.velocity + p * self.rest) * q**order * np.exp(q * time)
        return (parts / (p - q)).real + (self.rest if order == 0 else 0.0)

    def deceleration(self, time: np.ndarray) -> np.ndarray:
        """Force over mass, 0 before contact and when the tissue no longer pushes."""
        force = self.gravity - self.derivative(2, np.maximum(time, 0))
        pushes = (time >= -1e-12) & (time < 2 * self.time_to_peak)
        pulls = (time > self.time_to_peak) & (force <= 0)
        return np.where(pushes & ~np.logical_or.accumulate(pulls), force, 0)


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
    return Lab(table, traces, gravity=impacts[0].gravity)
