"""Low-pass filters of recorders, as poles or as sections of a digital one, and the noise behind them."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Complex, Float, Num
from scipy.linalg import toeplitz

from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.padded_traces import Column, Rows
from bayestissue.recordings.signal.signal_settings import FILTER

if TYPE_CHECKING:
    from bayestissue.recordings.dataset.model import Dataset
    from bayestissue.recordings.signal.displacement import Displacements


_SHARES = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 61)])


def on_even_grid(values: Rows, rate: float, recorder: LowPassFilter) -> Rows:
    """The values as the recorder's filter passes them, from rest before the first sample.

    Args:
        values: [impact, sample], sampled much faster than the filter's corner and 0 at both ends for longer
            than it rings.
        rate: of the samples, Hz.
        recorder: the filter.
    """
    from scipy.signal import sosfilt

    sections = _design(recorder, fs=rate, output="sos")
    once = sosfilt(sections, values, axis=1)
    return sosfilt(sections, once[:, ::-1], axis=1)[:, ::-1] if recorder.zero_phase else once


def modes(recorder: LowPassFilter) -> tuple[Complex[np.ndarray, " mode"], Complex[np.ndarray, " mode"]]:
    """Poles p_k [rad/s] and weights c_k of the filter's answer to an impulse, Re sum_k c_k e^(p_k t).

    Of two complex conjugate poles one is there, with twice its weight. Run forwards and backwards, the
    answer is Re sum_k c_k e^(p_k |t|) with c_k H(-p_k) for c_k, H being the transfer function.
    """
    _, poles, gain = _design(recorder, analog=True, output="zpk")
    # Alike but for rounding in pairs: the upper one, and those on the real axis.
    upper = poles[poles.imag >= -1e-9 * np.abs(poles)]
    from_others = [pole - poles[np.argsort(np.abs(poles - pole))[1:]] for pole in upper]
    weights = gain / np.prod(from_others, axis=1)
    weights = np.where(upper.imag > 1e-9 * np.abs(upper), 2.0, 1.0) * weights
    if recorder.zero_phase:
        weights = weights * gain / np.prod(-upper[:, None] - poles, axis=1)
    return upper, weights


def autocorrelation(
    recorder: LowPassFilter, lag: Num[np.ndarray, "*lags"], dt: float
) -> Float[np.ndarray, "*lags"]:
    """Of white noise that went through the filter, 1 at a lag of 0.

    Of a digital filter the transform of its spectrum. Of an analog one that is run once, r(t) = h * h(-t) is
    the filter's answer forwards and backwards. Run twice, it is r * r with all poles p_j and weights b_j of
    r: sum_jk b_j b_k (e^(p_j t) - e^(p_k t)) / (p_j - p_k) - (e^(p_j t) + e^(p_k t)) / (p_j + p_k) for
    t >= 0, the first t e^(p_j t) for alike poles.

    Args:
        recorder: the filter.
        lag: in sampling intervals, whole numbers of a digital filter.
        dt: the sampling interval, s.
    """
    if recorder.digital:
        return _of_samples(recorder, np.abs(lag), dt)
    upper, weights = modes(recorder.model_copy(update={"zero_phase": True}))
    time = dt * np.abs(lag)[..., None, None]
    if not recorder.zero_phase:
        correlation = (weights * np.exp(upper * time[..., 0])).sum(-1).real
        return correlation / weights.sum().real
    alone = np.abs(upper.imag) <= 1e-9 * np.abs(upper)
    paired = upper[~alone], weights[~alone] / 2
    poles, share = (
        np.concatenate([part[alone], pair, pair.conj()])
        for part, pair in zip((upper, weights), paired, strict=True)
    )
    first, second = poles[:, None], poles
    first_grown, second_grown = np.exp(first * time), np.exp(second * time)
    diagonal = np.eye(len(poles), dtype=bool)
    apart = np.where(diagonal, 1.0, first - second)
    middle = np.where(diagonal, time * first_grown, (first_grown - second_grown) / apart)
    parts = share[:, None] * share * (middle - (first_grown + second_grown) / (first + second))
    at_zero = share[:, None] * share * (-2 / (first + second))
    return parts.sum((-2, -1)).real / at_zero.sum().real


def _of_samples(recorder: LowPassFilter, lag: np.ndarray, dt: float) -> np.ndarray:
    """Over a circle that is long enough for the correlations to die away."""
    from scipy.signal import sosfreqz

    length = 2 << int(lag.max() + FILTER.at_rest / (dt * decay(recorder, dt))).bit_length()
    _, response = sosfreqz(_design(recorder, fs=1 / dt, output="sos"), 2 * np.pi * np.fft.rfftfreq(length))
    covariances = np.fft.irfft(np.abs(response) ** (4 if recorder.zero_phase else 2), length)
    return covariances[lag] / covariances[0]


def answers(
    recorder: LowPassFilter, since: Float[np.ndarray, "*time"]
) -> tuple[Float[np.ndarray, "*time"], Float[np.ndarray, "*time"]]:
    """The filter's answers to a unit step and to a unit ramp that began so long ago [s], run forwards."""
    poles, weights = modes(recorder)
    late = np.maximum(since, 0.0)[..., None]
    grown = np.expm1(poles * late) / poles
    return (weights * grown).sum(-1).real, (weights / poles * (grown - late)).sum(-1).real


