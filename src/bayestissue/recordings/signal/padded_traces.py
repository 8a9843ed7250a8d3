"""Recordings of unequal length as one array, and the few selections that ragged rows need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from bayestissue.recordings.dataset.ragged_traces import Trace, Traces

type Rows = Float[np.ndarray, "impact sample"]
type Mask = Bool[np.ndarray, "impact sample"]
type Column = Float[np.ndarray, " impact"]
type Index = Int[np.ndarray, " impact"]


@dataclass(frozen=True)
class PaddedTraces:
    """Rows padded with zeros: ``value`` [impact, sample], and per impact length, start and interval (s).

    Where times are uneven the interval is the mean one, and ``sample_number`` is the time of each sample
    since the first in intervals, [impact, sample]; None where all are even. Where a sample stands at the
    sensor's limit, ``clipped`` is 1 at its upper one and -1 at its lower, and else 0, [impact, sample].
    """

    value: Rows
    n_samples: Index
    start: Column
    dt: Column
    clipped: Rows
    sample_number: Rows | None = None

    @property
    def sample_numbers(self) -> Rows:
        """The ``sample_number`` of even times too: 0, 1, 2 and so on; past a row's end evenly on."""
        if self.sample_number is not None:
            return self.sample_number
        return np.broadcast_to(np.arange(self.value.shape[1], dtype=float), self.value.shape)

    @property
    def time_s(self) -> Rows:
        """Times since the first sample of each row, s."""
        return self.sample_numbers * self.dt[:, None]

    def sample_number_of(self, index: Int[np.ndarray, "impact ..."]) -> Float[np.ndarray, "impact ..."]:
        """The ``sample_number`` at these indices; beyond either end evenly on."""
        if self.sample_number is None:
            return index.astype(float)
        index = index.reshape(len(self.n_samples), -1)
        inside = np.clip(index, 0, (self.n_samples - 1)[:, None])
        number = np.take_along_axis(self.sample_number, inside, axis=1) + (index - inside)
        return number[:, 0] if number.shape[1] == 1 else number

    def span(self, begin: Index, end: Index) -> Column:
        """From one sample of each row to another, s."""
        return (self.sample_number_of(end) - self.sample_number_of(begin)) * self.dt

    def interpolated(self, time: Rows, value: Rows) -> Callable[[Rows], Rows]:
        """What has these values at these times of the samples, between them in proportion, by time."""
        samples = Traces(time[self.inside], value[self.inside], np.cumsum([0, *self.n_samples]))
        return lambda at: samples.interpolated(at, np.arange(len(at))[:, None])

    @property
    def uneven(self) -> Mask:
        """Which rows, [impact], have uneven times."""
        if self.sample_number is None:
            return np.zeros(len(self.n_samples), bool)
        odd = self.sample_number != np.arange(self.sample_number.shape[1])
        return (odd & self.inside).any(axis=1)

    @property
    def at_limit(self) -> Mask:
        """True where a sample stands at the sensor's limit."""
        return self.clipped != 0

    @property
    def limited(self) -> Mask:
        """Which rows, [impact], have a sample at the sensor's limit."""
        return self.at_limit.any(axis=1)

    @property
    def inside(self) -> Mask:
        """True where there is a sample."""
        return samples_before(self.value, self.n_samples)

    def filled(self, beyond: float) -> Rows:
        """The values, and this one past each row's end."""
        return np.where(self.inside, self.value, beyond)

    @property
    def held(self) -> Rows:
        """The values, and past each row's end its last one again."""
        index = np.minimum(np.arange(self.value.shape[1]), self.n_samples[:, None] - 1)
        return np.take_along_axis(self.value, index, axis=1)


@dataclass(frozen=True)
class ImpactTraces(PaddedTraces):
    """Traces of impacts with, of each, mass (kg), velocity at contact and gravity along it (m/s, m/s²)."""

    mass: Column = field(kw_only=True)
    velocity: Column = field(kw_only=True)
    gravity: Column = field(kw_only=True)


def stack(recordings: Sequence[Trace]) -> PaddedTraces:
    """Lay recordings under one another; the interval is the mean one."""
    traces = Traces.of(recordings)
    n, dt, bent = traces.n_samples, traces.interval, traces.uneven
    inside = np.arange(int(n.max())) < n[:, None]
    sample_number = None
    value, clipped = np.zeros(inside.shape), np.zeros(inside.shape)
    value[inside], clipped[inside] = traces.value, traces.clipped
    if bent.any():
        sample_number = np.tile(np.arange(int(n.max()), dtype=float), (len(n), 1))
        for row in np.flatnonzero(bent).tolist():
            time = traces[row].time_s
            sample_number[row, : n[row]] = (time - time[0]) / dt[row]
    return PaddedTraces(value, n, traces.time_s[traces.begin], dt, clipped, sample_number=sample_number)


