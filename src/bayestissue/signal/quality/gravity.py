"""Gravity along the motion that was not declared, or was and is not there.

A spring and damper's force over mass is linear in the motion that the recording gives once gravity is known,

    d = a (v + e t) + b (x + e t^2 / 2) + (a + b t) dV + b V dc,  a = C / M, b = K / M,

v and x being those under the declared gravity g, e what gravity is more than that, t the time since contact,
and dV and dc errors of velocity and contact time, of the sizes that are usual. Two values of e are tried: 0,
and that of a drop taken for none or of none taken for a drop. The other is found where it explains the trace
far better and leaves noise alone, which another law of tissue is not likely to do with that one number.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from bayestissue.dataset.model import STANDARD_GRAVITY
from bayestissue.signal.displacement import Displacements
from bayestissue.signal.quality import law
from bayestissue.signal.traces import Column, Mask, Rows

# Of the velocity: of errors that are nobody's mistake.
_VELOCITY = 0.02
# What the other gravity gains, in the noise's variance: e^(-this / 2) of the likelihood.
_GAIN = 30.0
# Noise alone where chance leaves as much in one of a hundred.
_WELL = 0.01
_FEWEST = 16


def tried(signal: Displacements) -> Column:
    """The gravity that is tried besides the declared one, m/s²: a drop's, or none."""
    return np.where(signal.gravity == 0, STANDARD_GRAVITY, 0.0)


def another(signal: Displacements, used: Mask, sd: Column, freedom: Column) -> Mask:
    """Where a drop was declared as none, or none as a drop.

    Args:
        signal: until the tissue no longer pushes, under the declared gravity.
        used: [impact, sample], the samples to ask.
        sd: standard deviation of the noise, m/s².
        freedom: degrees of freedom of that, about.
    """
    change = tried(signal) - signal.gravity
    peak = np.where(used, signal.deceleration, 0).max(axis=1)
    variance = sd**2 + (law.MISFIT * peak) ** 2
    declared, changed = (_left(signal, used, variance, added) for added in (np.zeros_like(change), change))
    count = np.maximum(used.sum(axis=1) - 2, 1)
    well = fdtrc(count, freedom, changed / count) > _WELL
    return (used.sum(axis=1) >= _FEWEST) & well & (declared - changed > _GAIN)


def _left(signal: Displacements, used: Mask, variance: Column, change: Column) -> Column:
    """The least sum of squares in units of the variance, that of the errors in theirs included."""
    time = signal.first_sample_s[:, None] + np.arange(used.shape[1]) * signal.dt[:, None]
    v = signal.v + change[:, None] * time
    x = signal.x + signal.equilibrium[:, None] + change[:, None] * time**2 / 2
    a, b = np.maximum(_solved(np.stack([v, x], axis=-1), signal.deceleration, used, np.zeros(2)), 0).T
    errors = (a[:, None] + b[:, None] * time) * _VELOCITY * signal.velocity[:, None]
    late = (b * signal.velocity * signal.dt / np.sqrt(12))[:, None] + np.zeros_like(time)
    terms = np.stack([v, x, errors, late], axis=-1)
    target = signal.deceleration / np.sqrt(variance)[:, None]
    terms = terms / np.sqrt(variance)[:, None, None]
    weights = _solved(terms, target, used, np.array([0.0, 0.0, 1.0, 1.0]))
    residual = np.where(used, target - np.einsum("isk,ik->is", terms, weights), 0.0)
    return (residual**2).sum(axis=1) + (weights[:, 2:] ** 2).sum(axis=1)


def _solved(terms: law.Law, target: Rows, used: Mask, precision: np.ndarray) -> np.ndarray:
    """Least squares with a normal prior of each coefficient about 0."""
    terms = np.where(used[..., None], terms, 0.0)
    gram = np.einsum("isk,isl->ikl", terms, terms) + np.diag(precision)
    scale = np.sqrt(np.maximum(np.einsum("ikk->ik", gram), 1e-300))
    gram = gram / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(terms.shape[-1])
    moment = np.einsum("isk,is->ik", terms, np.where(used, target, 0.0)) / scale
    return np.linalg.solve(gram, moment[..., None])[..., 0] / scale
