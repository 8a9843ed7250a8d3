"""The kinds of findings: what each is called, what it does to K and C, and what to do."""

from __future__ import annotations

from typing import NamedTuple


class Kind(NamedTuple):
    """One kind of finding: its flag, what was expected, what it does to K and C, and what to do."""

    flag: str
    expected: str
    effect: str
    remedy: str


SPIKE = Kind(
    "a spike of one to three samples",
    "samples that follow from their neighbours",
    "Before contact a spike is taken into the offset, or for contact; during the impact it changes the "
    "velocity. Both change K and C.",
    "Take the impact out, or replace these samples by what lies between their neighbours.",
)
STANDING = Kind(
    "samples that repeat the one before",
    "a new value in each sample while the signal moves",
    "The motion between the repeated values is lost, and contact and K and C with it.",
    "Export at the rate at which this channel was sampled, or take the impact out.",
)
COARSE = Kind(
    "steps of the recorder too coarse for the peak",
    "20 or more steps of the recorder in the peak",
    "Rounding is then a few per cent of the peak, and K and C are as uncertain.",
    "Record with a narrower range or more bits.",
)
HUM = Kind(
    "hum while nothing is touched",
    "a level signal before and after contact",
    "The hum goes on under the impact and moves contact and the offset: errors of K and C are several times "
    "its share of the peak.",
    "Mend the grounding and record again, or subtract the hum before the export.",
)
DRIFT = Kind(
    "drift while nothing is touched",
    "a level signal before and after contact",
    "The zero moves on during the impact: an error of the offset of 1 % of the peak changes K by some 3 %.",
    "Let the sensor settle and record again, or subtract the drift before the export.",
)
MOVED = Kind(
    "the zero after contact is another than before",
    "the same mean before contact and after it",
    "Part of the change lies within the impact: 1 % of the peak changes K by some 3 %.",
    "Look for a loose mounting, a cable that is pulled or a sensor driven past its limit; record again.",
)
ABOVE = Kind(
    "begins above zero: after contact, or with an offset",
    "a recording that begins before contact",
    "Velocity and displacement are taken from the first sample on: each lost millisecond makes K some 5 % "
    "and C some 20 % wrong, and an offset of 1 % of the peak K some 3 %.",
    "Export from some milliseconds before contact on. Where the recorder's time 0 is contact, say so: "
    'contact = "time-zero" under [signal] of the model file.',
)
BELOW = Kind(
    "begins below zero: an offset",
    "a recording that begins at zero, or with a quiet part that tells the offset",
    "An offset of 1 % of the peak changes K by some 3 %.",
    "Export from some milliseconds before contact on, or write signal.offset in dataset.toml.",
)
SLOW = Kind(
    "noise slower than the impact: a low-pass",
    "noise up to far higher frequencies than those of the impact",
    "A low-pass this slow smears contact: C is too small, by half as a rule, and K wrong by some per cent.",
    "Record with a wider filter, or switch the filter off.",
)
SATURATED = Kind(
    "flatter at the top than any tissue makes it: saturated or cut off",
    "a force that some spring and damper could make",
    "What lies above the limit is lost: K comes out too small, down to a fraction of the true one.",
    "Record again with a sensor and a range that reach well above the peak.",
)
NO_LAW = Kind(
    "no force of depth and velocity gives this trace",
    "a deceleration that follows from depth and velocity, whatever the tissue",
    "Something other than the tissue is in the trace (samples lost, a change of gain, a second hit, a limit, "
    "a slow low-pass): K and C may be wrong by any amount.",
    "Look at the trace in the page of `check --out`; take the impact out, or record it again.",
)
DEEP = Kind(
    "begins above zero: contact came before the recording, or the sensor has another zero",
    "a displacement that begins at 0, where contact is",
    "The depth at the first sample is taken for 0: the spring's force there counts as none, and K is wrong "
    "by about as much as this depth is of the greatest.",
    "Export from before contact on, or write in signal.offset what the sensor shows at contact.",
)
