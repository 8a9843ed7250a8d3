"""A force that was recorded beside a deceleration, against mass times deceleration.

Of each impact F(t) = r (M - m) d(t) - l r (M - m) d'(t) + b by least squares, from as long before contact as
the impactor takes to zero velocity until three times as long after it, m being what lies between sensor and
tissue: the ratio r, which holds the errors of mass and of both gains, the lag l of the force behind the
deceleration, and the zero b. What the noise of d adds to its sum of squares, which would make r too small, is
taken off. Where one of the two went through a low-pass of its own, the other is passed through it as well.
Where l is farther than that finds, it begins at the time by which the two are most alike. A force that is
late is told from one behind a low-pass, and from one that drifts, by what each of the three leaves of it.

Beside a displacement, whose second derivative is noise, impulses are compared. From contact on a free mass
has

    int F dt = M (V - v(t) + g t),

which at the greatest depth, where v = 0, is M (V + g t_p). There the ratio of the two sides is 1 of a free
mass of the declared size, and greater where something else pushes too, such as the leg behind a heel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from bayestissue.recordings.dataset.dataset_file import ChannelSettings, LowPassFilter
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.signal.displacement import FEWEST_SAMPLES, Displacements
from bayestissue.recordings.signal.filters import on_even_grid
from bayestissue.recordings.signal.integrals import trapezoids
from bayestissue.recordings.signal.padded_traces import (
    Column,
    Index,
    Mask,
    PaddedTraces,
    Rows,
    segment_moments,
    stack,
)

# The slope is taken over so much of the time to zero velocity on either side: a curve's error is then 0.4 %.
_REACH = 0.1
# A force that jumps at contact is not linear in the lag.
_ROUNDS = 6
# In times to zero velocity, until when the two are compared: the rebound is over before.
_AFTER = 3.0
# Of standard deviations, beyond which two channels contradict each other, or a lag is one.
_LIMIT = 3.0
# Of the sampling interval, below which no lag is worth a word.
_LEAST_LAG = 0.5
# A ratio is apart from the others by so many of its own errors, and by so much of itself.
_OWN_ERRORS, _LEAST_APART = 5.0, 0.03
# In times to zero velocity: how far a force is looked for, and in what steps.
_FARTHEST, _STEP = 4.0, 0.1
# Low-passes that may be what a lag is, in Hz; and what a cause may leave of the squares that a lag leaves.
_CORNERS_HZ, _LEFT = np.geomspace(20.0, 5000.0, 50), 0.25


@dataclass(frozen=True, eq=False)
class Force:
    """The force of every impact, and how it compares with mass times deceleration.

    Attributes:
        channel: what was recorded.
        since_contact: of each of its samples [s].
        value: the force, its zero taken off [N].
        expected: (M - m) d at these times [N].
        inside: which samples are compared.
        ratio: r of each impact; NaN of too few samples, or where the deceleration is clipped.
        ratio_sd: its standard error.
        lag: l [s].
        lag_sd: its standard error [s].
        left: the sum of squares that r, l and b leave [N^2].
        dt: sampling interval [s].
        declared_sd: of r, by what is declared of the mass and of both gains.
        mass: M - m of each impact [kg].
        corner_hz: of the low-pass that is mistaken for a lag; 0 where none is, infinite of a drift.
        impulse: whether impulses are compared, of a displacement. ``value`` is then that of the force since
            contact, ``expected`` M (V - v + g t) [N s], the ratio that at the greatest depth, with the error
            that is declared of V, and there is no lag.
    """

    channel: ChannelSettings
    since_contact: Rows
    value: Rows
    expected: Rows
    inside: Mask
    ratio: Column
    ratio_sd: Column
    lag: Column
    lag_sd: Column
    left: Column
    dt: Column
    declared_sd: float
    mass: Column
    corner_hz: float = 0.0
    impulse: bool = False

    @property
    def common(self) -> tuple[float, float]:
        """The median ratio, and its standard error as the impacts scatter."""
        return _median(self.ratio, self.ratio_sd)

    @property
    def common_lag(self) -> tuple[float, float]:
        """The median lag [s], and its standard error."""
        return _median(self.lag, self.lag_sd)

    @property
    def total_sd(self) -> float:
        """Of the common ratio, what is declared of mass and gains counted in."""
        # An impulse may be several times M V, and errors are then of as many.
        times = self.common[0] if self.impulse else 1.0
        return float(np.hypot(self.common[1], times * self.declared_sd))

    @property
    def contradicts(self) -> bool:
        """Whether the ratio is farther from 1 than what is declared allows."""
        ratio, sd = self.common[0], self.total_sd
        if self.impulse:
            return bool(ratio <= 0 or abs(np.log(ratio)) > _LIMIT * sd / ratio)
        return bool(abs(ratio - 1) > _LIMIT * sd)

    @property
    def lags(self) -> bool:
        """Whether the force is early or late by more than its error, and by half a sampling interval."""
        lag, sd = self.common_lag
        # Of impacts that are late by different times the scatter would hide that each of them is.
        beyond = np.abs(self.lag) > np.maximum(_LIMIT * self.lag_sd, _LEAST_LAG * self.dt)
        most = 2 * beyond.sum() > np.isfinite(self.lag).sum()
        return bool(most or abs(lag) > max(_LIMIT * sd, _LEAST_LAG * np.median(self.dt)))

    @property
    def apart(self) -> Bool[np.ndarray, " impact"]:
        """Whose ratio is not that of the others, by many of its own errors.

        Below tissue that moves along with the impactor it is r (1 + m / M), which takes no more than m = M.
        """
        known = np.isfinite(self.ratio)
        if self.impulse or known.sum() < 2:
            return np.zeros(known.size, bool)
        moving, mass = np.zeros(known.size), self.mass[known]
        if self.channel.place == "base" and np.ptp(mass) > 0:
            columns = np.stack([np.ones_like(mass), 1 / mass], axis=1)
            r, rm = np.linalg.lstsq(columns, self.ratio[known])[0]
            moving = rm / self.mass if 0 < rm <= r * mass.min() else moving
        centre = float(np.median((self.ratio - moving)[known]))
        sd = np.hypot(self.ratio_sd, np.nanmedian(self.ratio_sd))
        beyond = np.maximum(_OWN_ERRORS * sd, _LEAST_APART * abs(centre))
        return known & (np.abs(self.ratio - moving - centre) > beyond)

    @property
    def between(self) -> str:
        """From which to which ratio impacts have, and how well each is known, in words."""
        percent = 100 * np.nanmedian(self.ratio_sd / self.ratio)
        return f"{np.nanmin(self.ratio):.3g} to {np.nanmax(self.ratio):.3g}, each known to {percent:.1g} %"

    @property
    def late(self) -> str:
        """By what the force is late or early, and what that is, in words."""
        if math.isinf(self.corner_hz):
            return "it drifts while it acts, which no clock explains"
        lag = self.common_lag[0]
        words = f"it is {1e3 * abs(lag):.2g} ms {'behind' if lag > 0 else 'ahead of'} the deceleration"
        if self.corner_hz:
            corner, filtered = float(f"{self.corner_hz:.2g}"), "it" if lag > 0 else "that"
            return f"{words}: {filtered} went through a low-pass of some {corner:g} Hz"
        return f"{words}: correct time_offset_s by {-lag:.2g} s"

    @property
    def words(self) -> str:
        """The ratio with its standard deviation, and the lag where there is one."""
        ratio, scatter = self.common
        if self.impulse:
            words = f"until the greatest depth its impulse is {ratio:.3g} ± {self.total_sd:.2g} of M V"
            if not self.contradicts:
                return f"{words}, as of a free mass"
            words += ": what hits is no free mass of this size"
            beyond = f", and {1 - 1 / ratio:.0%} of the impulse is of something else that pushes"
            return words + beyond * (ratio > 1)
        mass = "(M - m)" if self.channel.tip_mass_kg else "M"
        words = f"{ratio:.4g} ± {self.total_sd:.2g} of {mass} a ({scatter:.1g} but for what is declared)"
        words += f"; {self.between}" if self.apart.any() else ""
        return f"{words}; of the force: {self.late}" if self.lags else words


def force_beside(dataset: Dataset, signal: Displacements) -> Force | None:
    """The force beside a dataset's recordings of a free mass; None where there is none.

    Args:
        dataset: the recordings.
        signal: what the signal chain made of the decelerations or displacements.
    """
    if not dataset.channels:
        return None
    (channel,) = dataset.channels
    compared = _impulses if dataset.quantity == "displacement" else _forces
    return compared(dataset, channel, signal)


def _impulses(dataset: Dataset, channel: ChannelSettings, signal: Displacements) -> Force:
    """Impulse of the force against what the declared mass lost, at the samples of the displacement."""
    force, mass = stack(*dataset.further), (signal.mass - channel.tip_mass_kg)[:, None]
    since = signal.since_contact_s
    inside = signal.inside & (since >= 0)
    times = (force.start - signal.contact_time_s)[:, None] + force.time_s
    above = np.where(force.inside, force.value - _first_mean(force, signal.contact_time_s), 0.0)
    steps = np.diff(times, axis=1) * force.inside[:, 1:]
    impulse = force.interpolated(times, trapezoids(above, steps))
    V = np.where(np.isfinite(signal.velocity), signal.velocity, signal.v[:, 0])[:, None]
    to_peak, at_contact = signal.time_to_peak[:, None], impulse(np.zeros_like(V))
    lost = mass * (V + signal.gravity[:, None] * to_peak)
    last = np.where(force.inside, times, -np.inf).max(axis=1, keepdims=True)
    whole = (inside.sum(axis=1) >= FEWEST_SAMPLES) & (last >= to_peak)[:, 0] & ~force.limited
    ratio = np.where(whole, ((impulse(to_peak) - at_contact) / lost)[:, 0], np.nan)
    chain, no_lag = dataset.uncertainty, np.full(len(ratio), np.nan)
    declared = float(np.hypot(chain.relative_mass_sd, channel.relative_gain_sd))
    return Force(
        channel,
        since,
        np.where(inside, impulse(since) - at_contact, 0.0),
        np.where(inside, mass * (V - signal.v + signal.gravity[:, None] * since), 0.0),
        inside,
        ratio,
        np.abs(ratio) * chain.velocity_sd_m_s / V[:, 0],
        no_lag,
        no_lag,
        no_lag,
        signal.dt,
        declared,
        mass[:, 0],
        impulse=True,
    )


def _forces(dataset: Dataset, channel: ChannelSettings, signal: Displacements) -> Force:
    """The force against mass times deceleration."""
    comparison = _Beside(dataset, channel, signal)
    force = comparison.compared(np.zeros(len(signal.mass)))
    if (lost := np.abs(force.lag) > 0.99 * comparison.curve.reach[:, 0]).any():
        force = comparison.compared(np.where(lost, comparison.most_alike(), 0.0))
    return replace(force, corner_hz=comparison.mistaken(force)) if force.lags else force


class _Beside:
    """A force and the decelerations beside it, without their zero, whose windows are those of the signal.

    Each went through both low-passes if these differ.

    Attributes:
        curve: the force that is expected.
        since_contact: when each sample of the force was [s].
        usable: which of its samples tell it.
        inside: which of them are compared.
    """

    def __init__(self, dataset: Dataset, channel: ChannelSettings, signal: Displacements) -> None:
        force, slowing = stack(*dataset.further), stack(dataset.traces.slowing(dataset.quantity))
        above = np.where(slowing.inside, slowing.value - signal.quiet.offset[:, None], 0.0)
        slowing = replace(slowing, value=above)
        if channel.recorder != dataset.recorder:
            slowing = _passed(slowing, channel.recorder, 0.0)
            force = _passed(force, dataset.recorder, _first_mean(force, signal.contact_time_s))
        self.force, self.slowing, self.signal = force, slowing, signal
        self.channel, self.uncertainty = channel, dataset.uncertainty
        self.curve = _Expected(slowing, signal, channel.tip_mass_kg)
        self.since_contact = (force.start - signal.contact_time_s)[:, None] + force.time_s
        self.usable = force.inside & ~force.at_limit
        self.inside = self.usable & self.curve.covers(self.since_contact)

    def compared(self, apart: Column) -> Force:
        """What least squares make of the force, by Newton's iteration from where it is so late [s]."""
        curve, since_contact = self.curve, self.since_contact - apart[:, None]
        inside = self.usable & curve.covers(since_contact)
        count = inside.sum(axis=1)
        # At the sensor's limit d is not what it was.
        whole = ~self.signal.limited & (count >= FEWEST_SAMPLES)
        noise = count * (curve.mass[:, 0] * self.signal.quiet.noise_sd) ** 2
        values = np.where(inside, self.force.value, 0.0)
        # r (F(t - l) - e F'(t - l)) + b is linear in r, r e and b; e is what l lacks.
        lag = np.zeros(len(values))
        for _ in range(_ROUNDS):
            delayed = since_contact - lag[:, None]
            columns = np.stack([curve.at(delayed), -curve.slope(delayed), np.ones_like(delayed)], axis=-1)
            columns = np.where(inside[..., None], columns, 0.0)
            coefficients, errors, left = _least_squares(columns, values, count, noise, whole)
            ratio, moved, zero = coefficients
            lag = np.clip(lag + np.nan_to_num(moved / ratio), -curve.reach[:, 0], curve.reach[:, 0])
        chain, channel = self.uncertainty, self.channel
        return Force(
            channel=channel,
            since_contact=self.since_contact,
            value=self.force.value - np.where(whole, zero, 0.0)[:, None],
            expected=np.where(self.inside, curve.at(self.since_contact), 0.0),
            inside=self.inside,
            ratio=ratio,
            ratio_sd=errors[0],
            lag=np.where(whole, lag + apart, np.nan),
            lag_sd=errors[1] / np.abs(ratio),
            left=np.where(whole, left, np.nan),
            dt=self.force.dt,
            declared_sd=math.hypot(chain.relative_mass_sd, chain.relative_gain_sd, channel.relative_gain_sd),
            mass=curve.mass[:, 0],
        )

    def most_alike(self) -> Column:
        """By what the force is behind where its correlation with the expected one has it [s]."""
        shifts = self.curve.reach / _REACH * np.arange(-_FARTHEST, _FARTHEST + _STEP, _STEP)
        counts, correlations = [], []
        for shift in shifts.T:
            at = self.since_contact - shift[:, None]
            inside = self.usable & self.curve.covers(at)
            counts.append(inside.sum(axis=1))
            parts = np.where(inside, np.stack([self.force.value, self.curve.at(at)]), 0.0)
            means = parts.sum(axis=2, keepdims=True) / counts[-1].clip(1)[:, None]
            one, other = np.where(inside, parts - means, 0)
            sizes = np.sqrt((one**2).sum(axis=1) * (other**2).sum(axis=1))
            correlations.append((one * other).sum(axis=1) / np.maximum(sizes, np.finfo(float).tiny))
        enough = np.array(counts) > 0.5 * np.max(counts, axis=0)
        best = np.where(enough, correlations, -1.0).argmax(axis=0)
        return shifts[np.arange(len(best)), best]

    def mistaken(self, force: Force) -> float:
        """The corner of a low-pass that leaves much less of the force than a lag, Hz; infinite of a drift.

        What runs away goes on with time, or with the impulse so far, as behind a charge amplifier.
        """
        since_contact, inside, recorded, slowing = self.since_contact, self.inside, self.force, self.slowing
        values, ones = np.where(inside, recorded.value, 0.0), np.ones_like(since_contact)
        expected, count = self.curve.at(since_contact), inside.sum(axis=1)

        def left(values: np.ndarray, *columns: np.ndarray) -> float:
            stacked = np.where(inside[..., None], np.stack([*columns, ones], axis=-1), 0.0)
            known = np.isfinite(force.left)
            squares = _least_squares(stacked, values, count, np.zeros(len(values)), known)[2]
            return float(np.nanmedian(squares / force.left))

        impulse = np.cumsum(np.where(inside, expected, 0.0), axis=1)
        least = {math.inf: left(values, expected, since_contact, impulse)}
        late = np.nanmedian(force.lag) > 0
        dt, zero = slowing.dt if late else recorded.dt, _first_mean(recorded, self.signal.contact_time_s)
        for corner in _CORNERS_HZ[0.2 / np.max(dt) > _CORNERS_HZ]:
            low_pass = LowPassFilter(low_pass_hz=float(corner))
            if late:
                passed = _Expected(_passed(slowing, low_pass, 0.0), self.signal, self.channel.tip_mass_kg)
                least[corner] = left(values, passed.at(since_contact))
            else:
                filtered = np.where(inside, _passed(recorded, low_pass, zero).value, 0.0)
                least[corner] = left(filtered, expected)
        best = min(least, key=lambda corner: least[corner])
        return best if least[best] < _LEFT else 0.0


