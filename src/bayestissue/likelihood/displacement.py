"""Integrated displacements as ARMA(2,1), with the errors that the measuring chain puts into them.

With a recorded deceleration (1 + g) d + b and a velocity V recorded for V + dV, two integrations give
x - (g V + dV) t - b t^2 / 2 for the displacement x, up to products of errors; a contact time in error by
tau adds V tau. All three are linear: a constant, a ramp and a parabola.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Float, Int
from numpyro.distributions import constraints

from bayestissue.likelihood.distributions import ARMA21
from bayestissue.likelihood.innovations import innovations
from bayestissue.likelihood.linear_errors import Products, gram, marginal_log_likelihood
from bayestissue.likelihood.quadratic import eigenvalues, log_determinant
from bayestissue.likelihood.transforms import spread_of
from bayestissue.oscillator import to_differences

Noise = Literal["arma", "a2"]


class DisplacementRecord(NamedTuple):
    """What the likelihood reads of a set of displacement traces.

    Attributes:
        x: displacements, 0 past a row's end [m].
        n_samples: length of each.
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
        columns: orthonormal DST-I of x''_t, x'_{t-1} and x_{t-2}, t = 3 ... n, and of 1, t and t^2 at t - 2.
        spread: 2 - 2 cos(j pi / (n - 1)).
        error_sd: standard deviations of the constant [m], the ramp [m/s] and the parabola [m/s^2].
    """

    x: Float[Array, "impact sample"]
    n_samples: Int[Array, " impact"]
    first_time: Float[Array, " impact"]
    dt: Float[Array, " impact"]
    columns: tuple[Float[Array, "impact frequency"], ...]
    spread: Float[Array, "impact frequency"]
    error_sd: Float[Array, "impact 3"]


def displacement_record(
    x: Float[np.ndarray, "impact sample"],
    n_samples: Int[np.ndarray, " impact"],
    first_time: Float[np.ndarray, " impact"],
    dt: Float[np.ndarray, " impact"],
    error_sd: Float[np.ndarray, "impact 3"],
) -> DisplacementRecord:
    """Transform the traces and the errors' columns once, those of one length in one call.

    Arguments as the attributes of `DisplacementRecord`.

    Raises:
        ValueError: an impact has fewer than three samples or more than ``x`` is wide.
    """
    from scipy import fft

    lengths = np.asarray(n_samples)
    if lengths.size and not 3 <= lengths.min() <= lengths.max() <= x.shape[1]:
        raise ValueError(f"every impact needs 3 to {x.shape[1]} samples")
    inside = np.arange(x.shape[1]) < lengths[:, None]
    x = np.where(inside, x, 0.0)
    time = first_time[:, None] + np.arange(x.shape[1]) * dt[:, None]
    width = x.shape[1] - 2
    columns = np.zeros((6, len(x), width))
    # padded frequencies count as an eigenvalue of 1 + theta1^2, never zero
    spread = np.full((len(x), width), 2.0)
    for n in np.unique(lengths):
        rows = np.flatnonzero(lengths == n)
        part, t = x[rows, :n], time[rows, : n - 2]
        slope = np.diff(part, axis=1)
        series = (np.diff(slope, axis=1), slope[:, :-1], part[:, :-2], np.ones_like(t), t, t**2)
        for column, values in zip(columns, series, strict=True):
            column[rows, : n - 2] = fft.dst(values, type=1, axis=1, norm="ortho")
        spread[rows, : n - 2] = spread_of(n - 2)
    return DisplacementRecord(
        jnp.asarray(x),
        jnp.asarray(lengths),
        jnp.asarray(first_time),
        jnp.asarray(dt),
        tuple(jnp.asarray(column) for column in columns),
        jnp.asarray(spread),
        jnp.asarray(error_sd),
    )


def displacement_products(record: DisplacementRecord, c1: Array, c2: Array, theta1: Array) -> Products:
    """Products of w_t = x''_t + c1 x'_{t-1} + c2 x_{t-2} and of what the errors' columns become.

    The constant becomes c2, the ramp c1 dt + c2 t, half the parabola
    dt^2 + c1 dt (t + dt / 2) + c2 t^2 / 2, all at t - 2.

    Args:
        record: the traces.
        c1: 2 - phi1, for each impact.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient.
    """
    bend, slope, level, one, ramp, square = record.columns
    k1, k2, dt = c1[:, None], c2[:, None], record.dt[:, None]
    parts = (
        bend + k1 * slope + k2 * level,
        k2 * one,
        k1 * dt * one + k2 * ramp,
        (dt**2 + k1 * dt**2 / 2) * one + k1 * dt * ramp + k2 / 2 * square,
    )
    weight = 1 / eigenvalues(theta1[:, None], record.spread)
    count = record.n_samples - 2.0
    return Products(gram(parts, weight), log_determinant(theta1, count), count)


class MeasuredDisplacement(dist.Distribution):
    """Distribution of whole displacement traces: ARMA(2,1) plus the measuring chain's linear errors.

    One event an impact, the density of x_3 ... x_n given x_1 and x_2 with the errors integrated out. At
    ``record.x`` itself the density comes from the stored transforms; at any other value from a filter.

    Args:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        theta1: moving-average coefficient, or None: that of the sampled A(2) (thesis, section 2.11).
        log_sigma: log of the shocks' standard deviation [m].
        record: see `displacement_record`.
    """

    arg_constraints = {  # noqa: RUF012
        "omega_n": constraints.positive,
        "zeta": constraints.real,
        "log_sigma": constraints.real,
    }
    support = constraints.real_vector
    pytree_data_fields = ("omega_n", "zeta", "theta1", "log_sigma", "record")

    def __init__(
        self,
        omega_n: Array,
        zeta: Array,
        theta1: Array | None,
        log_sigma: Array,
        record: DisplacementRecord,
        *,
        validate_args: bool | None = None,
    ) -> None:
        self.omega_n, self.zeta, self.theta1, self.log_sigma = omega_n, zeta, theta1, log_sigma
        self.record = record
        super().__init__(omega_n.shape, record.x.shape[1:], validate_args=validate_args)

    def differences(self) -> tuple[Array, Array, Array]:
        """c1, c2 and theta1 of each impact."""
        c1, c2, sampled = to_differences(self.omega_n, self.zeta, self.record.dt)
        return c1, c2, sampled if self.theta1 is None else self.theta1

    def products(self) -> Products:
        """See `displacement_products`."""
        return displacement_products(self.record, *self.differences())

    def log_prob(self, value: Float[Array, "impact sample"]) -> Float[Array, " impact"]:
        """Log density of each impact's trace, its errors integrated out."""
        products = self.products() if value is self.record.x else self._filtered(value)
        return marginal_log_likelihood(products, self.log_sigma, self.record.error_sd)

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw traces from the record's first two values on: the recursion, then the chain's errors."""
        key_of_x, key_of_errors = jax.random.split(key)
        record = self.record
        c1, c2, theta1 = self.differences()
        errors = record.error_sd * jax.random.normal(key_of_errors, (*sample_shape, *self.batch_shape, 3))
        time = record.first_time[:, None] + jnp.arange(record.x.shape[1]) * record.dt[:, None]
        e0, e1, e2 = (errors[..., i, None] for i in range(3))
        added = e0 + e1 * time + e2 * time**2 / 2
        first = record.x[:, :2] - added[..., :2]
        shape = (*sample_shape, *self.batch_shape)
        clean = ARMA21(
            jnp.broadcast_to(c1, shape),
            c2,
            theta1,
            jnp.exp(self.log_sigma),
            first=first,
            n_samples=record.n_samples,
            width=record.x.shape[1],
        ).sample(key_of_x)
        inside = jnp.arange(record.x.shape[1]) < record.n_samples[:, None]
        return jnp.where(inside, clean + added, 0.0)

    def _filtered(self, value: Array) -> Products:
        record = self.record
        c1, c2, theta1 = self.differences()
        time = record.first_time[:, None] + jnp.arange(value.shape[-1]) * record.dt[:, None]
        count = record.n_samples - 2.0
        valid = jnp.arange(value.shape[-1] - 2) < count[:, None]
        series = jnp.stack(jnp.broadcast_arrays(value, jnp.ones_like(time), time, time**2 / 2))
        slope = jnp.diff(series, axis=-1)
        w = jnp.diff(slope, axis=-1) + c1[:, None] * slope[..., :-1] + c2[:, None] * series[..., :-2]
        valid = jnp.broadcast_to(valid, w.shape)
        errors, spreads = innovations(jnp.where(valid, w, 0.0), jnp.broadcast_to(theta1, w.shape[:-1]), valid)
        return Products(gram(tuple(errors), 1 / spreads[0]), jnp.log(spreads[0]).sum(-1), count)
