"""Displacement and force of tissue that something pushes, as a fit takes them."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayestissue.dataset.model import Dataset
from bayestissue.dataset.settings import FILE as SETTINGS
from bayestissue.elements.element import DAMPING, STIFFNESS, Element
from bayestissue.errors import InputError, Problem
from bayestissue.hierarchy.force import rows_within
from bayestissue.likelihood.driven import motion
from bayestissue.likelihood.driven.measured import DrivenRecord, driven_record
from bayestissue.signal import Displacements
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.traces import stack, standard_error

# Of the greatest: a force that no damper adds to, where least squares find none.
_LIGHT = 0.1
# Of the window, the greatest standard deviation of a clock: three of them are half of it.
_LATEST = 1 / 6


def driven_rows(
    dataset: Dataset,
    signal: Displacements,
    *,
    discrepancy: bool,
    surroundings: dict[str, Float[np.ndarray, " impact"]],
    common_depth: float,
    source: str,
) -> DrivenRecord:
    """The record of a dataset without a free mass.

    Args:
        dataset: displacements and a force.
        signal: what the signal chain made of the displacements.
        discrepancy: whether there is a force beside the element's.
        surroundings: what an element's functions take beside its parameters, by name.
        common_depth: see `DrivenRecord`.
        source: the model file's name.

    Raises:
        InputError: a force has too few samples in an impact's window, or its clock is as good as unknown.
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
    window = np.median(signal.first_sample_s + (signal.n_samples - 1) * signal.dt)
    if channel.time_offset_sd_s > _LATEST * window:
        where = SETTINGS, None, "channel.time_offset_sd_s", channel.time_offset_sd_s
        raise InputError.stated("clock-unknown", *where, most=_LATEST * window)
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
        clock_sd=np.full(len(y), channel.time_offset_sd_s),
        discrepancy=discrepancy,
        surroundings=surroundings,
        common_depth=np.full(len(y), common_depth),
    )


def first_guess(record: DrivenRecord, element: Element) -> dict[str, Float[np.ndarray, " impact"]]:
    """Logs of the element's parameters and of those of the noise, by the names that the model has.

    K and C are by least squares of the force on what a unit of each adds to it along the motion at hand, the
    further parameters being typical and lengths no less than twice the depth. Where they give hardly any K or
    C the spring makes all of the greatest force, or the damper a tenth. Of an element that remembers they are
    those of spring and damper side by side.
    """
    y, at_y, rate, x, at_x, reference, unit = (
        np.asarray(getattr(record, name)) for name in ("y", "at_y", "rate", "x", "at_x", "reference", "unit")
    )
    rows = np.arange(y.shape[1]) < np.asarray(record.n_samples)[:, None]
    samples = np.arange(x.shape[1]) < np.asarray(record.n_displacements)[:, None]
    depth, speed = (np.einsum("iaf,if->ia", part, reference[:, :-1]) for part in (at_y, rate))
    further = {
        one.name: np.maximum(one.typical, 2 * unit[:, 0] if one.unit == "m" else 0.0) * np.ones(len(y))
        for one in element.extra
    }
    columns = np.stack([depth, speed], axis=-1)
    if not element.states:
        columns = np.where(rows[..., None], _of_units(element, record, further, depth, speed), 0.0)
    squares = np.einsum("iac,iad->icd", columns, columns)
    coefficients = np.linalg.pinv(squares, hermitian=True) @ np.einsum("iac,ia->ic", columns, y)[..., None]
    K, C = coefficients[..., 0].T
    most = np.maximum(np.abs(columns).max(axis=1), 1e-300)
    stiff, light = unit[:, 1] / most[:, 0], _LIGHT * unit[:, 1] / most[:, 1]
    K, C = np.where(_LIGHT * stiff < K, K, stiff), np.where(_LIGHT * light < C, C, light)
    left = y - K[:, None] * columns[..., 0] - C[:, None] * columns[..., 1]
    force = np.sqrt((left**2).sum(1) / rows.sum(1)) / unit[:, 1]
    moved = x - np.einsum("iaw,iw->ia", at_x, reference)
    noise = np.sqrt((moved**2).sum(1) / samples.sum(1)) / unit[:, 0]
    rough = np.sqrt((reference[:, motion.POWERS : -1] ** 2).mean(1))
    # Of a mass that would come to rest as late.
    mass = K * (2 / np.pi * rows.sum(1) * np.asarray(record.dt)) ** 2
    K, C = (np.asarray(part) for part in element.guess(jnp.asarray(K), jnp.asarray(C), jnp.asarray(mass)))
    least = 1e-6  # of noise: below every digit that a recorder writes
    return {
        "K": np.log(K),
        "C": np.log(C),
        "noise": np.log(np.maximum(noise, least)),
        "noise_force": np.log(np.maximum(force, least)),
        "roughness": np.log(np.maximum(rough, 0.1)),
        "force_clock": np.zeros(len(y)),
        **{f"log_{name}": np.log(value) for name, value in further.items()},
    }


def _of_units(
    element: Element,
    record: DrivenRecord,
    further: dict[str, Float[np.ndarray, " impact"]],
    x: Float[np.ndarray, "impact row"],
    v: Float[np.ndarray, "impact row"],
) -> Float[np.ndarray, "impact row 2"]:
    """The forces of K = 1 alone and of C = 1 alone: what remembers nothing is linear in both."""
    others = {name: jnp.asarray(value)[:, None] for name, value in (record.surroundings | further).items()}
    none, one = jnp.zeros(()), jnp.ones(())
    units = ({STIFFNESS: one, DAMPING: none}, {STIFFNESS: none, DAMPING: one})
    motion = jnp.asarray(x), jnp.asarray(v), ()
    return np.stack([np.asarray(element.force(*motion, others | unit)) for unit in units], axis=-1)
