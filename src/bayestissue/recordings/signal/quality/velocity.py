"""The velocity at contact that recordings imply, against the stated one: all together, and apart.

With u the answer to a unit impulse of u″ + a u′ + b u = 0, a mass that meets a spring and damper at the
velocity V (1 + f), with gravity g along the motion, has the deceleration (force over mass)

    d = V (1 + f) (a u′ + b u) + g (1 − u′).

S(f) is its least sum of squares over a, b and contact's moment. Under white noise of unknown size the log
likelihood is −(ν − 1) / 2 log S(f), ν being the degrees of freedom, and what it gains over f = 0 at its
greatest is about half a chi-square of one degree of freedom where the stated velocity is right. Log
likelihoods of impacts add up, so that a velocity that is wrong in all of them, or in those of one condition,
shows where no trace by itself shows it. What was declared of the velocity is an error of each
impact, over which its likelihood is averaged.

A tissue that is no spring and damper bends one trace as another velocity may: of 60 impacts on a spring and
damper in series 8 looked so. Therefore nothing is said of one by itself, nor of a group whose traces no one
velocity explains but for noise. A drop of another height lies apart from the others of its condition whatever
the tissue is: that is asked besides, against their median and their scatter. Where tissues differ within a
condition, such as pads, one that obeys another law lies apart in all of its impacts, and no velocity explains
them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from scipy.stats import chi2, median_abs_deviation

from bayestissue.recordings.dataset.dataset_file import STANDARD_GRAVITY, Uncertainty
from bayestissue.recordings.signal.displacement import Displacements
from bayestissue.recordings.signal.integrals import trapezoids
from bayestissue.recordings.signal.padded_traces import Column, ImpactTraces, Mask
from bayestissue.recordings.signal.quality.samples import PulseAndRests, chance
from bayestissue.recordings.signal.signal_settings import LAW, PULSE, VELOCITY
from bayestissue.recordings.signal.start import LeastSquares

# Fractions of the stated velocity that are tried, and the place of 0 among them.
_STATED = len(VELOCITY.steps)
FRACTIONS = np.array([*np.negative(VELOCITY.steps[::-1]), 0.0, *VELOCITY.steps])


class Implied(NamedTuple):
    """What the traces say of the velocity at contact.

    Attributes:
        log_likelihood: at each of `FRACTIONS`, [impact, fraction].
        usable: whether the trace is whole, and nothing else is wrong with it.
        explained: whether some velocity leaves of it no more than noise.
    """

    log_likelihood: Float[np.ndarray, "impact fraction"]
    usable: Mask
    explained: Mask

    @property
    def fraction(self) -> Column:
        """Of the stated velocity, by which the implied one is greater."""
        return np.array([_peak(row)[0] for row in self.log_likelihood])

    def groups(self, codes: np.ndarray, fewest: int) -> Iterator[np.ndarray]:
        """The usable impacts of each number, where there are so many or more."""
        rows = (np.flatnonzero((codes == code) & self.usable) for code in np.unique(codes))
        return (group for group in rows if len(group) >= fewest)


def implied(signal: Displacements, recorded: PulseAndRests, uncertainty: Uncertainty) -> Implied:
    """The velocity that each trace implies.

    Args:
        signal: over the rebound.
        recorded: noise and peak.
        uncertainty: of the velocity; of the gain, which is one of velocity; and of the zero where no quiet
            part tells it.
    """
    d, n, dt, noise_sd = signal.deceleration, signal.n_samples, signal.dt, recorded.sd
    velocity_sd = uncertainty.of_velocity(signal.velocity)
    steps = np.diff(signal.sample_numbers, axis=1) * dt[:, None]
    first = trapezoids(d - signal.gravity[:, None], steps)
    problem = LeastSquares.until(np.maximum(n - 1, 0), signal, (first, trapezoids(first, steps)))
    duration = problem.duration
    middle, half = signal.contact.bracket_s, np.sqrt(3) * signal.contact.bracket_sd
    bracket = np.maximum(middle - half, 0) / duration, (middle + half) / duration
    zero = signal.quiet.zero_sd(uncertainty.offset_sd)
    taken = 1 - 1 / np.sqrt(1 + n * np.square(zero / np.maximum(noise_sd, 1e-12)))
    squares = _least(problem, signal, bracket, taken) * np.square(signal.velocity / duration)[:, None]
    freedom = np.maximum(n - VELOCITY.parameters, 1)
    least = np.maximum([-_peak(-row)[1] for row in squares], 0)
    floor = noise_sd**2 + (LAW.misfit * recorded.peak) ** 2
    explained = chance(least / floor, freedom, np.maximum(PULSE.worth * n, 1)) > VELOCITY.unexplained
    explained &= (n >= VELOCITY.fewest) & np.isfinite(squares[:, _STATED]) & (noise_sd > 0)
    # What a sensor cut off is no part of the integrals.
    whole = ~signal.limited
    share = np.maximum(squares - least[:, None], 0) / np.maximum(least, freedom * floor)[:, None]
    log_likelihood = -np.maximum(freedom - 1, 1)[:, None] / 2 * np.log1p(share)
    return Implied(_averaged(log_likelihood, velocity_sd), whole, explained & whole)


def _least(
    problem: LeastSquares, part: ImpactTraces, bracket: tuple[Column, Column], taken: Column
) -> np.ndarray:
    """S at each of `FRACTIONS`, by Gauss and Newton's way from where the integrals put a, b and contact.

    Integrals have the noise of all samples before, which looks like a velocity: they are a start and no more.
    The zero's error is integrated out: (1 + u uᵀ)^(−1/2) takes a share of the residuals' mean, ``taken``.
    """
    ratio, (low, high) = (1 + FRACTIONS)[:, None], bracket
    at = problem.fit_at(1 + FRACTIONS, low, high)
    pushes = (at[..., :2] > 0).all(axis=-1) & np.isfinite(at).all(axis=-1)
    at = np.where(pushes[..., None], at, [1.0, 1.0, 0.0])
    at[..., :2] = np.log(at[..., :2])
    time = part.sample_numbers * (part.dt / problem.duration)[:, None]
    even = np.allclose(np.diff(time), time[:, 1:2], rtol=1e-9)
    exponentials = _exponentials if even else lambda rate, t: np.exp(rate * t)
    time = time[:, None]
    unused, fall = ~part.inside[:, None], problem.fall[:, None, None]

    def residuals(at: np.ndarray) -> np.ndarray:
        a, b = np.exp(np.clip(at[..., :2], -20, 20)).swapaxes(0, -1).swapaxes(1, -1)[..., None]
        t = time + at[..., 2:]
        root = np.sqrt(a**2 / 4 - b + 0j) + 1e-9
        p, q = -a / 2 + root, -a / 2 - root
        rises, falls = exponentials(p, t), exponentials(q, t)
        u, speed = ((rises - falls) / (p - q)).real, ((p * rises - q * falls) / (p - q)).real
        d = ratio * (a * speed + b * u) + fall * (1 - speed)
        residual = np.where(unused, 0.0, problem.target[:, None] - d)
        mean = residual.sum(axis=-1, keepdims=True) / problem.count[:, None, None]
        return np.where(unused, 0.0, residual - taken[:, None, None] * mean)

    best = np.full(at.shape[:2], np.inf)
    for _ in range(VELOCITY.rounds):
        residual = residuals(at)
        best = np.minimum(best, np.nan_to_num((residual**2).sum(axis=-1), nan=np.inf))
        changed = [residuals(at + step) - residual for step in VELOCITY.small * np.eye(3)]
        slope = np.stack(changed, axis=-1) / VELOCITY.small
        normal = np.nan_to_num(slope.swapaxes(-1, -2) @ slope)
        normal += (VELOCITY.ridge * np.einsum("ifkk->ifk", normal) + 1e-12)[..., None] * np.eye(3)
        moment = np.nan_to_num((slope * residual[..., None]).sum(axis=-2))
        change = np.linalg.solve(normal, moment[..., None])[..., 0]
        # Contact stops at the bracket's ends, and the other two are the best given that.
        change[..., 2] = at[..., 2] - np.clip(at[..., 2] - change[..., 2], low[:, None], high[:, None])
        reduced = moment[..., :2] - normal[..., :2, 2] * change[..., 2:]
        change[..., :2] = np.linalg.solve(normal[..., :2, :2], reduced[..., None])[..., 0]
        at = at - np.clip(change, -0.5, 0.5)
    return np.where(pushes, np.minimum(best, (residuals(at) ** 2).sum(axis=-1)), np.inf)


def _exponentials(rate: np.ndarray, t: np.ndarray) -> np.ndarray:
    """exp(rate t) along the last axis, of even times by products: a tenth of the time."""
    factors = np.repeat(np.exp(rate * (t[..., 1:2] - t[..., :1])), t.shape[-1], axis=-1)
    factors[..., :1] = np.exp(rate * t[..., :1])
    return np.cumprod(factors, axis=-1, out=factors)


def _averaged(log_likelihood: np.ndarray, sd: Column) -> np.ndarray:
    """Over an error of each impact's velocity, normal with ``sd``."""
    width = np.gradient(FRACTIONS)
    distance = (FRACTIONS[:, None] - FRACTIONS) / np.maximum(sd, 1e-6)[:, None, None]
    log_weight = np.log(width) - distance**2 / 2
    log_weight = log_weight - logsumexp(log_weight, axis=-1, keepdims=True)
    averaged = logsumexp(log_likelihood[:, None] + log_weight, axis=-1)
    # A velocity that no law explains has none of its neighbours' likelihood: `_peak` would take a cliff for
    # one side of a parabola.
    return np.where(np.isneginf(log_likelihood), -np.inf, averaged)


