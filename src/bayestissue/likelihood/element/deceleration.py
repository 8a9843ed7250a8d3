"""Recorded decelerations of an impact on a spring and damper, with white noise and a measuring chain.

(1 + gain) d(t - tau; V + dV) + b, to first order in the errors: d itself is V times the deceleration h(t) of
an impact at unit velocity, so gain and velocity errors add (gain V + dV) h(t), an offset adds b, and an error
tau of the contact time adds -tau V h'(t). Contact lies anywhere between two samples: tau is uniform then.

Where gravity g acts along the motion, d is what a sensor reads that is 0 in free fall, F / M = g - x''. The
answer u(t) to a unit impulse has h = -u'', and a constant force M g adds g (1 - u'): d = V h + g (1 - u') and
d' = V h' + g h. Gain and velocity are then two errors: see `bayestissue.likelihood.element.impact` for both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Bool, Float, Int
from numpyro.distributions import constraints

from bayestissue.likelihood.element.motion_on_grid import Response, response_in_blocks
from bayestissue.likelihood.linear_errors import (
    Products,
    draw_errors,
    from_lower_entries,
    gram,
    marginal_log_likelihood,
    prior_errors,
)
from bayestissue.likelihood.quadratic import sums_over_frequencies
from bayestissue.likelihood.transforms import FILLED, in_blocks
from bayestissue.oscillator import Motion, impact_motion
from bayestissue.padding import bucket


class DecelerationRecord(NamedTuple):
    """What the likelihood reads of a set of deceleration traces.

    Attributes:
        d: decelerations, 0 past a row's end [m/s^2].
        n_samples: length of each.
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
        velocity: recorded velocity at contact [m/s].
        error_sd: standard deviations of velocity and gain together [m/s], of the offset [m/s^2] and of the
            contact time [s]; along gravity of the velocity alone.
        uniform: where the contact time's error is uniform instead of normal.
        blocks: the decelerations, sample k = lane + lanes * block.
        gravity: g, along the motion [m/s^2].
    """

    d: Float[Array, "impact sample"]
    n_samples: Int[Array, " impact"]
    first_time: Float[Array, " impact"]
    dt: Float[Array, " impact"]
    velocity: Float[Array, " impact"]
    error_sd: Float[Array, "impact 3"]
    uniform: Bool[Array, " impact"]
    blocks: Float[Array, "block impact lane"]
    gravity: Float[Array, " impact"]

    @classmethod
    def from_arrays(cls, *arrays: np.ndarray, gravity: float | np.ndarray = 0.0) -> DecelerationRecord:
        """From numpy arrays in the order of the attributes before ``blocks``, and gravity.

        Values past a row's end are cleared.
        """
        d, n_samples, *others = (np.asarray(array) for array in arrays)
        d = np.where(np.arange(d.shape[1]) < n_samples[:, None], d, 0.0)
        width = FILLED * bucket(-(-d.shape[1] // FILLED))
        padded = np.pad(d, ((0, 0), (0, width - d.shape[1])))
        along = np.broadcast_to(np.asarray(gravity, float), n_samples.shape)
        *arrays, along = jax.device_put((d, n_samples, *others, along))
        return cls._make([*arrays, in_blocks(padded), along])

    @property
    def traces(self) -> Float[Array, "impact sample"]:
        """The recorded decelerations."""
        return self.d

    @property
    def errors(self) -> dict[str, str]:
        """What each column of ``error_sd`` is called in the posterior, and which link of the chain errs."""
        return {
            "velocity_error": "velocity and gain",
            "offset_error": "offset",
            "contact_time_error": "contact moment",
        }

    def with_traces(
        self, traces: Float[np.ndarray, "impact sample"], n_samples: Int[np.ndarray, " impact"]
    ) -> DecelerationRecord:
        """The record of other traces, or of fewer of their samples."""
        return self.from_arrays(
            traces, n_samples, *map(np.asarray, self[2:7]), gravity=np.asarray(self.gravity)
        )

    def with_normal_errors(self) -> DecelerationRecord:
        """The same, every error of the measuring chain taken as normal with its standard deviation."""
        return self._replace(uniform=jnp.zeros_like(self.uniform))

    def inside(self) -> Bool[Array, "impact sample"]:
        """True where there is a sample."""
        return jnp.arange(self.d.shape[1]) < self.n_samples[:, None]

    def time(self) -> Float[Array, "impact sample"]:
        """Time since contact, also past a row's end [s]."""
        return self.first_time[:, None] + jnp.arange(self.d.shape[1]) * self.dt[:, None]


