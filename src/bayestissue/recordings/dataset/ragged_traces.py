"""Recordings of impacts end to end, as they are read, cropped, checked and held by a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from jaxtyping import Bool, Float64, Int, Int8, Shaped

from bayestissue.base.outline import counted, span
from bayestissue.recordings.dataset.dataset_file import ChannelQuantity, Quantity

# Arrays with an entry for each impact, or each sample; a sign is 1 or -1 at a limit, else 0.
PerImpact = Float64[np.ndarray, " impact"]
IntPerImpact = Int[np.ndarray, " impact"]
BoolPerImpact = Bool[np.ndarray, " impact"]
PerSample = Float64[np.ndarray, " sample"]
SignPerSample = Int8[np.ndarray, " sample"]
# The fewest samples that are a recording.
MIN_SAMPLES = 8
# Of a step: times that stray by no more from even ones are taken as even, as a clock of few digits has them.
EVEN_WITHIN = 0.1
# Of a stated sampling rate, by which that of the times may differ.
RATE_WITHIN = 0.01
# A clock that has rounded its times has one of so many decimals of a second.
_DECIMALS = range(2, 6)


def _rounded(time: PerSample, step: float) -> bool:
    """Whether these are even times to the decimals that they have, half of the last off at the most.

    With a last decimal as large as the step itself a lost sample would look the same.
    """
    index = np.arange(time.size)
    left = time - np.polynomial.Polynomial.fit(index, time, 1)(index)
    for decimals in _DECIMALS:
        last = 10.0**-decimals
        ticks = time / last
        if (np.abs(ticks - np.rint(ticks)) < 1e-6 * np.maximum(np.abs(ticks), 1.0)).all():
            return bool(np.ptp(left) < 1.1 * last < 0.45 * step)
    return False


@dataclass(frozen=True, eq=False)
class Trace:
    """The recording of one impact.

    Attributes:
        time_s: the recorder's own time, s; 0 need not be the moment of contact.
        value: deceleration or acceleration in m/s², or displacement in m, after scale and offset. Of an
            impact along gravity a deceleration is force over mass, whatever the sensor's zero was: see
            `bayestissue.recordings.dataset.Dataset`.
        clipped: 1 where a value stands at the sensor's upper limit, -1 at its lower one, else 0; None where
            none does.
    """

    time_s: PerSample
    value: PerSample
    clipped: SignPerSample | None = None

    def __repr__(self) -> str:
        return f"Trace of {counted(len(self.time_s), 'sample')}, {span(self.time_s, 's')}"


@dataclass(frozen=True, eq=False)
class Traces(Sequence[Trace]):
    """The recordings of several impacts, end to end, in SI units: a sequence of `Trace`.

    Attributes:
        time_s: of every sample, s.
        value: m/s², m or N, after scale and offset.
        start: where each recording begins, and last where they all end.
        clipped: 1 where a sample stands at the sensor's upper limit, -1 at its lower one, else 0; None where
            none does.
    """

    time_s: PerSample
    value: PerSample
    start: Int[np.ndarray, " impact+1"]
    clipped: SignPerSample = field(default=None, kw_only=True)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        if self.clipped is None:
            object.__setattr__(self, "clipped", np.zeros(self.value.size, np.int8))

    @classmethod
    def of(cls, traces: Iterable[Trace | Traces]) -> Traces:
        """These recordings end to end; themselves where they are so already."""
        if isinstance(traces, Traces):
            return traces
        parts = list(traces)
        time, value = (
            np.concatenate([np.empty(0), *(getattr(part, name) for part in parts)])
            for name in ("time_s", "value")
        )
        limits = [np.zeros(len(p.value), np.int8) if p.clipped is None else p.clipped for p in parts]
        clipped = np.concatenate([np.empty(0, np.int8), *limits])
        return cls(time, value, np.cumsum([0, *(len(part.value) for part in parts)]), clipped=clipped)

    def __len__(self) -> int:
        return self.start.size - 1

    def __getitem__(self, which: Any) -> Any:
        """One recording, or those of a slice, of positions in any order, or of a truth value each."""
        if isinstance(which, int | np.integer):
            row = range(len(self))[which]
            here = slice(self.start[row], self.start[row + 1])
            clipped = self.clipped[here]
            return Trace(self.time_s[here], self.value[here], clipped if clipped.any() else None)
        rows = np.arange(len(self))[which]
        parts = [np.arange(self.start[row], self.start[row + 1]) for row in rows]
        return self.taken(np.concatenate([np.empty(0, int), *parts]), rows, self.n_samples[rows])

    def at(self, keep: Bool[np.ndarray, " sample"]) -> Self:
        """The samples for which ``keep`` holds, of the recordings that have any of them."""
        if keep.all():
            return self
        count = np.bincount(self.owner[keep], minlength=len(self))
        rows = np.flatnonzero(count)
        return self.taken(np.flatnonzero(keep), rows, count[rows])

    def taken(self, samples: np.ndarray, rows: np.ndarray, count: np.ndarray) -> Self:
        """These samples of these recordings, so many of each, in order."""
        return replace(
            self,
            time_s=self.time_s[samples],
            value=self.value[samples],
            clipped=self.clipped[samples],
            start=np.cumsum([0, *count]),
        )

    def slowing(self, quantity: Quantity | ChannelQuantity) -> Self:
        """The recordings of this quantity, positive while the impactor slows or goes into the tissue."""
        if quantity != "acceleration":
            return self
        return replace(self, value=-self.value, clipped=-self.clipped)

    @property
    def n_samples(self) -> IntPerImpact:
        """How many samples each recording has."""
        return np.diff(self.start)

    @property
    def begin(self) -> IntPerImpact:
        """The first sample of each recording."""
        return self.start[:-1]

    @property
    def end(self) -> IntPerImpact:
        """The one after the last sample of each recording."""
        return self.start[1:]

    @property
    def owner(self) -> Int[np.ndarray, " sample"]:
        """For every sample which of the recordings it belongs to."""
        return np.repeat(np.arange(len(self)), self.n_samples)

    @property
    def duration(self) -> PerImpact:
        """From the first to the last sample of each recording, s."""
        return self.time_s[self.end - 1] - self.time_s[self.begin]

    @property
    def interval(self) -> PerImpact:
        """The mean sampling interval of each recording, s."""
        return self.duration / np.maximum(self.n_samples - 1, 1)

    def greatest(self, values: Shaped[np.ndarray, " sample"]) -> np.ndarray:
        """Of each recording the greatest of the values of its samples."""
        return np.maximum.reduceat(values, self.begin)

    def least(self, values: Shaped[np.ndarray, " sample"]) -> np.ndarray:
        """Of each recording the least of the values of its samples."""
        return np.minimum.reduceat(values, self.begin)

    def total(self, values: Shaped[np.ndarray, " sample"]) -> np.ndarray:
        """Of each recording the sum of the values of its samples, of truth values how many are true."""
        return np.add.reduceat(values, self.begin, dtype=int if values.dtype == bool else None)

    def first_where(self, condition: Bool[np.ndarray, " sample"]) -> IntPerImpact:
        """Of each recording the first sample at which the condition holds."""
        return self.least(np.where(condition, np.arange(condition.size), condition.size))

    @property
    def limited(self) -> BoolPerImpact:
        """Which recordings have a sample at the sensor's limit."""
        return self.greatest(self.clipped != 0)

    @property
    def uneven(self) -> BoolPerImpact:
        """Which recordings have a sample farther than `EVEN_WITHIN` of a step from even times.

        Even times that a clock of few decimals has rounded are even.
        """
        step, count = self.interval, self.n_samples
        even = np.repeat(self.time_s[self.begin], count) + np.repeat(step, count) * (
            np.arange(self.time_s.size) - np.repeat(self.begin, count)
        )
        stray = self.greatest(np.abs(self.time_s - even))
        uneven = ~(stray <= EVEN_WITHIN * step)
        for which in np.flatnonzero(uneven):
            uneven[which] = not _rounded(self[int(which)].time_s, step[which])
        return uneven

    @property
    def lost(self) -> PerImpact:
        """How many samples are missing in longer steps of the recordings whose times are `uneven`, else 0."""
        # Not whole numbers: steps of damaged times are greater than those can be.
        missing = np.zeros(len(self))
        for which in np.flatnonzero(self.uneven):
            steps = np.diff(self[int(which)].time_s)
            with np.errstate(all="ignore"):
                missing[which] = (np.rint(steps / np.median(steps)) - 1).clip(0).sum()
        return missing

    def interpolated(
        self, time: Float64[np.ndarray, "*time"], owner: Int[np.ndarray, "*time"]
    ) -> Float64[np.ndarray, "*time"]:
        """Values at these times, between samples in proportion, of all recordings at once.

        Beyond the ends of a recording they are its last value or, far beyond, another one's.

        Args:
            time: s.
            owner: which recording each is to be taken of.
        """
        # End to end on one axis of time.
        least = min(time.min(), self.time_s.min())
        width = 2 * (max(time.max(), self.time_s.max()) - least) + 1.0
        return np.interp(time - least + width * owner, self.time_s - least + width * self.owner, self.value)


