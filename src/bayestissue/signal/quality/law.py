"""Whether any tissue pushes back like this: force laws fitted to the motion that the recording gives.

What a spring and damper does not give may be gravity along the motion that was not declared, or was and is
not there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from bayestissue.dataset.settings import STANDARD_GRAVITY
from bayestissue.signal.displacement import Displacements
from bayestissue.signal.integration import trapezoids
from bayestissue.signal.quality.samples import Recorded
from bayestissue.signal.settings import LAW
from bayestissue.signal.traces import Column, Mask, Rows

type Law = Float[np.ndarray, "impact sample term"]


def motion(signal: Displacements) -> tuple[Rows, Rows]:
    """Displacement and velocity from the state at the first sample and force over mass, by trapezoids."""
    number, dt = signal.sample_number, signal.dt[:, None]
    step = np.diff(number, axis=1) * dt
    lost = trapezoids(signal.deceleration - signal.gravity[:, None], step)
    x, v = signal.x[:, :1], signal.v[:, :1]
    return x + v * number * dt - trapezoids(lost, step), v - lost


def laws(x: Rows, v: Rows, used: Mask) -> Iterator[Law]:
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


def any_law(x: Rows, v: Rows, used: Mask) -> Law:
    """Terms of a law with all of these at once."""
    first, second, third = laws(x, v, used)
    product = first[..., :1] * first[..., 1:2]
    return np.concatenate([first, second[..., 2:], third[..., :2], product], axis=-1)


def residuals(law: Law, d: Rows, used: Mask) -> Float[np.ndarray, "impact sample"]:
    """What least squares leave of d; 0 outside ``used``."""
    coefficients = _coefficients(law, d, used, ridge=1e-10)
    return np.where(used, d - np.einsum("isk,ik->is", law, coefficients), 0.0)


def no_law(signal: Displacements, used: Mask, recorded: Recorded) -> Mask:
    """Where what the widest law leaves over is more than noise and the laws' own misfit."""
    d, freedom, law = signal.deceleration, recorded.freedom, any_law(*motion(signal), used)
    samples = used.sum(axis=1)
    count = np.maximum(samples - law.shape[-1], 1)
    residual = residuals(law, d, used)
    variance = recorded.sd**2 + (LAW.misfit * recorded.peak) ** 2
    wide = fdtrc(count, freedom, (residual**2).sum(axis=1) / count / variance) < LAW.alarms / 2
    # A step's own share, at the sample where it is greatest; less is left of a step than itself.
    sums, index = np.cumsum(residual[:, ::-1], axis=1)[:, ::-1], np.arange(d.shape[1])
    after = np.maximum(samples[:, None] - index, 1)
    share = sums**2 / (after * (1 - after / np.maximum(samples, 1)[:, None]) + 1)
    p = fdtrc(1, freedom, np.where(used, share, 0).max(axis=1) / variance) * np.maximum(samples, 1)
    step = p < LAW.alarms / 2
    return (wide | step) & (samples >= 2 * law.shape[-1])


def least_sum_of_squares(signal: Displacements, used: Mask) -> Column:
    """The least sum of squares that any of the laws leaves of each impact."""
    d, every = signal.deceleration, laws(*motion(signal), used)
    squares = [(residuals(law, d, used) ** 2).sum(axis=1) for law in every]
    return np.min(squares, axis=0)


def gravity_tried(signal: Displacements) -> Column:
    """The gravity that is tried besides the declared one, m/s²: a drop's, or none."""
    return np.where(signal.gravity == 0, STANDARD_GRAVITY, 0.0)


def another_gravity(signal: Displacements, used: Mask, recorded: Recorded) -> Mask:
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
    well = fdtrc(count, recorded.freedom, changed / count) > LAW.noise_alone
    return (used.sum(axis=1) >= LAW.fewest) & well & (declared - changed > LAW.gain)


def _sum_of_squares(signal: Displacements, used: Mask, variance: Column, change: Column) -> Column:
    """The least sum of squares in units of the variance, that of the errors in theirs included."""
    time = signal.since_contact_s[:, : used.shape[1]]
    v = signal.v + change[:, None] * time
    x = signal.x + change[:, None] * time**2 / 2
    a, b = np.maximum(_coefficients(np.stack([v, x], axis=-1), signal.deceleration, used), 0).T
    errors = (a[:, None] + b[:, None] * time) * LAW.velocity * signal.velocity[:, None]
    late = (b * signal.velocity * signal.dt / np.sqrt(12))[:, None] + np.zeros_like(time)
    terms = np.stack([v, x, errors, late], axis=-1)
    target = signal.deceleration / np.sqrt(variance)[:, None]
    terms = terms / np.sqrt(variance)[:, None, None]
    weights = _coefficients(terms, target, used, np.array([0.0, 0.0, 1.0, 1.0]))
    residual = np.where(used, target - np.einsum("isk,ik->is", terms, weights), 0.0)
    return (residual**2).sum(axis=1) + (weights[:, 2:] ** 2).sum(axis=1)


def _coefficients(
    terms: Law, target: Rows, used: Mask, precision: np.ndarray | float = 0.0, ridge: float = 1e-12
) -> Float[np.ndarray, "impact term"]:
    """Least squares over the ``used`` samples, with a normal prior of each coefficient about 0."""
    terms = np.where(used[..., None], terms, 0.0)
    gram = np.einsum("isk,isl->ikl", terms, terms) + np.diag(np.broadcast_to(precision, terms.shape[-1]))
    scale = np.sqrt(np.maximum(np.einsum("ikk->ik", gram), 1e-300))
    gram = gram / scale[:, :, None] / scale[:, None, :] + ridge * np.eye(terms.shape[-1])
    moment = np.einsum("isk,is->ik", terms, np.where(used, target, 0.0)) / scale
    return np.linalg.solve(gram, moment[..., None])[..., 0] / scale