def contradictions(
    implied: Implied, trial: np.ndarray, levels: Sequence[np.ndarray] = ()
) -> tuple[np.ndarray, Column]:
    """What the recordings say against the stated velocities: of all, else of conditions, and single impacts.

    Args:
        implied: see `implied`.
        trial: of each impact, the number of its condition, from 0.
        levels: of each impact, the number of its person, pad or whatever else says what was hit.

    Returns:
        Of each impact whose velocity is contradicted, "all", "trial" or "impact", else ""; and the fraction
        by which the velocity that the recordings imply is greater than stated: one of a group.
    """
    log_likelihood, fractions = implied.log_likelihood, implied.fraction
    alone = _apart(implied, trial)
    for codes in levels:
        alone &= ~_of_another_law(implied, codes)
    kinds, tests = np.where(alone, "impact", ""), 2 + trial.max(initial=0)
    for kind, codes in (("all", np.zeros_like(trial)), ("trial", trial)):
        for code in range(codes.max(initial=-1) + 1):
            members = (codes == code) & (kinds == "")
            which = members & implied.explained
            if which.sum() < max(2, VELOCITY.majority * members.sum()):
                continue
            fraction = _greatest(log_likelihood[which].sum(axis=0), tests)
            if fraction and _common(log_likelihood[which], fraction):
                kinds[members], fractions[members] = kind, fraction
    return kinds, fractions


