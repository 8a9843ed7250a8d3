"""Whether a recorder's noise went through its low-pass: what the quiet parts before contact say.

Noise of variance sigma^2 is white to the share f, what entered behind the filter, and else as correlated as
the filter makes it: its covariance is sigma^2 (f 1 + (1 - f) R), R_st = r(|s - t| dt).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.linalg import toeplitz

from bayestissue.dataset.model import Dataset
from bayestissue.dataset.settings import LowPassFilter
from bayestissue.signal.displacement import Displacements
from bayestissue.signal.filters import ahead_s, autocorrelation
from bayestissue.signal.settings import FILTER

_SHARES = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 61)])


def white_share(dataset: Dataset, signal: Displacements) -> float:
    """The share f of a recorder's noise that did not go through its filter, 0 to 1.

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
    first = signal.contact_time_s + signal.first_sample_s
    end = first - signal.reach_s - ahead_s(recorder, signal.dt)
    rows = np.flatnonzero(np.isfinite(signal.offset_sd))
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
