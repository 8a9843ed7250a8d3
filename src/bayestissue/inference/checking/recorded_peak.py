"""Whether the sensor's own greatest deceleration is one that the posterior of its impact allows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.stats import norm

from bayestissue.dataset.settings import STANDARD_GRAVITY
from bayestissue.declarations import general
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.inference.checking import sentence
from bayestissue.inference.checking.model_form import NAMED
from bayestissue.outline import first_of

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset

# So many sound impacts at most have a sample that noise takes beyond the limit: of a thousand, one dataset in
# a hundred.
_BY_CHANCE = 1e-5
# Of the peak: a lesser miss is not worth a word.
_LEAST = 0.01


def missed_peaks(
    dataset: Dataset,
    prepared: Prepared,
    low: Float[np.ndarray, " impact"],
    high: Float[np.ndarray, " impact"],
    jerk: Float[np.ndarray, " impact"],
) -> Bool[np.ndarray, " impact"]:
    """Where the greatest sample is farther from the interval of peak_deceleration than the recorder takes it.

    Of the right model it is the peak plus the noise of one of n samples, times the recorder's gain. The
    greatest of n independent normals is above z with a probability of at most n (1 - Phi(z)), which z makes
    one in 100,000. The noise is that of the recording, from its third differences, not the fitted one: what a
    wrong law leaves over counts as noise in the fit, and widens the interval. Below the interval the peak may
    lie between two samples, and after the last one. Behind a low-pass or at the sensor's limit nothing is
    said.

    Args:
        dataset: the recordings, of an impactor that moves freely.
        prepared: the fit of their decelerations.
        low: end of the 90 % interval of peak_deceleration [standard gravity].
        high: its other end.
        jerk: the greatest that is credible [m/s^3]; infinite where it is not known.
    """
    if prepared.model.kind != "impact" or dataset.recorder is not None:
        return np.zeros(len(low), bool)
    signal, chain = prepared.signal, dataset.uncertainty
    recorded = np.exp(np.asarray(prepared.data.log_peak))
    zero_sd = signal.zero_sd(chain.offset_sd)
    sd = np.sqrt(signal.noise_sd**2 + (chain.relative_gain_sd * recorded) ** 2 + zero_sd**2)
    room = norm.isf(_BY_CHANCE / signal.n_samples) * sd + _LEAST * recorded
    within = np.argmax(np.abs(signal.deceleration), axis=1) < signal.n_samples - 1
    above = recorded > STANDARD_GRAVITY * high + room
    below = within & (recorded < STANDARD_GRAVITY * low - room - jerk * signal.dt)
    return (above | below) & ~signal.clipped.any(axis=1)


def judge_peaks(dataset: Dataset, prepared: Prepared, summary: pd.DataFrame) -> dict[str, Any]:
    """The entry ``recorded_peak`` of ``diagnostics.json``, empty where no impact's peak is missed.

    Args:
        dataset: the recordings.
        prepared: the fit.
        summary: of its posterior; without peak_deceleration in it nothing is asked.

    Returns:
        ``impacts``, those whose peak is missed; ``of`` how many; ``words``.
    """
    names = prepared.impacts["impact"].astype(str)
    low, high, jerk = (
        summary[summary["variable"] == name].set_index("label")[end].reindex(names).to_numpy(float)
        for name, end in (
            ("peak_deceleration", "eti90_low"),
            ("peak_deceleration", "eti90_high"),
            ("peak_jerk", "eti90_high"),
        )
    )
    missed = missed_peaks(dataset, prepared, low, high, np.where(np.isnan(jerk), np.inf, jerk))
    if not missed.any():
        return {}
    first, named = int(np.argmax(missed)), names[missed].tolist()
    words = sentence(
        "peak.missed",
        count=len(named),
        of=len(names),
        named=first_of(named, NAMED),
        impact=names[first],
        recorded=general(np.exp(float(prepared.data.log_peak[first])) / STANDARD_GRAVITY),
        low=general(low[first]),
        high=general(high[first]),
        remedy=sentence("peak.with_discrepancy" if prepared.model.discrepancy else "peak.without"),
    )
    return {"impacts": named, "of": len(names), "words": words}
