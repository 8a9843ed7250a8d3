"""Sound recordings of very different impacts: what no check may call spoilt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from evidence.simulations import simulation, tables
from jaxtyping import Float

from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.recordings.dataset.dataset_file import Quantity, Settings, SignalSettings
from bayestissue.studies.simulation.campaign import leaves, simulate

TABLES = tables(__file__)
FINE_HZ, REST_S = (TABLES["campaign"]["recording"][key] for key in ("sampling_rate_hz", "after_contact_s"))
RATES_HZ = (1000.0, 2000.0, 5000.0, 10_000.0)
TISSUES: dict[str, dict[str, Any]] = TABLES["tissues"]


@dataclass(frozen=True)
class Impact:
    """The noise-free motion of one impact on a fine grid, at rest for 40 ms before and after.

    Attributes:
        element: what was met.
        mass, velocity: kg, and m/s at contact.
        contact, to_peak, leaves: when contact is on this grid's clock, and the time from it to zero velocity
            and until the tissue no longer pushes, s.
        deceleration, displacement: [sample] at `FINE_HZ`, m/s² and m.
    """

    element: str
    mass: float
    velocity: float
    contact: float
    to_peak: float
    leaves: float
    deceleration: Float[np.ndarray, " sample"]
    displacement: Float[np.ndarray, " sample"]


@dataclass(frozen=True)
class Chain:
    """How one impact is recorded.

    Attributes:
        every: of the fine grid's samples one in so many is taken, the first one at ``phase``.
        phase: 0 to ``every`` - 1.
        noise: standard deviation of the sensor's white noise, as a fraction of the peak.
        before: from the first sample to contact, s.
        after: the recording ends so long after contact, s.
        levels: steps of the recorder between 0 and the peak.
        seed: of the noise.
    """

    every: int
    phase: int
    noise: float
    before: float
    after: float
    levels: int
    seed: int

    @property
    def dt(self) -> float:
        """Sampling interval, s."""
        return self.every / FINE_HZ


def impacts(count: int, seed: int = 0, elements: Sequence[str] = tuple(TISSUES)) -> list[Impact]:
    """Different impacts, 5 to 60 ms from contact to zero velocity, shuffled.

    Needs float64 (`bayestissue.base.runtime.configure`).

    Args:
        count: how many.
        seed: of the tissues, masses and velocities.
        elements: "kelvin_voigt" gets what is left when each other one has a tenth.
    """
    rng = np.random.default_rng([seed, 1])
    motions: list[Impact] = []
    for number, element in enumerate(elements):
        others = sum(name != "kelvin_voigt" for name in elements)
        share = count - others * (count // 10) if element == "kelvin_voigt" else count // 10
        motions += _of_element(element, share, rng, seed + number) if share else []
    return [motions[index] for index in rng.permutation(len(motions))]


def _of_element(element: str, count: int, rng: np.random.Generator, seed: int) -> list[Impact]:
    # Half as many again, since those that are too fast or too slow for the recorder are not used.
    drawn = count + count // 2 + 4
    masses, velocities = 10 ** rng.uniform(-0.4, 0.4, drawn), rng.uniform(0.6, 2.5, drawn)
    conditions = [(f"t{n}", *each) for n, each in enumerate(zip(masses, velocities, strict=True))]
    own = {"tissue": {"element": element, **TISSUES[element]}}
    design = {"subjects": 1, "conditions": conditions}
    campaign = simulate(simulation(TABLES["campaign"], own, name=element, seed=seed, design=design))
    truth = campaign.truth
    motions = [
        Impact(element, mass, velocity, contact, to_peak, until, d, _displacement(d, contact, velocity))
        for mass, velocity, contact, to_peak, until, d in zip(
            truth["mass_kg"],
            truth["velocity_m_s"],
            truth["contact_time_s"],
            truth["time_to_peak_s"],
            leaves(truth),
            (trace.value for trace in campaign.traces),
            strict=True,
        )
        if 0.005 < to_peak < 0.06
    ]
    return motions[:count]


def _displacement(d: np.ndarray, contact: float, velocity: float) -> np.ndarray:
    since = np.maximum(np.arange(d.size) / FINE_HZ - contact, 0)
    lost = np.cumsum(d) / FINE_HZ
    return velocity * since - np.cumsum(lost) / FINE_HZ


def chain(impact: Impact, rng: np.random.Generator) -> Chain:
    """A sound way to record an impact: 1 to 10 kHz, at least 15 samples until zero velocity, any length.

    One in three has no quiet part: at most four samples stand before contact.
    """
    possible = [rate for rate in RATES_HZ if rate * impact.to_peak >= 15] or [RATES_HZ[-1]]
    step = round(FINE_HZ / rng.choice(possible))
    after = rng.choice([impact.to_peak * rng.uniform(1.1, 1.7), impact.leaves + rng.uniform(0.002, REST_S)])
    few = rng.uniform(1, 4) * step / FINE_HZ
    return Chain(
        every=step,
        phase=int(rng.integers(step)),
        noise=float(10 ** rng.uniform(-3, -1.7)),
        before=float(rng.choice([few, rng.uniform(0.006, 0.9 * REST_S), rng.uniform(0.006, 0.9 * REST_S)])),
        after=float(after),
        levels=int(2 ** rng.integers(9, 15) / rng.uniform(1.2, 4)),
        seed=int(rng.integers(2**31)),
    )


def dataset(impacts: list[Impact], traces: list[Trace], quantity: Quantity = "deceleration") -> Dataset:
    """The recordings as a dataset that no check has seen."""
    table = pd.DataFrame(
        {
            "impact": [f"i{number}" for number in range(len(impacts))],
            "subject": "s",
            "trial": [impact.element for impact in impacts],
            "mass_kg": [impact.mass for impact in impacts],
            "velocity_m_s": [impact.velocity for impact in impacts],
        }
    )
    unit = "m" if quantity == "displacement" else "m/s^2"
    settings = Settings(name="simulated", signal=SignalSettings(quantity=quantity, unit=unit))
    return Dataset(settings, table, traces)