class _Expected:
    """The force (M - m) d of every impact [N], as a function of the time since contact.

    Attributes:
        mass: M - m [kg].
        reach: on either side of a time, over how much the slope is taken [s].
    """

    def __init__(self, slowing: PaddedTraces, signal: Displacements, tip_mass_kg: float):
        self.mass = (signal.mass - tip_mass_kg)[:, None]
        self.reach = _REACH * signal.time_to_peak[:, None]
        times = (slowing.start - signal.contact_time_s)[:, None] + slowing.time_s
        self._deceleration = slowing.interpolated(times, slowing.value)
        first, last = times[:, :1], np.take_along_axis(times, slowing.n_samples[:, None] - 1, axis=1)
        self._begin = np.maximum(-signal.time_to_peak[:, None], first + 2 * self.reach)
        self._end = np.minimum(_AFTER * signal.time_to_peak[:, None], last - 2 * self.reach)

    def covers(self, times: Rows) -> Mask:
        """Which times are near the impact, and far enough from the ends of the recording for a slope."""
        return (times > self._begin) & (times < self._end)

    def at(self, times: Rows) -> Rows:
        """The force at these times, linear between samples."""
        return self.mass * self._deceleration(times)

    def slope(self, times: Rows) -> Rows:
        """Its derivative [N/s], by a central difference."""
        return (self.at(times + self.reach) - self.at(times - self.reach)) / (2 * self.reach)