def _greatest(log_likelihood: np.ndarray, tests: int) -> float:
    """Where it is greatest, if that gains more over the stated velocity than chance does; else 0."""
    fraction, greatest = _peak(log_likelihood)
    gain, least = greatest - log_likelihood[_STATED], chi2.isf(VELOCITY.alarms / tests, 1) / 2
    return fraction if abs(fraction) >= VELOCITY.least and gain > least else 0.0


def _peak(log_likelihood: np.ndarray) -> tuple[float, float]:
    """Where it is greatest and what it is there, by the parabola through the greatest and its neighbours."""
    middle = int(log_likelihood.argmax())
    at, value = float(FRACTIONS[middle]), float(log_likelihood[middle])
    around = slice(middle - 1, middle + 2)
    if not 0 < middle < len(FRACTIONS) - 1 or not np.isfinite(log_likelihood[around]).all():
        return at, value
    bend, slope, _ = np.polyfit(FRACTIONS[around] - at, log_likelihood[around], 2)
    if bend >= 0:
        return at, value
    return float(at - slope / (2 * bend)), float(value - slope**2 / (4 * bend))


def _common(log_likelihood: np.ndarray, fraction: float) -> bool:
    """Whether one fraction explains the traces of a group about as well as one of each."""
    nearest = np.abs(FRACTIONS - fraction).argmin()
    lost = 2 * (log_likelihood.max(axis=1) - log_likelihood[:, nearest]).sum()
    return bool(lost < chi2.isf(VELOCITY.alarms, len(log_likelihood)))