def samples_before(rows: Rows | Mask, end: Index) -> Mask:
    """[impact, sample], which samples of rows so wide come before ``end``."""
    return np.arange(rows.shape[1]) < end[:, None]


def last_where(condition: Mask) -> Index:
    """The last sample of each row at which the condition holds; -1 if there is none."""
    last = condition.shape[1] - 1 - np.argmax(condition[:, ::-1], axis=1)
    return np.where(condition.any(axis=1), last, -1)


def first_where(condition: Mask, otherwise: Index) -> Index:
    """The first sample of each row at which the condition holds, or ``otherwise``."""
    return np.where(condition.any(axis=1), np.argmax(condition, axis=1), otherwise)


def at(values: Rows, index: Index) -> Column:
    """One value of each row; an index outside the array is moved to its nearest end."""
    inside = np.clip(index, 0, values.shape[1] - 1)
    return np.take_along_axis(values, inside[:, None], axis=1)[:, 0]


def from_sample[T: PaddedTraces](recordings: T, first: Index) -> T:
    """Each recording from its sample ``first`` on; the padding repeats the last value."""
    n, sample_number = np.maximum(recordings.n_samples - first, 1), None
    index = first[:, None] + np.minimum(np.arange(int(n.max())), n[:, None] - 1)
    since = recordings.sample_number_of(first)
    if recordings.sample_number is not None:
        numbers = recordings.sample_number_of(first[:, None] + np.arange(index.shape[1]))
        sample_number = numbers.reshape(index.shape) - since[:, None]
    return replace(
        recordings,
        value=np.take_along_axis(recordings.value, index, axis=1),
        n_samples=n,
        start=recordings.start + since * recordings.dt,
        sample_number=sample_number,
        clipped=np.take_along_axis(recordings.clipped, index, axis=1),
    )


def segment_moments(values: Rows, end: Index) -> tuple[Column, Column]:
    """Mean and standard deviation of the samples before ``end`` of each row; 0 and 0 where there is none."""
    chosen, count = samples_before(values, end), np.maximum(end, 1)
    mean = np.where(chosen, values, 0).sum(axis=1) / count
    squares = np.where(chosen, values - mean[:, None], 0) ** 2
    return mean, np.sqrt(squares.sum(axis=1) / np.maximum(end - 1, 1))


def standard_error(scatter: Column, count: Index) -> Column:
    """Standard deviation of the error of a mean, of the scatter of the same samples, four or more.

    The error over scatter / √n is Student's t of n − 1 degrees of freedom, whose variance is
    (n − 1) / (n − 3): of twenty samples the scatter is itself unsure by a sixth.
    """
    count = np.maximum(count, 4)
    return scatter * np.sqrt((count - 1) / (count - 3) / count)


def noise_sd(recordings: PaddedTraces) -> Column:
    """Standard deviation of white noise on each recording, from its third differences.

    Third differences take away whatever is a parabola over four samples and multiply the variance of
    white noise by 1 + 9 + 9 + 1 = 20; of uneven times they are divided differences, scaled to do the same.
    Their median size, over the 0.6745 of a normal distribution, does not see the few differences that span
    the jump at contact.
    """
    if recordings.value.shape[1] < 4:
        return np.zeros(len(recordings.n_samples))
    difference = np.abs(_third_differences(recordings))
    inside = recordings.inside[:, 3:]
    ordered = np.sort(np.where(inside, difference, np.inf), axis=1)
    middle = np.maximum((inside.sum(axis=1) - 1) // 2, 0)
    median = at(ordered, middle)
    return np.where(np.isfinite(median), median, 0) / (0.6745 * np.sqrt(20))


def _third_differences(recordings: PaddedTraces) -> Rows:
    if recordings.sample_number is None:
        return np.diff(recordings.value, n=3, axis=1)
    t, y = (
        np.lib.stride_tricks.sliding_window_view(rows, 4, axis=1)
        for rows in (recordings.sample_number, recordings.value)
    )
    apart = t[..., :, None] - t[..., None, :] + np.eye(4)
    # Recordings that are only cut apart may repeat a time, which whoever reads the dataset refuses.
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = 1 / apart.prod(axis=-1)
        return (weights * y).sum(axis=-1) * np.sqrt(20 / (weights**2).sum(axis=-1))
