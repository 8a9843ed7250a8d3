"""The kinds of findings: what each is called, and what was expected; the rest stands in its entry."""

from __future__ import annotations

from typing import NamedTuple

from bayestissue.errors import Coded
from bayestissue.remedies import entries


class Kind(NamedTuple):
    """One kind of finding: its flag, what was expected, and whether it is only noted, not flagged."""

    flag: Coded
    expected: str
    note: bool = False

    @property
    def advice(self) -> str:
        """What it does to K and C, and what to do."""
        return entries()[self.flag.code].advice


SPIKE = Kind(
    Coded("a spike of one to three samples", "spike"),
    "samples that follow from their neighbours",
)
STANDING = Kind(
    Coded("samples that repeat the one before", "repeated-samples"),
    "a new value in each sample while the signal moves",
)
COARSE = Kind(
    Coded("steps of the recorder too coarse for the peak", "coarse-steps"),
    "20 or more steps of the recorder in the peak",
)
HUM = Kind(
    Coded("hum while nothing is touched", "hum"),
    "a level signal before and after contact",
)
DRIFT = Kind(
    Coded("drift while nothing is touched", "drift"),
    "a level signal before and after contact",
)
MOVED = Kind(
    Coded("the zero after contact is another than before", "zero-moved"),
    "the same mean before contact and after it",
)
ABOVE = Kind(
    Coded("begins above zero: after contact, or with an offset", "starts-above-zero"),
    "a recording that begins before contact",
)
EARLIER = Kind(
    Coded("contact may have come before the first sample", "contact-earlier"),
    "a recording that begins before contact",
    note=True,
)
BELOW = Kind(
    Coded("begins below zero: an offset", "starts-below-zero"),
    "a recording that begins at zero, or with a quiet part that tells the offset",
)
SLOW = Kind(
    Coded("noise slower than the impact: a low-pass", "slow-low-pass"),
    "noise up to far higher frequencies than those of the impact",
)
SATURATED = Kind(
    Coded("flatter at the top than any tissue makes it: saturated or cut off", "saturated"),
    "a force that some spring and damper could make",
)
NO_LAW = Kind(
    Coded("no force of depth and velocity gives this trace", "no-law"),
    "a deceleration that follows from depth and velocity, whatever the tissue",
)
FALLS = Kind(
    Coded("looks like gravity along the motion, which is not declared", "gravity"),
    'signal.gravity = "drop" in dataset.toml where the impactor falls straight down',
)
FALLS_NOT = Kind(
    Coded("looks like no gravity along the motion, though it is declared", "gravity"),
    'signal.gravity = "none" in dataset.toml where the impactor moves across gravity',
)
DEEP = Kind(
    Coded(
        "begins above zero: contact came before the recording, or the sensor has another zero", "starts-deep"
    ),
    "a displacement that begins at 0, where contact is",
)
