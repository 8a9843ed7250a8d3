"""A dataset's way from a recording to K and C, for whole batches: the same functions as its own estimates."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayestissue.inference.points.estimates import default_options
from bayestissue.inference.points.fit import PointFit, fit_points
from bayestissue.oscillator import spring_damper
from bayestissue.signal import Displacements, integrated
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.traces import Recordings
from bayestissue.thesis.causes.design import Design, Recorder
from bayestissue.thesis.causes.draws import Truth
from bayestissue.thesis.causes.pipeline import damped_by_theta1
from bayestissue.thesis.causes.recording import decelerations, recorded
from bayestissue.thesis.causes.specification import Cause

type Column = Float[np.ndarray, " impact"]


def estimated_from_recordings(
    truth: Truth, cause: Cause, design: Design, recorder: Recorder, random: np.random.Generator
) -> tuple[Column, Column]:
    """K and C of all impacts of a batch, NaN where there is no estimate.

    Recordings with a quiet part before contact go through `signal.integrated` and `fit_points`, as those of
    the dataset do in `inference.estimates`; contact and offset are found, not given.
    """
    count, impacts = truth.velocity.shape
    mass, velocity, dt = (np.tile(v, count) for v in (design.mass, design.velocity, recorder.dt))
    recordings, lost = _recordings(truth, recorder, mass, dt, random)
    windowed = cause.mechanism in ("fixed window", "own time")
    options = default_options(recorder.method).model_copy(
        update={"equilibrium": "rest", "window": "rebound" if windowed else "peak"}
    )
    signal = integrated(recordings, mass, velocity, options)
    n = signal.n_samples
    if windowed:
        length = np.repeat(truth.strength["window_over_time_to_peak"], impacts)
        if cause.mechanism == "fixed window":
            wanted = length * np.repeat(truth.time_to_peak, impacts) / dt
        else:
            by_eye = np.repeat(truth.strength["window_sd"], impacts) * random.standard_normal(len(dt))
            wanted = length * np.exp(by_eye) * (signal.time_to_peak - signal.first_sample_s) / dt
        n = np.minimum(np.round(wanted).astype(int) + 1, n)
    about_rest = cause.mechanism in ("none", "conversion")
    fit, known = _fitted(signal, n, "exact" if about_rest else recorder.method)
    K, C = fit.K, fit.C
    if cause.mechanism == "own time":
        factor = n * dt / np.repeat(truth.time_to_peak, impacts)
        K, C = K * factor**2, C * factor
    if cause.mechanism == "conversion":
        K, C = _converted_by_theta1(fit, dt, mass)
    known &= (K > 0) & (C > 0) & ~lost
    return np.where(known, K, np.nan), np.where(known, C, np.nan)


def _recordings(
    truth: Truth, recorder: Recorder, mass: Column, dt: Column, random: np.random.Generator
) -> tuple[Recordings, np.ndarray]:
    """What the recorder gives, and which impacts could not be followed; these are recorded as noise."""
    impacts = truth.velocity.shape[1]
    parameters = {name: value.ravel() for name, value in truth.parameters.items()}
    phase = random.uniform(size=len(mass)) * dt
    samples = recorder.samples
    d = decelerations(truth.element, parameters, mass, truth.velocity.ravel(), phase, dt, samples)
    d = jnp.pad(d, ((0, 0), (recorder.quiet, 0)))
    offset = np.repeat(truth.offset_sd, impacts) * random.standard_normal(len(mass))
    noise = np.repeat(truth.noise, impacts)[:, None] * random.standard_normal(d.shape)
    value = np.asarray(recorded(d, np.repeat(truth.gain, impacts), offset, noise))
    lost = ~np.isfinite(value).all(axis=1)
    value = np.where(lost[:, None], noise, value)
    return Recordings(value, np.full(len(mass), d.shape[1]), -recorder.quiet * dt, dt), lost


def _fitted(signal: Displacements, n: np.ndarray, method: str) -> tuple[PointFit, np.ndarray]:
    known = n >= FEWEST_SAMPLES
    x = np.pad(signal.x, ((0, 0), (0, max(0, FEWEST_SAMPLES - signal.x.shape[1]))))
    given = (x, np.maximum(n, FEWEST_SAMPLES), signal.dt, signal.mass)
    return fit_points(*given, method, repeated=True), known  # type: ignore[arg-type]


def _converted_by_theta1(fit: PointFit, dt: Column, mass: Column) -> tuple[Column, Column]:
    c1, c2 = jnp.asarray(2 - fit.phi1), jnp.asarray((1 - fit.phi1) - fit.phi2)
    w, zeta = jnp.asarray(fit.omega_n * dt), jnp.asarray(fit.zeta)
    w, zeta = damped_by_theta1(c1, c2, jnp.asarray(fit.theta1), w, zeta, jnp.ones_like(w))
    K, C = spring_damper(w / dt, zeta, mass)
    return np.asarray(K), np.asarray(C)
