"""The thesis's way from a deceleration to K and C, for many campaigns in one compiled call."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.inference.points.conditional import fit_conditional
from bayestissue.likelihood.transforms import SineTransforms
from bayestissue.oscillator import from_differences, spring_damper
from bayestissue.signal.displacement import FEWEST_SAMPLES

_TOGETHER = 500
_NARROWEST = 64


class Treatment(NamedTuple):
    """What the analyst took for known, and which steps were taken; every attribute [impact].

    Attributes:
        dt: sampling interval, s.
        velocity: contact velocity, m/s.
        mass: kg.
        window: samples of a window fixed beforehand; 0 ends the window at zero velocity.
        share: where the window ends, as a multiple of the time to zero velocity; 1 is the thesis's.
        centred: 1 for deviations from the sample mean, 0 for displacements from rest.
        nominal: length, s, over which every window is spread; 0 leaves the recorder's own times.
        by_theta1: 1 to find the damped frequency from theta1, as section 2.11 writes it.
    """

    dt: Array
    velocity: Array
    mass: Array
    window: Array
    share: Array
    centred: Array
    nominal: Array
    by_theta1: Array


class Estimates(NamedTuple):
    """What came out, each attribute [impact]; K and C are NaN where no oscillator fits.

    Attributes:
        K, C: N/m and N s/m.
        n_samples: samples in the window.
    """

    K: Float[np.ndarray, " impact"]
    C: Float[np.ndarray, " impact"]
    n_samples: Int[np.ndarray, " impact"]


def thesis_estimates(deceleration: Float[Array, "impact sample"], treatment: Treatment) -> Estimates:
    """K and C of each impact by the thesis's chain (chapters 2 and 4), as ``estimate --method dds``.

    v(t) = V − ∫d and x(t) = ∫v by the trapezoidal rule from the first sample, which is taken for contact,
    up to zero velocity or the end of the recording; the conditional fit of an ARMA(2,1) to deviations from
    the mean; its A(2) by equal autocovariance; K = M ω_n² and C = 2 ζ ω_n M.

    The fit's cost is that of the longest window beside which an impact is fitted, so impacts are fitted
    together with others of about their length.

    Args:
        deceleration: [impact, sample], m/s².
        treatment: the analyst's choices.
    """
    x, n = (np.asarray(part) for part in _windowed(deceleration, treatment))
    order = np.argsort(n, kind="stable")
    K, C = np.empty(len(n)), np.empty(len(n))
    columns = [np.asarray(part, float) for part in treatment]
    for begin in range(0, len(order), _TOGETHER):
        # As many rows each time, so that one compilation serves all of one width.
        rows = order[np.minimum(np.arange(begin, begin + _TOGETHER), len(order) - 1)]
        width = _width(int(n[rows].max()), x.shape[1])
        found = _fitted(x[rows, :width], n[rows], Treatment(*(jnp.asarray(part[rows]) for part in columns)))
        K[rows], C[rows] = (np.asarray(part) for part in found)
    return Estimates(K, C, n)


def _width(samples: int, most: int) -> int:
    """The next power of two, so that few widths are ever compiled."""
    return min(most, max(_NARROWEST, 1 << (samples - 1).bit_length()))


@jax.jit
def _windowed(deceleration: Array, treatment: Treatment) -> tuple[Array, Array]:
    """Deviations from the mean, or displacements, over each window, and its number of samples."""
    given = Treatment(*(jnp.asarray(part, float) for part in treatment))
    dt = given.dt[:, None]
    v = given.velocity[:, None] - _integral(deceleration, dt)
    x = _integral(v, dt)
    sample = jnp.arange(deceleration.shape[1])
    passed = v <= 0
    stop = jnp.where(passed.any(axis=1), jnp.argmax(passed, axis=1), deceleration.shape[1])
    n = jnp.where(given.window > 0, given.window, jnp.round(stop * given.share))
    n = jnp.minimum(n, deceleration.shape[1])
    used = jnp.maximum(n, FEWEST_SAMPLES)
    inside = sample < used[:, None]
    mean = jnp.where(inside, x, 0).sum(axis=1) / used
    return jnp.where(inside, x - (given.centred * mean)[:, None], 0), n.astype(int)


@jax.jit
def _fitted(x: Array, n: Array, given: Treatment) -> tuple[Array, Array]:
    used = jnp.maximum(n, FEWEST_SAMPLES).astype(float)
    fit, _ = fit_conditional(SineTransforms(x, (), jnp.zeros(()), used - 2.0))
    w, zeta = from_differences(fit.c1, fit.c2, None, 1.0)
    w, zeta = damped_by_theta1(fit.c1, fit.c2, fit.theta1, w, zeta, given.by_theta1)
    interval = jnp.where(given.nominal > 0, given.nominal / used, given.dt)
    K, C = spring_damper(w / interval, zeta, given.mass)
    known = (n >= FEWEST_SAMPLES) & (K > 0) & (C > 0)
    return jnp.where(known, K, jnp.nan), jnp.where(known, C, jnp.nan)


def _integral(rows: Array, dt: Array) -> Array:
    steps = (rows[:, 1:] + rows[:, :-1]) / 2 * dt
    return jnp.concatenate([jnp.zeros_like(rows[:, :1]), jnp.cumsum(steps, axis=1)], axis=1)


def damped_by_theta1(
    c1: Array, c2: Array, theta1: Array, w: Array, zeta: Array, wanted: Array
) -> tuple[Array, Array]:
    """omega_n and zeta with the damped frequency b from the expression in theta1 + 1/theta1 (section 2.11).

    The expression solves the autocovariance's a sin(b)/b for b. For a theta1 that is that of a sampled A(2)
    it is the arccos itself. Real roots keep what they have.

    Args:
        c1: 2 - phi1.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient, as fitted.
        w: omega_n dt by the arccos.
        zeta: by the arccos.
        wanted: above 0 where the expression is to be used.
    """
    a = zeta * w
    b = w * jnp.sqrt(jnp.maximum((1 - zeta) * (1 + zeta), 0))
    r = -theta1 / (1 + theta1**2)
    phi1, one_minus_phi2 = 2 - c1, 2 - (c1 - c2)
    sine_share = jnp.exp(a) * (c1 - c2) * (phi1 / 2 + r * one_minus_phi2) / (one_minus_phi2 + 2 * r * phi1)
    printed = jnp.abs(a * jnp.sin(b) / sine_share)
    oscillates = (zeta < 1) & (wanted > 0)
    omega = jnp.sqrt(a**2 + printed**2)
    return jnp.where(oscillates, omega, w), jnp.where(oscillates, a / omega, zeta)
