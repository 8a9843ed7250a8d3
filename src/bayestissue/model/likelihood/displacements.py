"""Integrated displacements as ARMA(2,1), with the errors that the measuring chain puts into them.

With a recorded deceleration (1 + g) d + b and a velocity V recorded for V + dV, two integrations give
x - (g V + dV) t - b t^2 / 2 for the displacement x, up to products of errors; a contact time in error by
tau adds V tau. All three are linear: a constant, a ramp and a parabola.

Gravity g along the motion gives the process the mean x_e = g / omega_n^2, where the impactor comes to rest:
no free parameter. w_t is smaller by c2 x_e then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.base.impact_arrays import (
    IndexPerImpact,
    JaxPerImpact,
    JaxPerSample,
    PerImpact,
    PerSample,
    bucket,
    padded_zeros,
)
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.mechanics.oscillator import to_differences
from bayestissue.model.likelihood import small
from bayestissue.model.likelihood.arma21 import (
    FILLED,
    arma21_series,
    eigenvalues,
    log_determinant,
    sums_over_frequencies,
    transformed,
)
from bayestissue.model.likelihood.channels import MeasuredTraces, SensorTrace
from bayestissue.model.likelihood.linear_errors import Errors, Products, from_lower_entries, part_of


class DisplacementRecord(NamedTuple):
    """What the likelihood reads of a set of displacement traces.

    Attributes:
        x: displacements, 0 past a row's end [m].
        n_samples: length of each.
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
        columns: orthonormal DST-I of x''_t, x'_{t-1} and x_{t-2}, t = 3 ... n, and of 1, t and t^2 at t - 2,
            in blocks of frequencies.
        spread: 2 - 2 cos(j pi / (n - 1)) in the same blocks.
        error_sd: standard deviations of the constant [m], the ramp [m/s] and the parabola [m/s^2].
        gravity: g, along the motion [m/s^2]; None where there is none.
        velocity: recorded velocity at contact [m/s]; None where there is none.
        velocity_share: of the variance of the ramp that which an error of the velocity makes.
    """

    x: JaxPerSample
    n_samples: Int[Array, " impact"]
    first_time: JaxPerImpact
    dt: JaxPerImpact
    columns: tuple[Float[Array, "block impact lane"], ...]
    spread: Float[Array, "block impact lane"]
    error_sd: Float[Array, "impact 3"]
    gravity: JaxPerImpact | None = None
    velocity: JaxPerImpact | None = None
    velocity_share: JaxPerImpact | None = None

    @property
    def traces(self) -> JaxPerSample:
        """The recorded displacements."""
        return self.x

    @property
    def side_by_side(self) -> bool:
        """Whether it is of a spring and damper side by side alone."""
        return True

    @property
    def surroundings(self) -> dict[str, JaxPerImpact]:
        """What an element's functions take beside its parameters: gravity, where there is any."""
        return {} if self.gravity is None else {GRAVITY: self.gravity}

    def velocity_error(self, errors: Float[Array, "impact 3"], key: Array) -> JaxPerImpact | None:
        """A draw of the error of the recorded velocity given those of the chain; None without a velocity."""
        if self.velocity_share is None:
            return None
        return part_of(-errors[:, 1], self.error_sd[:, 1], self.velocity_share, key)

    @property
    def errors(self) -> dict[str, str]:
        """What each column of ``error_sd`` is called in the posterior, and which link of the chain errs."""
        return {
            "level_error": "contact moment",
            "ramp_error": "velocity and gain",
            "offset_error": "offset",
        }

    def of_gain(self, log_gain: JaxPerImpact) -> Float[Array, "impact 3"]:
        """What a gain in error adds to the constant, the ramp and the parabola."""
        assert self.velocity is not None  # noqa: S101 - for the type checker
        gravity = jnp.zeros_like(log_gain) if self.gravity is None else self.gravity
        return -jnp.expm1(log_gain)[:, None] * jnp.stack([0 * gravity, self.velocity, gravity], axis=1)

    def with_traces(self, traces: PerSample) -> DisplacementRecord:
        """The record of other traces."""
        same = map(np.asarray, (self.n_samples, self.first_time, self.dt, self.error_sd))
        record = displacement_record(traces, *same)
        return self._replace(x=record.x, columns=record.columns, spread=record.spread)

    def impacts(self, rows: Int[np.ndarray, " row"]) -> DisplacementRecord:
        """The record of some impacts."""
        blocks = jax.tree.map(lambda part: np.asarray(part)[:, rows], (self.columns, self.spread))
        others: Any = {"columns": None, "spread": None}
        chosen = jax.tree.map(lambda part: np.asarray(part)[rows], self._replace(**others))
        return chosen._replace(columns=blocks[0], spread=blocks[1])

    def padded(self) -> DisplacementRecord:
        """With as many samples, 0 past a row's end, as a `bucket` holds; so are the frequencies already."""
        return self._replace(x=padded_zeros(self.x, 1))

    def with_normal_errors(self) -> DisplacementRecord:
        """The record itself, whose errors are normal."""
        return self