@jax.custom_jvp
def recorded_log_likelihood(
    omega_n: Float[Array, " impact"],
    zeta: Float[Array, " impact"],
    log_sigma: Float[Array, " impact"],
    record: DecelerationRecord,
) -> Float[Array, " impact"]:
    """Log density of the recorded traces, errors integrated out: one pass over the samples, two with slopes.

    Args:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        log_sigma: log of the noise's standard deviation [m/s^2].
        record: the traces.
    """
    return _of_entries(
        log_sigma, _entries(*_parts(_motion(omega_n, zeta, record), omega_n, zeta, record)), record
    )


def _of_entries(log_sigma: Array, entries: tuple[Array, ...], record: DecelerationRecord) -> Array:
    count = record.n_samples + 0.0
    products = Products(from_lower_entries(entries), jnp.zeros_like(count), count)
    return marginal_log_likelihood(products, log_sigma, record.error_sd, record.uniform)


def _motion(omega_n: Array, zeta: Array, record: DecelerationRecord) -> Response:
    return response_in_blocks(record.first_time, record.dt, omega_n, zeta, record.blocks.shape[-1])


def _parts(
    motion: Response, omega_n: Array, zeta: Array, record: DecelerationRecord
) -> tuple[Array, Array, Array, Array]:
    """Residual, unit deceleration, ones and the column of the contact time, all 0 past a trace's end."""
    p, q, velocity = (2 * zeta * omega_n)[:, None], (omega_n**2)[:, None], record.velocity[:, None]
    gravity = record.gravity[:, None]
    block, _, lane = (jax.lax.broadcasted_iota(int, record.blocks.shape, axis) for axis in range(3))
    inside = jnp.where(lane + block * record.blocks.shape[-1] < record.n_samples[:, None], 1.0, 0.0)
    unit = inside * (p * motion.v + q * motion.x)
    contact = -velocity * (inside * q * motion.v - p * unit) - gravity * unit
    fall = gravity * inside * (1 - motion.v)
    return record.blocks - velocity * unit - fall, unit, inside, contact


def _entries(residual: Array, unit: Array, inside: Array, contact: Array) -> tuple[Array, ...]:
    parts = (residual, unit, inside, contact)
    return sums_over_frequencies(tuple(parts[a] * parts[b] for a in range(4) for b in range(a + 1)))


