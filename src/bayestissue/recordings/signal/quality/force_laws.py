"""Whether any tissue pushes back like this: force laws fitted to the motion that the recording gives.

What a spring and damper does not give may be gravity along the motion that was not declared, or was and is
not there; or a low-pass that was not declared, of which a rise at contact speaks that is slower than the
sampling. Its force jumps at contact. Behind a filter with the answer s(t) to a step, and r(t) to a ramp, what
is recorded is

    y = a (V s(t - c) - int y) + b (V r(t - c) - int int y),  a = C / M, b = K / M,

since filtering and integrating commute: linear in a and b once the moment of contact c and the corner are
given. Gravity g along the motion adds a g r + b g int r. A grid of both is tried, of a filter of the second
order. Elements whose force rises from 0, as Maxwell's and a ball's do, rise slowly too: what is found is a
filter only where it leaves noise alone, and no law of depth and velocity comes near that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from bayestissue.recordings.dataset.dataset_file import STANDARD_GRAVITY, LowPassFilter
from bayestissue.recordings.signal.displacement import BEFORE, Displacements
from bayestissue.recordings.signal.filters import answers
from bayestissue.recordings.signal.integrals import trapezoids
from bayestissue.recordings.signal.padded_traces import Column, Mask, Rows
from bayestissue.recordings.signal.quality.samples import PulseAndRests, chance
from bayestissue.recordings.signal.signal_settings import LAW, PULSE, SAMPLES
from bayestissue.recordings.signal.start import deceleration

type LawTerms = Float[np.ndarray, "impact sample term"]


@dataclass(frozen=True)
class Suspected:
    """What each recording says of a low-pass.

    Attributes:
        corner_hz: of the second-order Butterworth filter that explains it, Hz; NaN where there is no need of
            one.
        change_K, change_C: K and C without the filter over those with it, less 1.
    """

    corner_hz: Column
    change_K: Column
    change_C: Column


def motion(signal: Displacements) -> tuple[Rows, Rows]:
    """Displacement and velocity from the state at the first sample and force over mass, by trapezoids."""
    number, dt = signal.sample_numbers, signal.dt[:, None]
    step = np.diff(number, axis=1) * dt
    lost = trapezoids(signal.deceleration - signal.gravity[:, None], step)
    x, v = signal.x[:, :1], signal.v[:, :1]
    return x + v * number * dt - trapezoids(lost, step), v - lost


def laws(x: Rows, v: Rows, used: Mask) -> Iterator[LawTerms]:
    """Terms of force laws that together come near every element of this program.

    A damper beside a spring that stiffens evenly or steeply; a spring and damper in series, alone or beside a
    spring (the force is linear in x, v, 1 and the integral of x); Hertz's contact with losses.
    """
    deepest = np.maximum(np.where(used, x, 0).max(axis=1), 1e-12)[:, None]
    fastest = np.maximum(np.where(used, np.abs(v), 0).max(axis=1), 1e-12)[:, None]
    s, u = np.clip(x / deepest, -0.3, 1.5), np.clip(v / fastest, -2, 2)
    positive, one = np.maximum(s, 0), np.ones_like(s)
    held = trapezoids(np.where(used, s, 0), 1 / np.maximum(used.sum(axis=1, keepdims=True), 1))
    root = np.sqrt(positive)
    yield np.stack([u, s, positive**2, positive**6], axis=-1)
    yield np.stack([u, s, one, held], axis=-1)
    yield np.stack([positive * root, positive * root * u, s, u], axis=-1)


def any_law(x: Rows, v: Rows, used: Mask) -> LawTerms:
    """Terms of a law with all of these at once."""
    first, second, third = laws(x, v, used)
    product = first[..., :1] * first[..., 1:2]
    return np.concatenate([first, second[..., 2:], third[..., :2], product], axis=-1)


def no_law(signal: Displacements, used: Mask, recorded: PulseAndRests) -> Mask:
    """Where what the widest law leaves over is more than noise and the laws' own misfit."""
    d, freedom, law = signal.deceleration, recorded.freedom, any_law(*motion(signal), used)
    samples = used.sum(axis=1)
    count = np.maximum(samples - law.shape[-1], 1)
    _, residual = _fitted(law, d, used, ridge=1e-10)
    variance = recorded.sd**2 + (LAW.misfit * recorded.peak) ** 2
    wide = chance((residual**2).sum(axis=1) / variance, count, freedom) < LAW.alarms / 2
    # A step's own share, at the sample where it is greatest; less is left of a step than itself.
    sums, index = np.cumsum(residual[:, ::-1], axis=1)[:, ::-1], np.arange(d.shape[1])
    after = np.maximum(samples[:, None] - index, 1)
    share = sums**2 / (after * (1 - after / np.maximum(samples, 1)[:, None]) + 1)
    p = fdtrc(1, freedom, np.where(used, share, 0).max(axis=1) / variance) * np.maximum(samples, 1)
    step = p < LAW.alarms / 2
    return (wide | step) & (samples >= 2 * law.shape[-1])