def _apart(implied: Implied, trial: np.ndarray) -> Mask:
    """The impacts whose implied velocity lies far from those of the others of their condition.

    Far in the scatter of these, which few impacts tell badly; and further from where their median may be than
    the trace's own noise lets it be.
    """
    apart, fraction = np.zeros(len(trial), bool), np.log1p(implied.fraction)
    beyond_chance = chi2.isf(VELOCITY.alarms / len(trial), 1)
    for rows in implied.groups(trial, VELOCITY.others + 1):
        middle, spread = np.median(fraction[rows]), median_abs_deviation(fraction[rows], scale="normal")
        deviation = fraction[rows] - middle
        far = np.abs(deviation) > max(VELOCITY.spreads * spread, np.log1p(VELOCITY.apart))
        nearest = np.expm1(middle + np.sign(deviation) * VELOCITY.of_median * spread / np.sqrt(len(rows)))
        log_likelihood = implied.log_likelihood[rows]
        there = [np.interp(at, FRACTIONS, row) for at, row in zip(nearest, log_likelihood, strict=True)]
        apart[rows] = far & (2 * (log_likelihood.max(axis=1) - there) > beyond_chance)
    return apart


def _of_another_law(implied: Implied, codes: np.ndarray) -> Mask:
    """The impacts that look like all others of their level, where no velocity leaves noise alone."""
    typical, fraction = np.zeros(len(codes), bool), np.log1p(implied.fraction)
    for rows in implied.groups(codes, VELOCITY.fewest_impacts):
        typical[rows] = np.abs(fraction[rows] - np.median(fraction[rows])) < np.log1p(VELOCITY.apart)
    return typical & ~implied.explained


def in_words(kind: str, fraction: float, impact: Mapping[Any, Any], *, falls: bool) -> str:
    """What is said of an impact.

    Args:
        kind: see `contradictions`.
        fraction: likewise.
        impact: with ``velocity_m_s`` and, where there are conditions, ``trial``.
        falls: the velocity is that of a fall, so that a height says the same.
    """
    stated = float(impact["velocity_m_s"])
    met, way = stated * (1 + fraction), "more" if fraction > 0 else "less"
    said = f"met at {met:.3g} m/s, {abs(fraction):.0%} {way} than stated"
    if falls:
        cm, its = (50 * v**2 / STANDARD_GRAVITY for v in (met, stated))
        height = "greater" if fraction > 0 else "smaller"
        said = f"dropped from a {height} height (about {cm:.2g} cm, stated {its:.3g} cm): {said}"
    where = {"all": "; so in all impacts", "trial": f"; so in all of condition {impact.get('trial')}"}
    return f"as if {said}{where.get(kind, '')}" if kind else ""
