"""Contact within a sampling interval, and velocity and displacement at the first sample after it.

The deceleration of a spring and damper met at velocity V jumps by C V / M at contact, so that a contact
time wrong by half an interval costs half an interval's worth of velocity and of displacement: 2.5 % of the
peak displacement of a typical impact sampled at 2 kHz. The samples themselves know better. With
A(t) = ∫(d − g) and B(t) = ∬(d − g) from the first sample on, a = C/M and b = K/M, the motion obeys

    d = a (v₁ − A) + b (x₁ + v₁ t − B),

where (x₁, v₁) is the state that (0, V) grows into over the unknown time δ from contact to that sample, and
g is gravity along the motion: d is force over mass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayestissue.recordings.signal.padded_traces import (
    Column,
    ImpactTraces,
    Index,
    Mask,
    Rows,
    at,
    first_where,
    samples_before,
)
from bayestissue.recordings.signal.signal_settings import BEYOND_LIMIT


class Start(NamedTuple):
    """Contact, and the state at the first sample after it, each [impact].

    Attributes:
        since_s, sd: from contact to that sample, s, as the samples have it, and its standard deviation; 0
            where contact was given.
        bracket_s, bracket_sd: the same before the samples were asked: what a model of those samples
            themselves may start from.
        bracket_uniform: whether it then lay anywhere between two moments, no one of them likelier.
        interval_s: the sampling interval that contact falls in; 0 where that is not known.
        free, free_sd: s by least squares alone, whatever the bracket, and its standard error.
        by_velocity: by how much ``free`` grows with the velocity at contact, s per fraction of it.
        x: m.
        v: m/s.
    """

    since_s: Column
    sd: Column
    bracket_s: Column
    bracket_sd: Column
    bracket_uniform: Mask
    interval_s: Column
    free: Column
    free_sd: Column
    by_velocity: Column
    x: Column
    v: Column


def find_start(
    decelerations: ImpactTraces,
    lost: tuple[Rows, Rows],
    bracket: tuple[Column, Column],
    interval_s: Column,
    fraction: float,
) -> Start:
    """The state at the first sample, contact lying between two moments before it.

    δ, a and b are fitted by least squares to the samples until zero velocity; δ is then its mean under the
    normal likelihood that this gives and a uniform prior over the bracket. Noise-free samples thus pin
    contact down, and noise leaves it near the middle. A tissue that is no spring and damper can move contact
    by no more than the bracket, one sampling interval as a rule.

    Args:
        decelerations: m/s², from the first sample in contact on, offset removed.
        lost: [impact, sample], the integral of d − g from that sample, m/s, and the integral of that, m.
        bracket: [impact], from contact to that sample, s, at the least and at the most; equal where known.
        interval_s: as `Start` has it.
        fraction: the part of that interval from contact to that sample, where it is known; else nan.
    """
    d, inside, dt, (least, most) = decelerations.value, decelerations.inside, decelerations.dt, bracket
    velocity, gravity = decelerations.velocity, decelerations.gravity
    # Some velocity is gone by the first sample; past zero velocity the impactor may have left the tissue.
    fall = np.maximum(d[:, 0] - d[:, min(1, d.shape[1] - 1)], 0)
    slowed = velocity - (d[:, 0] - gravity + fall * most / (2 * dt)) * most
    slowed = np.clip(slowed - 0.03 * velocity, 0.5 * velocity, velocity)
    stopped = first_where((lost[0] >= slowed[:, None]) & inside, decelerations.n_samples - 1)
    problem = LeastSquares.until(stopped, decelerations, lost)
    duration = problem.duration
    known = np.where(interval_s > 0, fraction * dt, np.nan)
    low, high, fixed = least / duration, most / duration, np.isfinite(known)
    with np.errstate(all="ignore"):
        ab, free, free_sd, by_velocity = problem.fit(low, high)
        delta, delta_sd = _mean_within(free, free_sd, low, high)
        delta, delta_sd = np.where(fixed, known / duration, delta), np.where(fixed, 0.0, delta_sd)
        ab = problem.fit_given(ab, delta)
        x, v = grown(ab[:, 0], ab[:, 1], delta, problem.fall)
    # Too few samples, or a motion no spring and damper makes: d is held constant back to contact.
    d1 = np.where(inside[:, 0], d[:, 0] - gravity, 0) * duration / velocity
    # Comparisons with no number are false.
    sound = (np.abs(v - 1) < 0.5) & (np.abs(x - delta) < 0.5 * delta + 1e-12)
    delta = np.where(np.isfinite(delta), delta, (low + high) / 2)
    x = np.where(sound, x, delta - d1 * delta**2 / 2)
    v = np.where(sound, v, 1 - d1 * delta)
    delta_sd = np.where(np.isfinite(delta_sd), delta_sd, (high - low) / np.sqrt(12))
    width = np.where(fixed, 0.0, most - least)
    return Start(
        delta * duration,
        delta_sd * duration,
        np.where(fixed, known, (least + most) / 2),
        np.sqrt(width**2 * (1 / 12)),
        width > 0,
        interval_s,
        free * duration,
        free_sd * duration,
        by_velocity * duration,
        x * velocity * duration,
        v * velocity,
    )


@dataclass(frozen=True)
class LeastSquares:
    """Products of d and of 1, t, A, B over the samples, in units of the duration and the velocity.

    The fitted deceleration is linear in c = (a v₁ + b x₁, b v₁, −a, −b), so these products are all that the
    iterations need: none of them passes over the samples again.
    """

    basis: Float[np.ndarray, "impact 4 sample"]
    target: Rows
    gram: Float[np.ndarray, "impact 4 4"]
    moment: Float[np.ndarray, "impact 4"]
    count: Column
    fall: Column
    duration: Column

    @classmethod
    def until(cls, last: Index, recorded: ImpactTraces, lost: tuple[Rows, Rows]) -> LeastSquares:
        """The products over the samples until ``last`` of each impact; the others as of `find_start`."""
        d, dt, number = recorded.value, recorded.dt, recorded.sample_numbers
        velocity, gravity = recorded.velocity, recorded.gravity
        used = recorded.inside & samples_before(d, last + 1)
        duration = np.where(last > 0, at(number, last), 1.0) * dt
        units = velocity[:, None], (velocity * duration)[:, None]
        time = number * (dt / duration)[:, None]
        rows = np.stack([np.ones_like(d), time, lost[0] / units[0], lost[1] / units[1]], axis=1)
        basis = np.where(used[:, None, :], rows, 0)
        target = np.where(used, d * (duration / velocity)[:, None], 0)
        gram, moment = basis @ basis.transpose(0, 2, 1), (basis @ target[..., None])[..., 0]
        return cls(basis, target, gram, moment, used.sum(axis=1), gravity * duration / velocity, duration)

    def fit(self, low: Column, high: Column) -> tuple[np.ndarray, Column, Column, Column]:
        """(a, b), δ, its standard error and its slope by log V, δ free within twice the bracket around it.

        With strong damping the sum of squares may have a second hollow as deep, where the spring pulls or
        contact is out of the bracket: of three descents the best is taken that is neither, δ moved into the
        bracket.
        """
        tried = [self._descend(low + share * (high - low), low, high) for share in (0.1, 0.5, 0.9)]
        within = [self._within(parameters, low, high) for parameters in tried]
        whole = np.square(self.target).sum(axis=1)
        squares = np.stack(
            [np.nan_to_num(self._residual(p) + whole * (p[:, 1] < 0), nan=np.inf) for p in within]
        )
        # The first of those that came to the same, or rounding would choose.
        least = (squares <= (1 + 1e-6) * squares.min(axis=0)).argmax(axis=0)
        best = np.take_along_axis(np.stack(tried), least[None, :, None], axis=0)[0]
        _, covariance = self._step(best, free=3)
        variance = self._residual(best) / np.maximum(self.count - 3, 1)
        # V multiplies a v₁ + b x₁ and b v₁, which the samples know: the others make up for it.
        by_velocity = _coefficients(best, self.fall) * np.array([1.0, 1.0, 0.0, 0.0])
        moment = _jacobian(best, self.fall).transpose(0, 2, 1) @ (self.gram @ by_velocity[..., None])
        slope = -(covariance @ moment)[:, 2, 0]
        return best[:, :2], best[:, 2], np.sqrt(variance * covariance[:, 2, 2]), slope

    def fit_at(
        self, ratio: Float[np.ndarray, " ratio"], low: Column, high: Column
    ) -> Float[np.ndarray, "impact ratio 3"]:
        """(a, b) and δ within the bracket, with so many times the velocity at contact."""
        scale = np.stack([np.ones_like(ratio), np.ones_like(ratio), 1 / ratio, 1 / ratio], axis=1)
        units = (1 / ratio[:, None], scale / ratio[:, None], scale[:, :, None] * scale[:, None])
        parts = (self.target[:, :1], self.moment, self.gram)
        target, moment, gram = (
            (part[:, None] * unit).reshape(-1, *part.shape[1:])
            for part, unit in zip(parts, units, strict=True)
        )
        columns = self.count, self.fall, self.duration, low, high
        count, fall, duration, low, high = (np.repeat(column, len(ratio)) for column in columns)
        fall = fall / np.tile(ratio, len(self.fall))
        scaled = LeastSquares(self.basis[:0], target, gram, moment, count, fall, duration)
        parameters = scaled._within(scaled._descend((low + high) / 2, low, high), low, high)
        return parameters.reshape(-1, len(ratio), 3)

    def _descend(self, delta: Column, low: Column, high: Column) -> np.ndarray:
        ab = self.fit_given(self._first_guess(delta), delta)
        parameters = np.concatenate([ab, delta[:, None]], axis=1)
        reach = 2 * (high - low)
        for _ in range(12):
            parameters = parameters + self._step(parameters, free=3)[0]
            parameters[:, 2] = np.clip(parameters[:, 2], low - reach, high + reach)
        return parameters

    def _within(self, parameters: np.ndarray, low: Column, high: Column) -> np.ndarray:
        delta = np.clip(parameters[:, 2], low, high)
        return np.column_stack([self.fit_given(parameters[:, :2], delta), delta])

    def _residual(self, parameters: np.ndarray) -> Column:
        fitted = (_coefficients(parameters, self.fall)[:, None, :] @ self.basis)[:, 0]
        return ((self.target - fitted) ** 2).sum(axis=1)

    def fit_given(self, ab: np.ndarray, delta: Column) -> np.ndarray:
        """(a, b) with δ as given."""
        parameters = np.concatenate([ab, delta[:, None]], axis=1)
        for _ in range(6):
            parameters = parameters + self._step(parameters, free=2)[0]
        return parameters[:, :2]

    def _first_guess(self, delta: Column) -> np.ndarray:
        # With d held constant back to contact, x₁ and v₁ are known, and the model is linear in a and b.
        v = np.clip(1 - (self.target[:, 0] - self.fall) * delta, 0.3, 1)
        x, zero, one = delta * (1 + v) / 2, np.zeros_like(delta), np.ones_like(delta)
        transform = np.stack(
            [np.stack([v, zero, -one, zero], axis=1), np.stack([x, v, zero, -one], axis=1)], axis=2
        )
        return self._solve(transform, self.moment)[0]

    def _step(self, parameters: np.ndarray, free: int) -> tuple[np.ndarray, np.ndarray]:
        jacobian = _jacobian(parameters, self.fall)[:, :, :free]
        remaining = self.moment - (self.gram @ _coefficients(parameters, self.fall)[..., None])[..., 0]
        step, covariance = self._solve(jacobian, remaining)
        return np.pad(step, ((0, 0), (0, 3 - free))), covariance

    def _solve(self, jacobian: np.ndarray, moment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        across = jacobian.transpose(0, 2, 1)
        normal = across @ self.gram @ jacobian
        scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
        one = np.eye(jacobian.shape[2])
        scaled = normal / scale[:, :, None] / scale[:, None, :]
        # An impact without a usable sample must not make the whole stack of matrices singular.
        unusable = ~np.isfinite(scaled).all(axis=(1, 2)) | (np.abs(scaled).sum(axis=(1, 2)) == 0)
        blank = unusable[:, None, None] * one
        inverse = np.linalg.inv(np.where(np.isfinite(scaled), scaled, 0) + 1e-14 * one + blank)
        covariance = inverse / scale[:, :, None] / scale[:, None, :]
        return (covariance @ (across @ moment[..., None]))[..., 0], covariance


def _coefficients(parameters: np.ndarray, fall: Column) -> np.ndarray:
    a, b, delta = parameters.T
    x, v = grown(a, b, delta, fall)
    return np.stack([a * v + b * x, b * v, -a, -b], axis=1)


def _jacobian(parameters: np.ndarray, fall: Column) -> np.ndarray:
    # Complex steps: the coefficients are polynomials, and there is no difference that could cancel.
    step = 1e-30
    return np.stack(
        [_coefficients(parameters + 1j * step * np.eye(3)[k], fall).imag / step for k in range(3)], axis=2
    )


def grown(
    a: np.ndarray, b: np.ndarray, delta: np.ndarray, fall: np.ndarray, orders: int = 12
) -> tuple[np.ndarray, np.ndarray]:
    """The motion x″ = ``fall`` − a x′ − b x from x = 0, v = 1, by so many ``orders`` of its Taylor series."""
    earlier, later = np.zeros_like(delta), np.ones_like(delta)
    x, v, power = earlier, later, np.ones_like(delta)
    for order in range(1, orders):
        power = power * delta / order
        x = x + later * power
        earlier, later = later, -a * later - b * earlier + (fall if order == 1 else 0.0)
        v = v + later * power
    return x, v


def deceleration(
    logs: np.ndarray, time: Float[np.ndarray, "*time"], velocity: float, gravity: float
) -> Float[np.ndarray, "*time"]:
    """Deceleration of a mass that met spring and damper: -V u'' + g (1 - u'), u the answer to an impulse.

    u'' + a u' + b u = 0, solved in closed form by the two roots.

    Args:
        logs: log a, log b, and how long before time 0 contact was, s.
        time: s.
        velocity: V, at contact, m/s.
        gravity: g, along the motion, m/s².
    """
    (a, b), since = np.exp(logs[:2]), time + logs[2]
    # Apart even at critical damping, where the two would be one.
    root = np.sqrt(complex(a**2 / 4 - b)) + 1e-6 * np.sqrt(b)
    p, q = -a / 2 + root, -a / 2 - root
    u1, u2 = ((p**k * np.exp(p * since) - q**k * np.exp(q * since)) / (p - q) for k in (1, 2))
    return np.asarray((gravity * (1 - u1) - velocity * u2).real)


def _mean_within(
    mean: Column, sd: Column, low: Column, high: Column, nodes: int = 65
) -> tuple[Column, Column]:
    """Posterior mean and standard deviation of δ under N(mean, sd²) as likelihood, at so many ``nodes``.

    The prior is uniform over [low, high].
    """
    width = high - low
    grid = low[:, None] + width[:, None] * np.linspace(0, 1, nodes)
    distance = ((grid - mean[:, None]) / sd[:, None]) ** 2
    weight = np.exp((distance.min(axis=1, keepdims=True) - distance) / 2)
    weight /= weight.sum(axis=1, keepdims=True)
    middle = (weight * grid).sum(axis=1)
    variance = (weight * (grid - middle[:, None]) ** 2).sum(axis=1)
    # Where the likelihood is narrower than the grid the cut matters only if the mean lies outside.
    narrow = ~(sd > width / (nodes - 1))
    middle = np.where(narrow, np.clip(mean, low, high), middle)
    variance = np.where(narrow, np.minimum(sd, width) ** 2, variance)
    return middle, np.sqrt(variance)


def beyond_limit(decelerations: ImpactTraces, bracket: tuple[Column, Column]) -> Rows:
    """The deceleration with a fitted one in place of samples at the limit, if it lies beyond.

    Enough to tell until when the impactor moves into the tissue. A spring and damper, d = a v + b x with
    a = C/M and b = K/M, is fitted to the samples that are not clipped by least squares, contact lying between
    the moments that the recording leaves open; where it is within the limit though the sample is clipped,
    that counts as an error too. No likelihood is asked of what it says beyond the limit.

    Args:
        decelerations: from the first sample in contact on, offset removed, m/s².
        bracket: [impact], from contact to the first sample, s, at the least and at the most.
    """
    whole, clipped = decelerations.value.copy(), decelerations.clipped
    for row in np.flatnonzero(decelerations.limited):
        here = slice(0, decelerations.n_samples[row])
        d, sign = whole[row, here], clipped[row, here]
        fitted = _fitted(decelerations, int(row), (float(bracket[0][row]), float(bracket[1][row])))
        if fitted is not None:
            whole[row, here] = np.where(sign * fitted > sign * d, fitted, d)
    return whole


def _fitted(
    decelerations: ImpactTraces, row: int, bounds: tuple[float, float]
) -> Float[np.ndarray, " sample"] | None:
    # A third of a second to import, which other recordings need not wait for.
    from scipy.optimize import least_squares

    here = row, slice(0, decelerations.n_samples[row])
    d, sign, time = decelerations.value[here], decelerations.clipped[here], decelerations.time_s[here]
    velocity, gravity = decelerations.velocity[row], decelerations.gravity[row]
    limit, last = float(np.abs(d[sign != 0]).max()), int(np.flatnonzero(sign)[-1])
    gone = np.flatnonzero((d < BEYOND_LIMIT.pushes * limit) & (np.arange(d.size) > last))
    end = int(gone[0]) if gone.size else d.size
    lasts = time[end - 1] + bounds[1]
    if end < BEYOND_LIMIT.fewest or not lasts > 0:
        return None
    # After the plateau as long as it took, and no longer: what comes back is another law.
    stop = min(end, last + 1 + max(BEYOND_LIMIT.fewest, int(np.count_nonzero(sign)) // 2))
    part, near = slice(0, stop), sign[:stop]

    def residuals(logs: np.ndarray) -> np.ndarray:
        difference = (deceleration(logs, time[part], velocity, gravity) - d[part]) / limit
        return np.where(near == 0, difference, np.minimum(near * difference, 0.0))

    best = None
    for share in BEYOND_LIMIT.starts:
        omega = np.pi * share / lasts
        start = np.array([np.log(0.4 * omega), 2 * np.log(omega), (bounds[0] + bounds[1]) / 2])
        wide = 1e-9 * lasts
        low = np.array([np.log(1e-3 * omega), 2 * np.log(0.1 * omega), bounds[0] - wide])
        high = np.array([np.log(1e2 * omega), 2 * np.log(1e2 * omega), bounds[1] + wide])
        fit = least_squares(residuals, start, bounds=(low, high), x_scale=[1.0, 1.0, lasts])
        best = fit if best is None or fit.cost < best.cost else best
        if best.cost < BEYOND_LIMIT.well * stop:
            break
    return None if best is None else deceleration(best.x, time, velocity, gravity)
