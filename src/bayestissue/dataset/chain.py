"""The measuring chain as a dataset declares it: what was recorded, how surely, and through which filter."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

Quantity = Literal["deceleration", "acceleration", "displacement"]
Contact = Literal["between", "on_sample"]
ChannelQuantity = Literal["force"]
Place = Literal["impactor", "base"]
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of the measuring chain; 0 where nothing was stated.

    Attributes:
        relative_mass_sd: of the impactor's mass, as a fraction of it.
        velocity_sd_m_s: of the velocity at contact, m/s.
        relative_gain_sd: of the recorder's sensitivity, as a fraction of it.
        offset_sd: of the recorder's zero, in SI units of the recorded quantity.
    """

    relative_mass_sd: float = 0.0
    velocity_sd_m_s: float = 0.0
    relative_gain_sd: float = 0.0
    offset_sd: float = 0.0

    def settings(self) -> dict[str, float]:
        """The keys of the table ``[uncertainty]`` in ``dataset.toml``."""
        return asdict(self)


FilterKind = Literal["butterworth", "bessel"]
SaeClass = Literal[60, 180, 600, 1000]
NoiseEntry = Literal["before", "after"]
Applied = Literal["analog", "digital"]


@dataclass(frozen=True)
class Recorder:
    """A known low-pass between the sensor and the file.

    Attributes:
        low_pass_hz: its -3 dB corner run once, Hz.
        order: number of its poles.
        kind: "butterworth" or "bessel"; alike for an order of 1.
        zero_phase: whether it is run forwards and backwards, which doubles its order.
        sae_class: the channel frequency class of SAE J211-1 that it is, if one was declared.
        noise: whether white noise enters before the filter, and goes through it, or after it; None where
            the quiet parts before contact have to tell.
        applied: "digital" where software ran it over the very samples of the file, "analog" where it acted
            before sampling; None where nothing was said: see `digital`.
    """

    low_pass_hz: float
    order: int = 2
    kind: FilterKind = "butterworth"
    zero_phase: bool = False
    sae_class: SaeClass | None = None
    noise: NoiseEntry | None = None
    applied: Applied | None = None

    @property
    def digital(self) -> bool:
        """Whether it is a digital filter of the samples; one of zero phase can be no other unless stated."""
        return self.zero_phase if self.applied is None else self.applied == "digital"

    def settings(self) -> dict[str, Any]:
        """The keys of the table ``[recorder]`` in ``dataset.toml``."""
        names = ("low_pass_hz", "order", "kind", "zero_phase") if self.sae_class is None else ("sae_class",)
        stated = [name for name in ("noise", "applied") if getattr(self, name) is not None]
        return {name: getattr(self, name) for name in (*names, *stated)}

    def __str__(self) -> str:
        stated = f", {self.applied}" if self.applied else ""
        stated += f", noise {self.noise} it" if self.noise else ""
        if self.sae_class is not None:
            return f"SAE class {self.sae_class}{stated}"
        directions = ", forwards and backwards" if self.zero_phase else ""
        return f"{self.kind}, order {self.order}, {self.low_pass_hz:g} Hz{directions}{stated}"
