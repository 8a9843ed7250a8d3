"""A recorder's low-pass and the noise that went through it, as the likelihood takes them."""

from __future__ import annotations

from functools import partial

import jax.numpy as jnp
import numpy as np

from bayestissue.model.likelihood.noise import colour_of
from bayestissue.model.likelihood.recorder import Colour, LowPass
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.signal import Displacements
from bayestissue.recordings.signal.filters import ahead_s, autocorrelation, white_share
from bayestissue.recordings.signal.filters import modes as filter_modes

# At the filter's corner over a cell of contact [rad]: a trace is then linear in the moment of contact but for
# 1 % of the force's jump at the cell's ends.
_PHASE = 0.35
# Between two samples, at the most.
_MOST_CELLS = 24


def recorded_noise(
    dataset: Dataset, signal: Displacements, rows: int
) -> tuple[Colour, np.ndarray, np.ndarray | float]:
    """The noise of traces of so many rows: see `filtered_noise`; white where none went through a filter."""
    white = white_share(dataset, signal)
    if dataset.recorder is None or white == 1:
        return Colour.white_noise(), np.zeros(len(signal.dt), int), 1.0
    return filtered_noise(dataset.recorder, white, rows, signal.dt)


def filtered_noise(
    recorder: LowPassFilter, white: float, rows: int, dt: np.ndarray
) -> tuple[Colour, np.ndarray, np.ndarray]:
    """The recorder's noise, each impact's sampling rate, and by how much longer a mean takes to settle.

    A mean of many samples varies in proportion to the sum of their correlations.
    """
    intervals, rate = np.unique([float(f"{interval:.6g}") for interval in dt], return_inverse=True)
    of_lags = [partial(autocorrelation, recorder, dt=float(interval)) for interval in intervals]
    sums = white + (1 - white) * np.array([2 * at_lags(np.arange(rows)).sum() - 1 for at_lags in of_lags])
    return colour_of(white, of_lags, rows), rate, np.sqrt(np.maximum(sums, white))[rate]


def low_pass_of(recorder: LowPassFilter, dt: np.ndarray) -> LowPass:
    """The recorder's filter as the likelihood takes it, and how it is told in samples this far apart."""
    poles, weights = filter_modes(recorder)
    corner = 2 * np.pi * recorder.low_pass_hz
    # Between two samples nothing happens to those that a digital filter ran over.
    finer = 1 if recorder.digital else int(np.clip(np.ceil(corner * dt.max() / _PHASE), 1, _MOST_CELLS))
    ahead = None
    if recorder.zero_phase:
        ahead = jnp.zeros(int(np.ceil((ahead_s(recorder, dt) / dt).max())))
    cells = (jnp.arange(finer) + 0.5) / finer
    sampled = jnp.asarray(corner) if recorder.digital else None
    return LowPass(jnp.asarray(poles), jnp.asarray(weights), cells, ahead, sampled)
