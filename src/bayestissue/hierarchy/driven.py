"""Displacement and force of tissue that something pushes, as a fit takes them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayestissue.dataset.model import Dataset
from bayestissue.errors import InputError, Problem
from bayestissue.hierarchy.force import rows_within
from bayestissue.likelihood.driven import motion
from bayestissue.likelihood.driven.measured import DrivenRecord, driven_record
from bayestissue.signal import Displacements
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.traces import stack, standard_error

# Of the greatest: a force that no damper adds to, where least squares find none.
_LIGHT = 0.1


def driven_rows(dataset: Dataset, signal: Displacements, *, discrepancy: bool, source: str) -> DrivenRecord:
    """The record of a dataset without a free mass.

    Args:
        dataset: displacements and a force.
        signal: what the signal chain made of the displacements.
        discrepancy: whether there is a force beside the element's.
        source: the model file's name.

    Raises:
        InputError: a force has too few samples in an impact's window.
    """
    (channel,) = dataset.channels
    # Half the width of a uniform moment of contact is 3^1/2 of its standard deviations.
    rows = rows_within(stack(channel.traces), signal, np.sqrt(3) * signal.contact_time_sd)
    short = np.flatnonzero(rows.number < FEWEST_SAMPLES)
    if short.size:
        names = dataset.impacts["impact"].astype(str).to_list()
        raise InputError(
            Problem.stated(
                "too-few-samples.force",
                source,
                column=channel.name,
                value=int(rows.number[i]),
                impact=names[i],
            )
            for i in short
        )
    value = rows.value
    index = np.arange(value.shape[1])
    y = np.where(index < rows.number[:, None], value, 0.0)
    # Without a quiet part the zero is known to within the force itself.
    unknown = np.abs(y).max(axis=1)
    of_quiet = standard_error(rows.noise, rows.n_quiet)
    zero_sd = np.where(rows.n_quiet >= FEWEST_SAMPLES, of_quiet, unknown)
    depth_sd = np.abs(signal.v[:, 0]) * signal.contact_time_sd
    return driven_record(
        (y, rows.number, rows.first - signal.contact_time_s, rows.dt),
        (signal.x, signal.n_samples, signal.first_sample_s, signal.dt),
        np.stack([depth_sd, zero_sd], axis=1),
        discrepancy=discrepancy,
    )


def first_guess(record: DrivenRecord) -> dict[str, Float[np.ndarray, " impact"]]:
    """Logs of K, C and of the parameters of the noise, by name: least squares of force on depth and rate.

    Depth and rate are those of the motion at hand; where they give no K or C above 0 these are such that
    the spring makes all of the greatest force, or the damper a tenth.
    """
    y, at_y, rate, x, at_x, reference, unit = (
        np.asarray(getattr(record, name)) for name in ("y", "at_y", "rate", "x", "at_x", "reference", "unit")
    )
    rows = np.arange(y.shape[1]) < np.asarray(record.n_samples)[:, None]
    samples = np.arange(x.shape[1]) < np.asarray(record.n_displacements)[:, None]
    depth, speed = (np.einsum("iaf,if->ia", part, reference[:, :-1]) for part in (at_y, rate))
    columns = np.stack([depth, speed], axis=-1)
    squares = np.einsum("iac,iad->icd", columns, columns)
    coefficients = np.linalg.pinv(squares, hermitian=True) @ np.einsum("iac,ia->ic", columns, y)[..., None]
    K, C = coefficients[..., 0].T
    fastest = np.maximum(np.abs(speed).max(axis=1), 1e-300)
    K = np.where(K > 0, K, unit[:, 1] / unit[:, 0])
    light = _LIGHT * unit[:, 1] / fastest
    C = np.where(_LIGHT * light < C, C, light)
    left = y - K[:, None] * depth - C[:, None] * speed
    force = np.sqrt((left**2).sum(1) / rows.sum(1)) / unit[:, 1]
    level = reference[:, -1:] * unit[:, :1]
    moved = x - np.where(samples, level + np.einsum("iaf,if->ia", at_x, reference[:, :-1]), 0.0)
    noise = np.sqrt((moved**2).sum(1) / samples.sum(1)) / unit[:, 0]
    rough = np.sqrt((reference[:, motion.POWERS : -1] ** 2).mean(1))
    least = 1e-6  # of noise: below every digit that a recorder writes
    return {
        "K": np.log(K),
        "C": np.log(C),
        "noise": np.log(np.maximum(noise, least)),
        "noise_force": np.log(np.maximum(force, least)),
        "roughness": np.log(np.maximum(rough, 0.1)),
    }
