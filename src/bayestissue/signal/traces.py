"""Recordings of unequal length as one array, and the few selections that ragged rows need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Int

type Rows = Float[np.ndarray, "impact sample"]
type Mask = Bool[np.ndarray, "impact sample"]
type Column = Float[np.ndarray, " impact"]
type Index = Int[np.ndarray, " impact"]


class Trace(Protocol):
    """One recording: times in s and values in SI units, both of shape [sample]."""

    @property
    def time_s(self) -> Float[np.ndarray, " sample"]:
        """Times of the samples in s."""

    @property
    def value(self) -> Float[np.ndarray, " sample"]:
        """Recorded values in SI units."""


@dataclass(frozen=True)
class Recordings:
    """Rows padded with zeros: ``value`` [impact, sample], and per impact length, start and interval (s).

    For ``ahead_s`` before contact a recorder's filter that is run backwards too has an answer.
    """

    value: Rows
    n: Index
    start: Column
    dt: Column
    ahead_s: float = 0.0

    @property
    def inside(self) -> Mask:
        """True where there is a sample."""
        return np.arange(self.value.shape[1]) < self.n[:, None]


def stack(traces: Sequence[Trace]) -> Recordings:
    """Lay recordings under one another; the interval is the mean one, as the times are even."""
    n = np.array([len(trace.value) for trace in traces])
    first = np.array([trace.time_s[0] for trace in traces], dtype=float)
    last = np.array([trace.time_s[-1] for trace in traces], dtype=float)
    value = np.zeros((len(traces), int(n.max())))
    value[np.arange(value.shape[1]) < n[:, None]] = np.concatenate([trace.value for trace in traces])
    return Recordings(value, n, first, (last - first) / np.maximum(n - 1, 1))


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


def from_sample(recordings: Recordings, first: Index) -> Recordings:
    """Each recording from its sample ``first`` on; the padding repeats the last value."""
    n = np.maximum(recordings.n - first, 1)
    index = first[:, None] + np.minimum(np.arange(int(n.max())), n[:, None] - 1)
    value = np.take_along_axis(recordings.value, index, axis=1)
    return Recordings(value, n, recordings.start + first * recordings.dt, recordings.dt)


def segment_moments(values: Rows, end: Index) -> tuple[Column, Column]:
    """Mean and standard deviation of the samples before ``end`` of each row; 0 and 0 where there is none."""
    chosen = np.arange(values.shape[1]) < end[:, None]
    count = np.maximum(end, 1)
    mean = np.where(chosen, values, 0).sum(axis=1) / count
    squares = np.where(chosen, values - mean[:, None], 0) ** 2
    return mean, np.sqrt(squares.sum(axis=1) / np.maximum(end - 1, 1))


def noise_sd(recordings: Recordings) -> Column:
    """Standard deviation of white noise on each recording, from its third differences.

    Third differences take away whatever is a parabola over four samples and multiply the variance of
    white noise by 1 + 9 + 9 + 1 = 20. Their median size, over the 0.6745 of a normal distribution, does
    not see the few differences that span the jump at contact.
    """
    if recordings.value.shape[1] < 4:
        return np.zeros(len(recordings.n))
    difference = np.abs(np.diff(recordings.value, n=3, axis=1))
    inside = recordings.inside[:, 3:]
    ordered = np.sort(np.where(inside, difference, np.inf), axis=1)
    middle = np.maximum((inside.sum(axis=1) - 1) // 2, 0)
    median = at(ordered, middle)
    return np.where(np.isfinite(median), median, 0) / (0.6745 * np.sqrt(20))
