"""Taps of a mass on tissue, as a fit takes them."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.dataset.model import Dataset
from bayestissue.likelihood.tapped.measured import MeasuredTap, TapRecord
from bayestissue.oscillator import spring_damper
from bayestissue.signal.options import SignalOptions
from bayestissue.signal.tapped import frequency_of, taps

# Of a sampling interval, the standard deviation of what one clock is behind the other.
_CLOCK = 0.25
# Frequencies about that of the spectrum's peak and damping ratios that are tried, and then about the best.
_FREQUENCIES = np.geomspace(0.5, 2.0, 41)
_RATIOS = np.geomspace(0.003, 2.0, 16)
_NEARER = np.geomspace(0.95, 1.05, 21), np.geomspace(0.6, 1.6, 9)


def tap_record(dataset: Dataset, options: SignalOptions) -> TapRecord:
    """The record of a dataset whose force is a hammer's."""
    tapped = taps(dataset, options)
    mass = dataset.impacts["mass_kg"].to_numpy(float)
    error_sd = np.stack(
        [tapped.impulse_sd / mass, tapped.zero_sd, _CLOCK * tapped.ringing.dt / tapped.averaged], axis=1
    )
    columns: Any = {
        "y": tapped.ringing.value,
        "n_samples": tapped.n_samples,
        "first_time": tapped.first_time,
        "dt": tapped.ringing.dt,
        "averaged": tapped.averaged.astype(float),
        "end": tapped.end,
        "push": tapped.impulse / mass[:, None],
        "dt_force": tapped.dt_force,
        "middle": tapped.middle,
        "error_sd": error_sd,
        "common_depth": np.full(len(mass), tapped.peak_depth.min()),
    }
    return TapRecord(**jax.tree.map(jnp.asarray, columns), surroundings={})


def first_guess(
    record: TapRecord, mass: Float[np.ndarray, " impact"]
) -> dict[str, Float[np.ndarray, " impact"]]:
    """Logs of K and C at the recorded masses, of the noise [m/s^2], and a, by least squares on a grid."""
    whole = record.padded()
    omega = frequency_of(np.asarray(whole.y), np.asarray(record.dt))
    tried = _pairs(_FREQUENCIES, _RATIOS)
    omega_n, zeta = _best(whole, omega * tried[0][:, None], tried[1][:, None] + 0.0 * omega)
    nearer = _pairs(*_NEARER)
    omega_n, zeta = _best(whole, omega_n * nearer[0][:, None], zeta * nearer[1][:, None])
    height, left = (np.asarray(part) for part in _fitted(whole, jnp.asarray(omega_n), jnp.asarray(zeta)))
    K, C = (np.asarray(part) for part in spring_damper(omega_n, zeta, mass))
    count, averaged = np.asarray(record.n_samples), np.asarray(record.averaged)
    noise = np.sqrt(averaged * left / np.maximum(count, 1))
    return {
        "K": np.log(K),
        "C": np.log(C),
        "noise": np.log(np.maximum(noise, 1e-12)),
        "log_force_ratio": -np.log(np.maximum(height, 1e-3)),
    }


def _pairs(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    grid, crossed = np.meshgrid(first, second, indexing="ij")
    return grid.ravel(), crossed.ravel()


def _best(
    record: TapRecord, omega_n: Float[np.ndarray, "try impact"], zeta: Float[np.ndarray, "try impact"]
) -> tuple[Float[np.ndarray, " impact"], Float[np.ndarray, " impact"]]:
    """Of what is tried the pair that leaves the least."""
    left = np.asarray(_all_left(record, jnp.asarray(omega_n), jnp.asarray(zeta)))
    best = left.argmin(axis=0)[None]
    of_best = (np.take_along_axis(part, best, axis=0)[0] for part in (omega_n, zeta))
    first, second = of_best
    return first, second


@jax.jit
def _all_left(
    record: TapRecord, omega_n: Float[Array, "try impact"], zeta: Float[Array, "try impact"]
) -> Float[Array, "try impact"]:
    return jax.lax.map(lambda pair: _fitted(record, *pair)[1], (omega_n, zeta))


@jax.jit
def _fitted(
    record: TapRecord, omega_n: Float[Array, " impact"], zeta: Float[Array, " impact"]
) -> tuple[Float[Array, " impact"], Float[Array, " impact"]]:
    """The height by least squares, at least a thousandth, and the sum of squares that it leaves."""
    none = jnp.zeros_like(omega_n)
    rings = MeasuredTap(omega_n, zeta, none, none, record).expected()
    squares = (rings**2).sum(1)
    height = jnp.maximum((rings * record.y).sum(1) / jnp.where(squares > 0, squares, 1.0), 1e-3)
    return height, ((record.y - height[:, None] * rings) ** 2).sum(1)
