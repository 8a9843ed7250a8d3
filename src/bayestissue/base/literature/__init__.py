"""What others measured by hitting tissue, ``measurements.toml``, and which of it compares with a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

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

    def near(self, values: Float64[np.ndarray, " impact"]) -> Bool[np.ndarray, " impact"]:
        """Which values are within `FACTOR` of these."""
        return (self.low / FACTOR <= values) & (values <= self.high * FACTOR)

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
    rows = []
    for row in _FILE["measurements"]:
        texts = {name: text for name, text in row.items() if isinstance(text, str)}
        # One value, or the least and the greatest.
        numbers = {name: np.broadcast_to(row[name], 2) for name in row if name not in texts}
        ranges = {name: Range(*map(float, values)) for name, values in numbers.items()}
        mass, velocity = (ranges.pop(name, None) for name in ("mass_kg", "velocity_m_s"))
        source = sources[texts.pop("source")]
        rows.append(Measurement(source=source, published=ranges, mass=mass, velocity=velocity, **texts))
    return tuple(rows)


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
        near = row.mass.near(mass) & row.velocity.near(velocity)
        if near.any():
            chosen.append(Comparable(row, near))
    return chosen