@recorded_log_likelihood.defjvp
def _recorded_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """The slopes by p = 2 zeta omega_n and q = omega_n^2 are those by the samples times the samples' own.

    With x the answer to a unit impulse and w that to x, dx/dq = -w and dx/dp is its first derivative in time.
    The deceleration, minus the second derivative of x, therefore has for slopes the second and the third
    derivative of w, and the jerk the third and the fourth; w2, w3 and w4 each follow from those before by
    w2 + p w1 + q w = x. Gravity's part, g (1 - x'), has those of g w1 and g w2.
    """
    omega_n, zeta, log_sigma, record = primals
    motion = _motion(omega_n, zeta, record)
    residual, unit, inside, contact = parts = _parts(motion, omega_n, zeta, record)
    value, pull_back = jax.vjp(lambda s, e: _of_entries(s, e, record), log_sigma, _entries(*parts))
    by_log_sigma, by_entries = pull_back(jnp.ones_like(value))
    # Made before the second pass, not anew for each of its samples.
    by_entries = jax.lax.optimization_barrier(by_entries)
    (rr, ur, uu, ir, iu, _, cr, cu, ci, cc) = (slope[:, None] for slope in by_entries)
    p, q, velocity = (2 * zeta * omega_n)[:, None], (omega_n**2)[:, None], record.velocity[:, None]
    gravity = record.gravity[:, None]
    by_residual = 2 * rr * residual + ur * unit + ir * inside + cr * contact
    by_contact = cr * residual + cu * unit + ci * inside + 2 * cc * contact
    by_unit = ur * residual + 2 * uu * unit + iu * inside + cu * contact - velocity * by_residual
    by_unit, by_jerk, by_fall = by_unit - gravity * by_contact, -velocity * by_contact, -gravity * by_residual
    w1 = motion.time * motion.x / 2 - p / 2 * motion.w
    w2 = motion.x - p * w1 - q * motion.w
    w3 = motion.v - p * w2 - q * w1
    w4 = -(p * motion.v + q * motion.x) - p * w3 - q * w2
    # Two loops: one of both sums has more in hand than a processor has registers.
    (by_q,) = sums_over_frequencies((inside * (by_unit * w2 + by_jerk * w3 + by_fall * w1),))
    (by_p,) = sums_over_frequencies((inside * (by_unit * w3 + by_jerk * w4 + by_fall * w2),))
    slopes = (2 * omega_n * by_q + 2 * zeta * by_p, 2 * omega_n * by_p, by_log_sigma)
    return value, sum(slope * tangent for slope, tangent in zip(slopes, tangents[:3], strict=True))


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
        count = self.record.n_samples + 0.0
        if value is None:
            motion = _motion(self.omega_n, self.zeta, self.record)
            entries = _entries(*_parts(motion, self.omega_n, self.zeta, self.record))
            return Products(from_lower_entries(entries), jnp.zeros_like(count), count)
        expected, columns, inside = self._columns()
        parts = (jnp.where(inside, value - expected, 0.0), *columns)
        return Products(gram(parts, jnp.ones(())), jnp.zeros_like(count), count)

    def log_prob(self, value: Float[Array, "impact sample"]) -> Float[Array, " impact"]:
        """Log density of each impact's trace, its errors integrated out."""
        if value is self.record.d:
            return recorded_log_likelihood(self.omega_n, self.zeta, self.log_sigma, self.record)
        record = self.record
        return marginal_log_likelihood(self.products(value), self.log_sigma, record.error_sd, record.uniform)

    def draw_errors(self, key: Array) -> Float[Array, "impact 3"]:
        """The chain's errors given the recorded traces: velocity and gain, offset, contact time."""
        record = self.record
        return draw_errors(key, self.products(), self.log_sigma, record.error_sd, record.uniform)

    def residuals(self, errors: Float[Array, "impact 3"]) -> Float[Array, "impact sample"]:
        """What the impact and these errors of the chain leave of the recorded traces; 0 past their ends."""
        expected, columns, inside = self._columns()
        added = sum(errors[:, i, None] * column for i, column in enumerate(columns))
        return jnp.where(inside, self.record.d - expected - added, 0.0)

    def innovations(
        self, left: Float[Array, "impact sample"]
    ) -> tuple[Float[Array, "impact sample"], Int[Array, " impact"]]:
        """What is white of residuals [m/s^2]: these themselves; and how many there are of each impact."""
        return left, self.record.n_samples

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw traces: the impact, the chain's errors and white noise."""
        key_of_noise, key_of_errors = jax.random.split(key)
        shape = (*sample_shape, *self.batch_shape)
        expected, columns, inside = self._columns()
        errors = prior_errors(key_of_errors, shape, self.record.error_sd, self.record.uniform)
        added = sum(errors[..., i, None] * column for i, column in enumerate(columns))
        noise = jax.random.normal(key_of_noise, (*shape, *self.event_shape))
        return jnp.where(inside, expected + added + jnp.exp(self.log_sigma)[:, None] * noise, 0.0)

    def replicate(self, key: Array) -> dict[str, Float[Array, "impact sample"]]:
        """A replicate of every trace, the deceleration [m/s^2]; NaN past its end."""
        return {"deceleration": jnp.where(self.record.inside(), self.sample(key), jnp.nan)}

    def _whole(self) -> Motion:
        """The impacts at the recorded velocities."""
        record = self.record
        parameters = (self.omega_n, self.zeta, record.velocity, record.gravity)
        return impact_motion(record.time(), *(parameter[:, None] for parameter in parameters))

    def _columns(self) -> tuple[Array, tuple[Array, ...], Array]:
        record, inside, time = self.record, self.record.inside(), self.record.time()
        omega_n, zeta = self.omega_n[:, None], self.zeta[:, None]
        unit, whole = impact_motion(time, omega_n, zeta, 1.0), self._whole()
        # d = 2 zeta omega_n v + omega_n^2 x, and v' = g - d.
        fall = record.gravity[:, None] - whole.deceleration
        jerk = omega_n**2 * whole.velocity + 2 * zeta * omega_n * fall
        columns = (unit.deceleration, jnp.ones_like(time), -jerk)
        return (
            whole.deceleration,
            tuple(jnp.where(inside, column, 0.0) for column in columns),
            inside,
        )
