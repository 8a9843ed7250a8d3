"""Recorded decelerations of an impact on a spring and damper, with white noise and a measuring chain.

(1 + g) d(t - tau; V + dV) + b, to first order in the errors: d itself is V times the deceleration h(t) of
an impact at unit velocity, so gain and velocity errors add (g V + dV) h(t), an offset adds b, and an error
tau of the contact time adds -tau V h'(t).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Float, Int
from numpyro.distributions import constraints

from bayestissue.likelihood.linear_errors import Products, gram, marginal_log_likelihood
from bayestissue.oscillator import impact_motion


class DecelerationRecord(NamedTuple):
    """What the likelihood reads of a set of deceleration traces.

    Attributes:
        d: decelerations, 0 past a row's end [m/s^2].
        n_samples: length of each.
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
        velocity: recorded velocity at contact [m/s].
        error_sd: standard deviations of velocity and gain together [m/s], of the offset [m/s^2] and of the
            contact time [s].
    """

    d: Float[Array, "impact sample"]
    n_samples: Int[Array, " impact"]
    first_time: Float[Array, " impact"]
    dt: Float[Array, " impact"]
    velocity: Float[Array, " impact"]
    error_sd: Float[Array, "impact 3"]

    @classmethod
    def of(cls, *arrays: np.ndarray) -> DecelerationRecord:
        """From numpy arrays in the order of the attributes; values past a row's end are cleared."""
        d, n_samples, *rest = (jnp.asarray(array) for array in arrays)
        d = jnp.where(jnp.arange(d.shape[1]) < n_samples[:, None], d, 0.0)
        return cls(d, n_samples, *rest)


class MeasuredDeceleration(dist.Distribution):
    """Distribution of whole deceleration traces; one event an impact, its errors integrated out.

    Args:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        log_sigma: log of the noise's standard deviation [m/s^2].
        record: see `DecelerationRecord`.
    """

    arg_constraints = {  # noqa: RUF012
        "omega_n": constraints.positive,
        "zeta": constraints.real,
        "log_sigma": constraints.real,
    }
    support = constraints.real_vector
    pytree_data_fields = ("omega_n", "zeta", "log_sigma", "record")

    def __init__(
        self,
        omega_n: Array,
        zeta: Array,
        log_sigma: Array,
        record: DecelerationRecord,
        *,
        validate_args: bool | None = None,
    ) -> None:
        self.omega_n, self.zeta, self.log_sigma, self.record = omega_n, zeta, log_sigma, record
        super().__init__(omega_n.shape, record.d.shape[1:], validate_args=validate_args)

    def products(self, value: Array | None = None) -> Products:
        """Products of the residual at ``value`` (the record's own unless given) and the errors' columns."""
        value = self.record.d if value is None else value
        expected, columns, inside = self._columns()
        parts = (jnp.where(inside, value - expected, 0.0), *columns)
        count = self.record.n_samples + 0.0
        return Products(gram(parts, jnp.ones(())), jnp.zeros_like(count), count)

    def log_prob(self, value: Float[Array, "impact sample"]) -> Float[Array, " impact"]:
        """Log density of each impact's trace, its errors integrated out."""
        return marginal_log_likelihood(self.products(value), self.log_sigma, self.record.error_sd)

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw traces: the impact, the chain's errors and white noise."""
        key_of_noise, key_of_errors = jax.random.split(key)
        shape = (*sample_shape, *self.batch_shape)
        expected, columns, inside = self._columns()
        errors = self.record.error_sd * jax.random.normal(key_of_errors, (*shape, 3))
        added = sum(errors[..., i, None] * column for i, column in enumerate(columns))
        noise = jax.random.normal(key_of_noise, (*shape, *self.event_shape))
        return jnp.where(inside, expected + added + jnp.exp(self.log_sigma)[:, None] * noise, 0.0)

    def _columns(self) -> tuple[Array, tuple[Array, ...], Array]:
        record = self.record
        inside = jnp.arange(record.d.shape[1]) < record.n_samples[:, None]
        time = record.first_time[:, None] + jnp.arange(record.d.shape[1]) * record.dt[:, None]
        omega_n, zeta, velocity = self.omega_n[:, None], self.zeta[:, None], record.velocity[:, None]
        unit = impact_motion(time, omega_n, zeta, 1.0)
        # d obeys the same equation as x: d' = -2 zeta omega_n d + omega_n^2 v
        jerk = omega_n**2 * unit.velocity - 2 * zeta * omega_n * unit.deceleration
        columns = (unit.deceleration, jnp.ones_like(time), -velocity * jerk)
        return (
            velocity * unit.deceleration,
            tuple(jnp.where(inside, column, 0.0) for column in columns),
            inside,
        )