def decay(recorder: LowPassFilter, dt: Float[np.ndarray, "*dt"] | float) -> Float[np.ndarray, "*dt"]:
    """How fast the slowest part of the filter's answer dies away, 1/s.

    Args:
        recorder: the filter.
        dt: the sampling interval that a digital one has, s.
    """
    poles, _ = modes(recorder)
    dt = np.asarray(dt)
    if not recorder.digital:
        return np.abs(poles.real).min() + np.zeros(dt.shape)
    corner = 2 * np.pi * recorder.low_pass_hz
    q = poles * (np.tan(corner * dt / 2) / corner)[..., None]
    # Of one pole at a quarter of the sampling rate nothing is left after a sample.
    return -np.log(np.maximum(np.abs((1 + q) / (1 - q)).max(-1), FILTER.left_out)) / dt


def ahead_s(recorder: LowPassFilter | None, dt: Column) -> Column:
    """How long before contact a filter that is run backwards too answers, s, to a thousandth; else 0."""
    if recorder is None or not recorder.zero_phase:
        return np.zeros_like(dt)
    return -np.log(FILTER.left_out) / decay(recorder, dt)


def delay(recorder: LowPassFilter) -> float:
    """When the filter's answer to a step passes a half, s; 0 run forwards and backwards."""
    if recorder.zero_phase:
        return 0.0
    time = np.linspace(0.0, 4 * recorder.order / (2 * np.pi * recorder.low_pass_hz), 401)
    step, _ = answers(recorder, time)
    return float(np.interp(0.5, np.maximum.accumulate(step), time))


def _design(recorder: LowPassFilter, **how: Any) -> Any:
    """By scipy.signal, as poles and zeros of a continuous filter or as sections of a digital one."""
    from scipy.signal import bessel, butter

    corner = recorder.low_pass_hz * (2 * np.pi if how.get("analog") else 1.0)
    if recorder.kind == "butterworth":
        return butter(recorder.order, corner, **how)
    return bessel(recorder.order, corner, norm="mag", **how)


def white_share(dataset: Dataset, signal: Displacements) -> float:
    """The share f of a recorder's noise that did not go through its filter, 0 to 1: what the quiet parts say.

    Noise of variance sigma^2 is white to the share f, what entered behind the filter, and else as correlated
    as the filter makes it: its covariance is sigma^2 (f 1 + (1 - f) R), R_st = r(|s - t| dt).

    By what was declared: none of noise before the filter, all of noise behind it. Else by maximum
    likelihood, one f for all impacts and for each its own sigma and mean, from as much of the quiet parts as
    lies before any answer of the filter. Without quiet parts, noise is taken to have come before a filter
    that software ran over the samples, and behind any other.

    Args:
        dataset: recordings behind a declared filter.
        signal: what was made of them.
    """
    recorder = dataset.recorder
    if recorder is None or recorder.noise == "after":
        return 1.0
    if recorder.noise == "before":
        return 0.0
    parts = _quiet_parts(dataset, signal, recorder)
    if sum(len(part) for part, _ in parts) < FILTER.fewest:
        return 0.0 if recorder.digital or recorder.zero_phase else 1.0
    same = cache(lambda length, dt: _spectrum(recorder, length, dt))
    log_likelihood = sum(_profile(part, *same(len(part), dt)) for part, dt in parts)
    share = float(_SHARES[int(np.argmax(log_likelihood))])
    return 1.0 if share >= FILTER.all_white else share


def _quiet_parts(
    dataset: Dataset, signal: Displacements, recorder: LowPassFilter
) -> list[tuple[Float[np.ndarray, " sample"], float]]:
    """What was recorded before an impact could show, and the sampling interval, where that is noise."""
    first = signal.contact_time_s + signal.contact.since_s
    end = first - signal.before.reach_s - ahead_s(recorder, signal.dt)
    rows = np.flatnonzero(signal.quiet.there)
    rows = rows[np.unique(np.linspace(0, max(len(rows) - 1, 0), min(len(rows), FILTER.impacts)).astype(int))]
    parts = []
    for row in rows:
        trace = dataset.traces[row]
        quiet = np.asarray(trace.value)[: np.searchsorted(trace.time_s, end[row])]
        length = next((length for length in FILTER.lengths if length <= len(quiet)), 0)
        # What a recorder rounds to one number tells nothing.
        if length and np.ptp(quiet[-length:]) > 0:
            parts.append((quiet[-length:], float(f"{signal.dt[row]:.6g}")))
    return parts


def _spectrum(recorder: LowPassFilter, length: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and eigenvectors of R about the mean, that of the mean itself left out."""
    centred = np.eye(length) - 1 / length
    correlations = toeplitz(autocorrelation(recorder, np.arange(length), dt))
    values, vectors = np.linalg.eigh(centred @ correlations @ centred)
    mean = int(np.argmax(np.abs(vectors.sum(axis=0))))
    return np.delete(np.maximum(values, FILTER.rounding), mean), np.delete(vectors, mean, axis=1)


def _profile(part: np.ndarray, values: np.ndarray, vectors: np.ndarray) -> Float[np.ndarray, " share"]:
    """Log likelihood at each of `_SHARES`, sigma at its best."""
    along = vectors.T @ part
    variance = _SHARES[:, None] + (1 - _SHARES[:, None]) * values
    return -(len(along) * np.log((along**2 / variance).mean(axis=1)) + np.log(variance).sum(axis=1)) / 2