@dataclass(frozen=True)
class LimitSettings:
    """By what samples at a sensor's limit are told from the peak of an impact.

    Attributes:
        plateau: so many equal greatest values make a plateau of one recording, if hardly any stand just
            below.
        recordings: a limit is the greatest value of so many recordings,
        samples: or of two with more than so many such samples together.
        steps_below: within so many steps of the recorder below a limit hardly any recording has its greatest
            value.
        same: of the values' size: equal readings may differ in their last digit once a scale was applied.
    """

    plateau: int = 4
    recordings: int = 3
    samples: int = 3
    steps_below: float = 4.5
    same: float = 1e-9


LIMITS = LimitSettings()


def at_limit(
    traces: Traces, quantity: Quantity | ChannelQuantity, stated: tuple[float, float] | None = None
) -> SignPerSample:
    """1 where a sample stands at the sensor's upper limit, -1 at its lower one, 0 elsewhere.

    A limit is what was stated; else the greatest value of several recordings, if hardly any recording has its
    own just below it, or a plateau in one of them. No recording of the sensor goes beyond it.

    Args:
        traces: the recordings, of one sensor.
        quantity: what was recorded.
        stated: the lower and the upper limit, m/s², m or N; None where none is known.
    """
    value, clipped = traces.value, np.zeros(traces.value.size, np.int8)
    if not len(traces):
        return clipped
    with np.errstate(all="ignore"):
        if stated is not None:
            ends = np.array(stated)
            low, high = ends * (1 - np.copysign(LIMITS.same, ends * [-1, 1]))
            return (value >= high).astype(np.int8) - (value <= low).astype(np.int8)
        for sign in (1, -1):
            limit = _shared(traces, sign)
            if limit is not None:
                clipped[np.abs(value - limit) <= LIMITS.same * np.abs(limit)] = sign
        _mark_plateaus(traces, quantity, clipped)
    return clipped


