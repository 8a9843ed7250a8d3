"""Low-pass filters of recorders, as poles of a continuous filter or sections of a digital one."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Num

from bayestissue.dataset.settings import LowPassFilter
from bayestissue.signal.settings import FILTER
from bayestissue.signal.traces import Column, Rows


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
    others = [poles[np.argsort(np.abs(poles - pole))[1:]] for pole in upper]
    weights = np.array(
        [gain / np.prod(pole - others_of_pole) for pole, others_of_pole in zip(upper, others, strict=True)]
    )
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
