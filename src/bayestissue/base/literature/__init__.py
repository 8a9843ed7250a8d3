"""What others measured by hitting tissue, ``measurements.toml``, and which of it compares with a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from bayestissue.base.declarations import declared

# Mass and velocity may differ from the published ones by so much, either way.
FACTOR = 2.0
# What may have been measured, by the columns that tables of impacts have.
MEASURED = (
    *("K_N_per_m", "C_N_s_per_m", "peak_force_N", "peak_deceleration_g"),
    *("peak_displacement_m", "energy_share"),
)
_FILE = declared(__name__, "measurements.toml")
# What can be hit, by the name that ``site`` of ``dataset.toml`` has, in words.
SITES: Mapping[str, str] = _FILE["sites"]


class Range(NamedTuple):
    """From the least to the greatest published value, which are the same where one was published."""

    low: float
    high: float

    def ratio(self, value: float) -> float:
        """A value over the nearest of these: 1 within the range."""
        return value / min(max(value, self.low), self.high)


@dataclass(frozen=True)
class Citation:
    """Who published a measurement.

    Attributes:
        short: authors and year.
        title: title, journal, volume and pages.
        licence: on what terms the text may be used; numbers are facts.
        doi: its digital object identifier; empty where none was found.
        url: where it was read; empty where there is a ``doi``.
    """

    short: str
    title: str
    licence: str
    doi: str = ""
    url: str = ""

    @property
    def address(self) -> str:
        """Where to read it."""
        return f"https://doi.org/{self.doi}" if self.doi else self.url


@dataclass(frozen=True)
class Measurement:
    """A row of ``measurements.toml``.

    Attributes:
        site: what was hit, one of `SITES`.
        source: who published it.
        hit: what was hit, in words.
        by: what hit it, in words.
        method: how it was measured, and what the numbers are.
        where: the place in the source where the numbers stand.
        published: the values, by the names in `MEASURED`.
        mass: that of the impactor [kg]; None where it was not stated.
        velocity: that at contact [m/s]; likewise.
        derived: which of the numbers was computed, and of what.
    """

    site: str
    source: Citation
    hit: str
    by: str
    method: str
    where: str
    published: Mapping[str, Range]
    mass: Range | None = None
    velocity: Range | None = None
    derived: str = ""


class Comparable(NamedTuple):
    """A measurement, and which impacts of a study have a mass and a velocity like its own."""

    measurement: Measurement
    impacts: Bool[np.ndarray, " impact"]


@cache
def measurements() -> tuple[Measurement, ...]:
    """All of them, in the order of the file."""
    sources = {name: Citation(**entry) for name, entry in _FILE["sources"].items()}
    return tuple(_measurement(dict(row), sources) for row in _FILE["measurements"])


def _measurement(row: dict[str, Any], sources: Mapping[str, Citation]) -> Measurement:
    source, mass, velocity = (row.pop(key, None) for key in ("source", "mass_kg", "velocity_m_s"))
    published = {name: _range(row.pop(name)) for name in MEASURED if name in row}
    motion: dict[str, Any] = {"mass": mass and _range(mass), "velocity": velocity and _range(velocity)}
    return Measurement(source=sources[source], published=published, **motion, **row)


def _range(value: float | list[float]) -> Range:
    low, high = value if isinstance(value, list) else (value, value)
    return Range(float(low), float(high))


def comparable(
    mass: Float64[np.ndarray, " impact"], velocity: Float64[np.ndarray, " impact"], site: str = ""
) -> list[Comparable]:
    """The measurements whose mass and velocity are within `FACTOR` of some impact's.

    One that does not state both compares with nothing.

    Args:
        mass: of each impact [kg].
        velocity: of each impact at contact [m/s]; NaN where it is not known.
        site: what was hit, one of `SITES`, which a measurement must share; of any site where it is empty.
    """
    chosen = []
    for row in measurements():
        if row.mass is None or row.velocity is None or site not in ("", row.site):
            continue
        near = _near(mass, row.mass) & _near(velocity, row.velocity)
        if near.any():
            chosen.append(Comparable(row, near))
    return chosen


def _near(value: Float64[np.ndarray, " impact"], published: Range) -> Bool[np.ndarray, " impact"]:
    return (published.low / FACTOR <= value) & (value <= published.high * FACTOR)