def _shared(traces: Traces, sign: int) -> float | None:
    """The greatest value of the recordings on one side, if it is a limit of several."""
    value = sign * traces.value
    greatest, least = traces.greatest(value), traces.least(value)
    known = np.isfinite(greatest) & (greatest > 0.5 * -least) & (greatest > least)
    if known.sum() < 2:
        return None
    limit = greatest[known].max()
    same = known & (greatest >= limit * (1 - LIMITS.same))
    # What was exported twice has its greatest value twice.
    parts = [value[traces.begin[which] : traces.end[which]] for which in np.flatnonzero(same)]
    different = len({part.tobytes() for part in parts})
    count = sum(np.count_nonzero(part >= limit * (1 - LIMITS.same)) for part in parts)
    step = recorder_step(value[np.isfinite(value)], LIMITS.same * limit, otherwise=limit)
    below = np.count_nonzero(known & ~same & (greatest > limit - LIMITS.steps_below * step))
    several = different >= LIMITS.recordings or (different == 2 and count > LIMITS.samples)
    return float(sign * limit) if several and different > 3 * below else None


def _mark_plateaus(traces: Traces, quantity: Quantity | ChannelQuantity, clipped: SignPerSample) -> None:
    """Write into ``clipped`` where recordings are cut off at one value.

    At a recorder's limit samples pile up: more stand there than the few steps of the recorder's scale below
    it hold together. A smooth or noisy peak has its readings spread over these steps. Of a displacement only
    the upper side counts.
    """
    value = traces.value
    ends = [traces.greatest(value), traces.least(value)]
    greatest = np.maximum(*np.abs(ends))
    for limit, sign in zip(ends[:1] if quantity == "displacement" else ends, (1, -1), strict=False):
        count = traces.total(value == limit[traces.owner])
        extreme = (np.abs(limit) > 0.5 * greatest) & (ends[0] > ends[1])
        for which in np.flatnonzero(extreme & (count >= LIMITS.plateau)):
            mine = value[traces.begin[which] : traces.end[which]]
            distance = np.abs(mine - limit[which])
            near = LIMITS.steps_below * recorder_step(mine, LIMITS.same * np.ptp(mine))
            if count[which] > 3 * np.count_nonzero((distance > 0) & (distance < near)) + 2:
                clipped[traces.begin[which] : traces.end[which]][mine == limit[which]] = sign


def recorder_step(values: PerSample, rounding: float, otherwise: float = np.inf) -> float:
    """The recorder's step: the least difference of values that is more than ``rounding``."""
    steps = np.diff(np.unique(values))
    return float(steps[steps > rounding].min(initial=otherwise))