def _passed(
    recorded: PaddedTraces, recorder: LowPassFilter | None, zero: Float[np.ndarray, "impact 1"] | float
) -> PaddedTraces:
    """What a low-pass makes of recordings whose zero is known; as they are where it passes all of them."""
    if recorder is None or recorded.uneven.any():
        return recorded
    above = np.where(recorded.inside, recorded.value - zero, 0.0)
    rates = np.round(1 / recorded.dt, 3)
    for rate in np.unique(rates[rates > 2 * recorder.low_pass_hz]):
        rows = rates == rate
        above[rows] = on_even_grid(above[rows], rate, recorder)
    return replace(recorded, value=np.where(recorded.inside, above + zero, 0.0))


def _first_mean(recorded: PaddedTraces, contact_time_s: Column) -> Float[np.ndarray, "impact 1"]:
    """The mean before contact; the first sample where there is none."""
    quiet = np.maximum(np.floor((contact_time_s - recorded.start) / recorded.dt).astype(int), 1)
    return segment_moments(recorded.value, quiet)[0][:, None]


def _least_squares(
    columns: Float[np.ndarray, "impact sample column"],
    values: Rows,
    count: Index,
    noise: Column,
    known: Bool[np.ndarray, " impact"],
) -> tuple[Float[np.ndarray, "column impact"], Float[np.ndarray, "column impact"], np.ndarray]:
    """Coefficients of every impact and their errors, NaN where not ``known``; and the sum of squares left.

    The noise of the first column is taken out of its sum of squares, of which it has ``noise``.
    """
    squares = np.einsum("isa,isb->iab", columns, columns)
    scale = np.sqrt(np.einsum("iaa->ia", squares))
    scale = np.where(known[:, None] & (scale > 0), scale, 1.0)
    squares[:, 0, 0] -= noise
    squares = squares / (scale[:, :, None] * scale[:, None])
    products = np.einsum("isa,is->ia", columns, values) / scale
    inverse = np.linalg.pinv(squares, hermitian=True)
    coefficients = np.einsum("iab,ib->ia", inverse, products)
    left = ((values - np.einsum("isa,ia->is", columns, coefficients / scale)) ** 2).sum(axis=1)
    variance = left / np.maximum(count - columns.shape[2], 1)
    sd = np.sqrt(variance[:, None] * np.einsum("iaa->ia", inverse))
    of_known, of_sd = (np.where(known[:, None], part / scale, np.nan).T for part in (coefficients, sd))
    return of_known, of_sd, left


def _median(values: Column, sd: Column) -> tuple[float, float]:
    """The median of known values, and its standard error: as they scatter, or of the only one."""
    known = np.isfinite(values)
    if not known.any():
        return float("nan"), float("nan")
    values, sd = values[known], sd[known]
    centre = float(np.median(values))
    # Of a normal, the median deviation is 0.674 standard deviations, and a median's error 1.25 of a mean's.
    spread = max(1.4826 * float(np.median(np.abs(values - centre))), float(np.median(sd)))
    return centre, 1.2533 * spread / np.sqrt(values.size) if values.size > 1 else spread