def gravity_tried(signal: Displacements) -> Column:
    """The gravity that is tried besides the declared one, m/s²: a drop's, or none."""
    return np.where(signal.gravity == 0, STANDARD_GRAVITY, 0.0)


def another_gravity(signal: Displacements, used: Mask, recorded: PulseAndRests) -> Mask:
    """Where a drop was declared as none, or none as a drop.

    A spring and damper's force over mass is linear in the motion that the recording gives once gravity is
    known,

        d = a (v + e t) + b (x + e t^2 / 2) + (a + b t) dV + b V dc,  a = C / M, b = K / M,

    v and x being those under the declared gravity g, e what gravity is more than that, t the time since
    contact, and dV and dc errors of velocity and contact time, of the sizes that are usual. Two values of
    e are tried: 0, and that of a drop taken for none or of none taken for a drop. The other is found
    where it explains the trace far better and leaves noise alone, which another law of tissue is not
    likely to do with that one number.

    Args:
        signal: until the tissue no longer pushes, under the declared gravity.
        used: [impact, sample], the samples to ask.
        recorded: the noise.
    """
    change = gravity_tried(signal) - signal.gravity
    peak = np.where(used, signal.deceleration, 0).max(axis=1)
    variance = recorded.sd**2 + (LAW.misfit * peak) ** 2
    declared, changed = (_sum_of_squares(signal, used, variance, by) for by in (0 * change, change))
    count = np.maximum(used.sum(axis=1) - 2, 1)
    well = chance(changed, count, recorded.freedom) > LAW.noise_alone
    return (used.sum(axis=1) >= LAW.fewest) & well & (declared - changed > LAW.gain)


def _sum_of_squares(signal: Displacements, used: Mask, variance: Column, change: Column) -> Column:
    """The least sum of squares in units of the variance, that of the errors in theirs included."""
    time = signal.since_contact_s[:, : used.shape[1]]
    v = signal.v + change[:, None] * time
    x = signal.x + change[:, None] * time**2 / 2
    a, b = np.maximum(_fitted(np.stack([v, x], axis=-1), signal.deceleration, used)[0], 0).T
    errors = (a[:, None] + b[:, None] * time) * LAW.velocity * signal.velocity[:, None]
    late = (b * signal.velocity * signal.dt / np.sqrt(12))[:, None] + np.zeros_like(time)
    terms = np.stack([v, x, errors, late], axis=-1)
    target = signal.deceleration / np.sqrt(variance)[:, None]
    terms = terms / np.sqrt(variance)[:, None, None]
    weights, residual = _fitted(terms, target, used, np.array([0.0, 0.0, 1.0, 1.0]))
    return (residual**2).sum(axis=1) + (weights[:, 2:] ** 2).sum(axis=1)


def suspected(signal: Displacements) -> Suspected:
    """Ask every recording for a low-pass of 20 Hz to a quarter of the sampling rate.

    Args:
        signal: decelerations from contact to zero velocity.
    """
    used = signal.inside
    peak = np.where(used, signal.deceleration, 0).max(axis=1)
    with np.errstate(all="ignore"):
        candidates = laws(*motion(signal), used)
        left = (_fitted(law, signal.deceleration, used, ridge=1e-10)[1] for law in candidates)
        plain = np.min([(residual**2).sum(axis=1) for residual in left], axis=0)
    variance = signal.quiet.noise_sd**2 + (LAW.misfit * peak) ** 2
    freedom = np.maximum(PULSE.worth * signal.n_samples, 1)
    count = np.maximum(signal.n_samples - 4, 1)
    odd = chance(plain / variance, count, freedom) < SAMPLES.alarms
    columns = np.full((len(peak), 3), np.nan)
    # A filter is tried on even times.
    tried = odd & (signal.n_samples >= 12) & (signal.before.n_samples >= 4)
    tried &= ~(signal.uneven | signal.limited)
    for row in np.flatnonzero(tried):
        columns[row] = _explanation(signal, int(row), plain[row], variance[row], freedom[row])
    return Suspected(*columns.T)


