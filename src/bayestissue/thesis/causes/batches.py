"""Batches of campaigns of one cause, from their draws to their statistics, by any number of processes.

Decelerations become K and C by the thesis's chain, or as those of a dataset do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Float, Int

from bayestissue.inference.execution.chunks import Progress, silent
from bayestissue.inference.execution.workers import computed
from bayestissue.inference.points.estimates import default_options
from bayestissue.inference.points.fit import fit_points
from bayestissue.inference.points.profile import fit_conditional
from bayestissue.likelihood.transforms import SineTransforms
from bayestissue.oscillator import from_differences, spring_damper
from bayestissue.results import whole_file
from bayestissue.signal import integrated
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.traces import Recordings
from bayestissue.thesis.causes.campaigns import Truth, decelerations, draw_truth, recorded
from bayestissue.thesis.causes.design import Design, Recorder, campaign_statistics
from bayestissue.thesis.causes.specification import Cause, CausesSpecification

# A recording goes on to this many times the typical time to peak.
REACH = 3.2
# Impacts that are fitted in one call, and samples of the narrowest window that is compiled for.
_TOGETHER, _NARROWEST = 500, 64


@dataclass(frozen=True)
class Batch:
    """What determines a batch's numbers, whoever computes it.

    Attributes:
        design: of every campaign.
        specification: of the priors.
        cause: its name.
        number: of the batch among those of its cause, from 0.
        seed: of the whole run.
    """

    design: Design
    specification: CausesSpecification
    cause: str
    number: int
    seed: int

    @property
    def name(self) -> str:
        """A name of its own among the batches of a run."""
        return f"{self.cause}-{self.number:05d}"


def batches(design: Design, specification: CausesSpecification, seed: int) -> list[Batch]:
    """All batches of a run, those of the causes in turn."""
    count = -(-specification.campaigns.each // specification.campaigns.batch)
    return [
        Batch(design, specification, cause, number, seed)
        for number in range(count)
        for cause in specification.causes
    ]


def run_batch(batch: Batch) -> pd.DataFrame:
    """The strengths and statistics of a batch's campaigns, one row each, estimated as the data's own were.

    The numbers depend on the batch alone: its random stream is that of seed, cause and number.
    """
    cause, size = batch.specification.causes[batch.cause], batch.specification.campaigns
    design, recorder = batch.design, batch.design.recorder
    remaining = size.each - batch.number * size.batch
    stream = [batch.seed, batch.number, *batch.cause.encode()]
    random = np.random.default_rng(np.random.SeedSequence(stream))
    truth = draw_truth(cause, batch.specification, design, random, size.batch)
    if recorder is not None:
        K, C = estimated_from_recordings(truth, cause, design, recorder, random)
    else:
        samples = int(np.ceil(REACH * batch.specification.recording.samples_to_peak.high))
        K, C, _ = _estimated_as_published(truth, cause, design, samples, random)
    shape = (size.batch, len(design.mass))
    table = pd.DataFrame(
        {
            "cause": batch.cause,
            "batch": batch.number,
            "campaign": np.arange(size.batch),
            **{f"strength_{name}": value for name, value in truth.strength.items()},
            **campaign_statistics(K.reshape(shape), C.reshape(shape), design),
        }
    )
    return table.iloc[: min(remaining, size.batch)]


def _estimated_as_published(
    truth: Truth, cause: Cause, design: Design, samples: int, random: np.random.Generator
) -> Estimates:
    """Record so many samples and estimate every impact as the thesis did, but for what the cause changes."""
    count, impacts = truth.velocity.shape

    def flat(values: np.ndarray) -> np.ndarray:
        return np.broadcast_to(values, (count, impacts)).ravel()

    mass, dt = flat(design.mass), flat(truth.dt[:, None])
    d, _ = _recordings(truth, mass, dt, samples, 0, random)
    length = truth.strength.get("window_over_time_to_peak", np.zeros(count))
    own_time = cause.mechanism == "own time"
    window = np.round(length * truth.samples_to_peak)
    by_eye = np.exp(
        truth.strength.get("window_sd", np.zeros(count))[:, None] * random.standard_normal((count, impacts))
    )
    about_rest = cause.mechanism in ("none", "conversion")
    treatment = Treatment(
        dt=dt,
        velocity=flat(design.velocity),
        mass=mass,
        window=flat(np.array(0.0) if own_time else window[:, None]),
        share=flat(length[:, None] * by_eye if own_time else np.array(1.0)),
        centred=flat(np.array(0.0 if about_rest else 1.0)),
        nominal=flat(own_time * truth.time_to_peak[:, None]),
        by_theta1=flat(np.array(float(cause.mechanism == "conversion"))),
    )
    return thesis_estimates(d, treatment)


def run_batches(
    batches: Sequence[Batch],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    folder: Path | None = None,
    progress: Progress = silent,
) -> list[pd.DataFrame]:
    """The tables of all batches, in their order.

    Args:
        batches: what to compute.
        jobs: worker processes on this machine; 1 computes in this process.
        scheduler: address of a Dask scheduler that is to compute instead, such as ``tcp://host:8786``.
        folder: an existing folder to which finished batches are written, and where those of an earlier run of
            the same job are looked for.
        progress: told after every batch how many are done, and of how many.

    Raises:
        InputError: Dask is not installed, or the scheduler doesn't answer.
        RuntimeError: workers die again and again.
    """
    done = {batch.name: table for batch in batches if (table := _read(folder, batch)) is not None}
    left = [batch for batch in batches if batch.name not in done]
    progress(len(done), len(batches))
    for index, table in computed(run_batch, left, jobs=jobs, scheduler=scheduler):
        batch = left[index]
        done[batch.name] = table
        if folder is not None:
            with whole_file(folder / f"{batch.name}.parquet") as staging:
                table.to_parquet(staging)
        progress(len(done), len(batches))
    return [done[batch.name] for batch in batches]


def _read(folder: Path | None, batch: Batch) -> pd.DataFrame | None:
    path = None if folder is None else folder / f"{batch.name}.parquet"
    return pd.read_parquet(path) if path is not None and path.is_file() else None


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

    dt: Float[Any, " impact"]
    velocity: Float[Any, " impact"]
    mass: Float[Any, " impact"]
    window: Float[Any, " impact"]
    share: Float[Any, " impact"]
    centred: Float[Any, " impact"]
    nominal: Float[Any, " impact"]
    by_theta1: Float[Any, " impact"]


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
        # The next power of two, so that few widths are ever compiled.
        width = max(_NARROWEST, 1 << int(n[rows].max() - 1).bit_length())
        choices = Treatment(*(part[rows] for part in columns))
        K[rows], C[rows] = map(np.asarray, _fitted(x[rows, :width], n[rows], choices))
    return Estimates(K, C, n)


@jax.jit
def _windowed(deceleration: Array, treatment: Treatment) -> tuple[Array, Array]:
    """Deviations from the mean, or displacements, over each window, and its number of samples."""
    choices = Treatment(*(jnp.asarray(part, float) for part in treatment))
    dt = choices.dt[:, None]
    v = choices.velocity[:, None] - _integral(deceleration, dt)
    x = _integral(v, dt)
    sample = jnp.arange(deceleration.shape[1])
    passed = v <= 0
    stop = jnp.where(passed.any(axis=1), jnp.argmax(passed, axis=1), deceleration.shape[1])
    n = jnp.where(choices.window > 0, choices.window, jnp.round(stop * choices.share))
    n = jnp.minimum(n, deceleration.shape[1])
    used = jnp.maximum(n, FEWEST_SAMPLES)
    inside = sample < used[:, None]
    mean = jnp.where(inside, x, 0).sum(axis=1) / used
    return jnp.where(inside, x - (choices.centred * mean)[:, None], 0), n.astype(int)


@jax.jit
def _fitted(x: Array, n: Array, treatment: Treatment) -> tuple[Array, Array]:
    used = jnp.maximum(n, FEWEST_SAMPLES).astype(float)
    fit, _ = fit_conditional(SineTransforms(x, (), jnp.zeros(()), used - 2.0))
    w, zeta = from_differences(fit.c1, fit.c2, None, 1.0)
    w, zeta = damped_by_theta1(fit.c1, fit.c2, fit.theta1, w, zeta, treatment.by_theta1)
    interval = jnp.where(treatment.nominal > 0, treatment.nominal / used, treatment.dt)
    K, C = spring_damper(w / interval, zeta, treatment.mass)
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
    d, noise = _recordings(truth, mass, dt, recorder.samples, recorder.quiet, random)
    # What could not be followed is recorded as noise.
    lost = ~np.isfinite(np.asarray(d)).all(axis=1)
    value = np.where(lost[:, None], noise, np.asarray(d))
    recordings = Recordings(value, np.full(len(mass), value.shape[1]), -recorder.quiet * dt, dt)
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
    known = n >= FEWEST_SAMPLES
    x = np.pad(signal.x, ((0, 0), (0, max(0, FEWEST_SAMPLES - signal.x.shape[1]))))
    used, method = np.maximum(n, FEWEST_SAMPLES), "exact" if about_rest else recorder.method
    fit = fit_points(x, used, signal.dt, signal.mass, method, repeated=True)
    K, C = fit.K, fit.C
    if cause.mechanism == "own time":
        factor = n * dt / np.repeat(truth.time_to_peak, impacts)
        K, C = K * factor**2, C * factor
    if cause.mechanism == "conversion":
        c1, c2, theta1 = (jnp.asarray(v) for v in (2 - fit.phi1, (1 - fit.phi1) - fit.phi2, fit.theta1))
        w, zeta = jnp.asarray(fit.omega_n * dt), jnp.asarray(fit.zeta)
        w, zeta = damped_by_theta1(c1, c2, theta1, w, zeta, jnp.ones_like(w))
        K, C = map(np.asarray, spring_damper(w / dt, zeta, mass))
    known &= (K > 0) & (C > 0) & ~lost
    return np.where(known, K, np.nan), np.where(known, C, np.nan)


def _recordings(
    truth: Truth, mass: Column, dt: Column, samples: int, quiet: int, random: np.random.Generator
) -> tuple[Array, np.ndarray]:
    """What the recorder gives of so many samples from contact on, ``quiet`` ones before it, and its noise."""
    impacts = truth.velocity.shape[1]
    parameters = {name: value.ravel() for name, value in truth.parameters.items()}
    phase = random.uniform(size=len(mass)) * dt
    d = decelerations(truth.element, parameters, mass, truth.velocity.ravel(), phase, dt, samples)
    d = jnp.pad(d, ((0, 0), (quiet, 0)))
    offset = np.repeat(truth.offset_sd, impacts) * random.standard_normal(len(mass))
    noise = np.repeat(truth.noise, impacts)[:, None] * random.standard_normal(d.shape)
    return recorded(d, np.repeat(truth.gain, impacts), offset, noise), noise