def displacement_record(
    x: PerSample,
    n_samples: IndexPerImpact,
    first_time: PerImpact,
    dt: PerImpact,
    error_sd: Float[np.ndarray, "impact 3"],
    gravity: PerImpact | None = None,
) -> DisplacementRecord:
    """Transform the traces and the errors' columns once, those of one length in one call.

    Arguments as the attributes of `DisplacementRecord`.

    Raises:
        ValueError: an impact has fewer than three samples or more than ``x`` is wide.
    """
    lengths = np.asarray(n_samples)
    x = np.where(np.arange(x.shape[1]) < lengths[:, None], x, 0.0)
    time = first_time[:, None] + np.arange(x.shape[1]) * dt[:, None]
    registers = bucket(-(-(x.shape[1] - 2) // FILLED))
    columns, spread = transformed(x, lengths, registers, np.ones_like(time), time, time**2)
    parts: Any = (x, lengths, first_time, dt, columns, spread, error_sd, gravity)
    return DisplacementRecord(*jax.tree.map(jnp.asarray, parts))


class MovingAverage(NamedTuple):
    """The noise of a transformed trace, over sigma: independent from frequency to frequency.

    Attributes:
        inside: where there is a frequency.
        eigenvalue: its variance.
    """

    inside: Bool[Array, " frequency"]
    eigenvalue: Float[Array, " frequency"]

    def whitened(self, parts: Float[Array, "*part frequency"]) -> Float[Array, "*part frequency"]:
        """T^-1/2 p."""
        return parts / jnp.sqrt(self.eigenvalue)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MeasuredDisplacement(MeasuredTraces):
    """The likelihood of displacement traces: ARMA(2,1) plus the measuring chain's linear errors.

    The density is that of x_3 ... x_n given x_1 and x_2 with the errors integrated out, from the stored
    transforms.

    Attributes:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        theta1: moving-average coefficient, or None: that of the sampled A(2) (thesis, section 2.11).
        log_sigma: log of the shocks' standard deviation [m].
        record: see `displacement_record`.
        log_gain: log of recorded over true deceleration; None where its error is among those of the chain.
    """

    omega_n: JaxPerImpact
    zeta: JaxPerImpact
    theta1: JaxPerImpact | None
    log_sigma: JaxPerImpact
    record: DisplacementRecord
    log_gain: JaxPerImpact | None = None

    @property
    def errors(self) -> Errors:
        """Constant, ramp and parabola."""
        return Errors(self.record.error_sd, jnp.zeros(len(self.record.dt), bool))

    def differences(self) -> tuple[Array, Array, Array]:
        """c1, c2 and theta1 of each impact."""
        c1, c2, sampled = to_differences(self.omega_n, self.zeta, self.record.dt)
        return c1, c2, sampled if self.theta1 is None else self.theta1

    def equilibrium(self) -> Array:
        """x_e = g / omega_n^2, the mean of the process [m]."""
        along = self.record.gravity
        return jnp.zeros_like(self.omega_n) if along is None else along / self.omega_n**2

    def _series(self, c1: Array, c2: Array) -> tuple[Float[Array, "block impact lane"], ...]:
        """Transforms of x''_t + c1 x'_{t-1} + c2 x_{t-2} and of 1, t and t^2 at t - 2."""
        bend, slope, level, *powers = self.record.columns
        return bend + c1[:, None] * slope + c2[:, None] * level, *powers

    def _mixture(self, c1: Array, c2: Array) -> list[list[Any]]:
        """How residual and errors are made of these series.

        Of w less gravity's constant c2 x_e and what a gain adds, and of what the constant, the ramp and half
        the parabola become: c2, c1 dt + c2 t, and dt^2 + c1 dt (t + dt / 2) + c2 t^2 / 2, all at t - 2.
        """
        dt = self.record.dt
        ramp, parabola = [c1 * dt, c2], [dt**2 * (1 + c1 / 2), c1 * dt, c2 / 2]
        residual: list[Any] = [1.0, -c2 * self.equilibrium()]
        if self.log_gain is not None:
            _, r, q = self.record.of_gain(self.log_gain).T
            of_ones, of_t = residual[1] - r * ramp[0] - q * parabola[0], -r * ramp[1] - q * parabola[1]
            residual = [1.0, of_ones, of_t, -q * parabola[2]]
        return [residual, [0.0, c2], [0.0, *ramp], [0.0, *parabola]]

    def products(self) -> Products:
        """From those of the series, in one pass over frequencies."""
        c1, c2, theta1 = self.differences()
        series, weight = self._series(c1, c2), 1 / eigenvalues(theta1[:, None], self.record.spread)
        over = [part * weight for part in series]
        entries = sums_over_frequencies(tuple(over[a] * series[b] for a in range(4) for b in range(a + 1)))
        plain, mixture = from_lower_entries(entries), self._mixture(c1, c2)
        half = small.product(mixture, plain)
        gram = small.symmetric(4, lambda a, b: small.dot(mixture[b], half[a]))
        count = self.record.n_samples - 2.0
        return Products.of_unit_noise(gram, log_determinant(theta1, count), count, self.log_sigma)

    def channels(self) -> list[SensorTrace[MovingAverage]]:
        """The transformed traces."""
        c1, c2, theta1 = self.differences()

        def by_frequency(part: Array) -> Array:
            return part.swapaxes(1, 2).reshape(-1, part.shape[1])

        series = [by_frequency(part) for part in self._series(c1, c2)]
        rows = jnp.stack([small.dot(row, series) for row in self._mixture(c1, c2)])
        residual, *columns = rows.swapaxes(1, 2)[:, :, None]
        eigenvalue = by_frequency(eigenvalues(theta1[:, None], self.record.spread)).T
        inside = jnp.arange(eigenvalue.shape[1]) < self.record.n_samples[:, None] - 2
        noise = MovingAverage(inside, eigenvalue)
        return [SensorTrace(residual, jnp.stack(columns, axis=2), self.log_sigma, noise)]

    def _drawn(self, key: Array) -> JaxPerSample:
        """Traces from the record's first two values on: the recursion, then the chain's errors."""
        key_of_x, key_of_errors = jax.random.split(key)
        record = self.record
        c1, c2, theta1 = self.differences()
        count, width = record.x.shape
        errors = self.prior_errors(key_of_errors)
        if self.log_gain is not None:
            errors = errors + record.of_gain(self.log_gain)
        time = record.first_time[:, None] + jnp.arange(width) * record.dt[:, None]
        e0, e1, e2 = errors.T[..., None]
        added = e0 + e1 * time + e2 * time**2 / 2 + self.equilibrium()[:, None]
        shocks = jnp.exp(self.log_sigma) * jax.random.normal(key_of_x, (width + 1, count))
        clean = arma21_series(record.x[:, :2] - added[:, :2], shocks[2:], c1, c2, theta1)
        inside = jnp.arange(width) < record.n_samples[:, None]
        return jnp.where(inside, clean + added, 0.0)

    def noise_quantities(self) -> dict[str, JaxPerImpact]:
        """What the noise of each trace is, by the names that posteriors have."""
        return {"sigma_a": jnp.exp(self.log_sigma), "theta1": self.differences()[2]}

    def replicate(self, key: Array) -> dict[str, JaxPerSample]:
        """A replicate of every trace, as displacement [m] and as deceleration [m/s^2]; NaN past its end.

        Along gravity the deceleration is force over mass, as recorded ones are.
        """
        record, trace = self.record, self._drawn(key)
        fall = 0.0 if record.gravity is None else record.gravity[:, None]
        bend = fall - jnp.diff(trace, n=2, axis=1) / record.dt[:, None] ** 2
        edges = jnp.pad(bend, ((0, 0), (1, 1)), constant_values=jnp.nan)
        left = record.n_samples[:, None] - jnp.arange(trace.shape[1])
        return {
            "displacement": jnp.where(left > 0, trace, jnp.nan),
            "deceleration": jnp.where(left > 1, edges, jnp.nan),
        }