def _explanation(
    signal: Displacements, row: int, plain: float, variance: float, freedom: float
) -> tuple[float, float, float]:
    """Corner and changes of K and C of one impact; NaN where no filter explains it better than a law."""
    dt, velocity, n = signal.dt[row], signal.velocity[row], signal.n_samples[row]
    gravity = signal.gravity[row]
    early = min(int(signal.before.n_samples[row]), BEFORE)
    y = np.concatenate([signal.before.value[row, BEFORE - early :], signal.deceleration[row, :n]])
    time = (np.arange(len(y)) - early) * dt
    lost = trapezoids(y, dt)
    twice = trapezoids(lost, dt)
    lowest = max(20.0, 1 / (signal.dt[row] * n))
    best: tuple[float, float, np.ndarray] = (np.inf, np.nan, np.zeros(2))
    for corner in np.geomspace(lowest, max(0.25 / dt, 1.01 * lowest), LAW.corners):
        moments = np.linspace(-2.5 / (2 * np.pi * corner) - 3 * dt, dt, LAW.moments)
        moments = moments[moments > time[0]]
        step, ramp = answers(LowPassFilter(low_pass_hz=corner), time - moments[:, None])
        gained = velocity * step + gravity * ramp, velocity * ramp + gravity * trapezoids(ramp, dt)
        terms = np.stack([gained[0] - lost, gained[1] - twice], axis=-1)
        coefficients, residual = _fitted(terms, y + 0 * ramp, np.ones_like(ramp, bool))
        squares = (residual**2).sum(axis=1)
        tried = int(np.argmin(squares))
        if squares[tried] < best[0]:
            best = (float(squares[tried]), float(corner), coefficients[tried])
    square, corner, (a, b) = best
    # The law was fitted from the first sample in contact on.
    number = len(y) - 4
    well = chance(square / variance, number, freedom) > LAW.noise_alone
    better = plain - square + early * variance > LAW.gain * variance
    inside = lowest * 1.01 < corner < 0.24 / dt
    if not (well and better and inside and a > 0 and b > 0):
        return np.nan, np.nan, np.nan
    a_plain, b_plain = _without_filter(signal, row, float(a), float(b))
    return corner, b_plain / float(b) - 1, a_plain / float(a) - 1


def _without_filter(signal: Displacements, row: int, a: float, b: float) -> tuple[float, float]:
    """The a and b nearest to the samples of an impact behind no filter, as a fit has them."""
    from scipy.optimize import least_squares

    n, velocity, gravity = signal.n_samples[row], signal.velocity[row], signal.gravity[row]
    time, y = np.arange(n) * signal.dt[row], signal.deceleration[row, :n]
    reach = np.sqrt(3) * signal.contact.bracket_sd[row] + 1e-12

    def residuals(logs: np.ndarray) -> np.ndarray:
        return deceleration(logs, time, velocity, gravity) - y

    start, reaches = np.array([np.log(a), np.log(b), signal.contact.bracket_s[row]]), [np.inf, np.inf, reach]
    bounds = start - reaches, start + reaches
    solution = least_squares(residuals, start, bounds=bounds, x_scale=[1, 1, reach])
    return float(np.exp(solution.x[0])), float(np.exp(solution.x[1]))


def _fitted(
    terms: LawTerms, target: Rows, used: Mask, precision: np.ndarray | float = 0.0, ridge: float = 1e-12
) -> tuple[Float[np.ndarray, "impact term"], Rows]:
    """Least squares over the ``used`` samples, with a normal prior of each coefficient about 0.

    Returns:
        The coefficients, and what they leave of the target; 0 outside ``used``.
    """
    terms = np.where(used[..., None], terms, 0.0)
    gram = np.einsum("isk,isl->ikl", terms, terms) + np.diag(np.broadcast_to(precision, terms.shape[-1]))
    scale = np.sqrt(np.maximum(np.einsum("ikk->ik", gram), 1e-300))
    gram = gram / scale[:, :, None] / scale[:, None, :] + ridge * np.eye(terms.shape[-1])
    moment = np.einsum("isk,is->ik", terms, np.where(used, target, 0.0)) / scale
    coefficients = np.linalg.solve(gram, moment[..., None])[..., 0] / scale
    return coefficients, np.where(used, target - np.einsum("isk,ik->is", terms, coefficients), 0.0)
