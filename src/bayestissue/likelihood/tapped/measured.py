"""The ringing of a mass on spring and damper after a tap whose force was recorded.

A mass m rests on the tissue and is tapped: m x'' + C x' + K x = F(t), x = x' = 0 before. F is 0 but from 0 to
T, while the hammer touches it. What has come of the tap by then,

    v_T = int_0^T F / m h'(T - s) ds,    x_T = int_0^T F / m h(T - s) ds,

h being the answer to a unit impulse, rings on freely, with the deceleration

    d(t) = -x'' = v_T D(t - T) + x_T omega_n^2 h'(t - T),   D = 2 zeta omega_n h' + omega_n^2 h.

Its samples are d, the error of the zero and noise ~ N(0, sigma^2). A row y_k is the mean of N of them, which
are enough of a period for what is left to be as good. With an interval of dt between samples the mean of d
is, but for terms of fourth order in dt,

    (V(t') - V(t) - dt^2 / 24 (d'(t') - d'(t))) / (N dt),   V = -x',

t and t' = t + N dt being half an interval before the first and after the last of them.

What tells K / m and C / m is how the mass rings; how high it rings tells m. With the recorded mass M in the
place of m, and both sensors' gains in error, all of y is e^-a times as high: a is the log of the recorded
force over recorded mass times recorded acceleration, which is that of m / M and of the hammer's gain less
the accelerometer's. K and C at the mass M are to be multiplied by m / M.

The integrals are sums over the force's own samples, which err where the pulse is short of samples. That, the
noise of the force and the error of its zero are one error of the impulse, as a velocity at the middle of the
tap. It, the error of the zero and what one clock is behind the other are normal and are integrated out
(`bayestissue.likelihood.linear_errors`). A tap is counted from its first sample above noise.

Samples from before T are not used: what a sensor reads under the hammer is the blow as well as the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.likelihood.linear_errors import (
    Products,
    draw_errors,
    marginal_log_likelihood,
    prior_errors,
)
from bayestissue.oscillator import impact_motion
from bayestissue.padding import padded_zeros

IMPULSE, ZERO, CLOCK = range(3)


class TapRecord(NamedTuple):
    """What the likelihood reads of taps.

    Attributes:
        y: decelerations once the hammer is off, means of samples, 0 past a row's end [m/s^2].
        n_samples: length of each.
        first_time: from the beginning of the tap to the middle of the first of them [s].
        dt: their interval [s].
        averaged: how many samples each is the mean of.
        end: from there until the hammer is off, T [s].
        push: what each sample of the force adds to the velocity of a free mass, of the recorded one, the last
            first [m/s]; 0 where there is none.
        dt_force: their sampling interval [s].
        middle: from the beginning of the tap to the mean time of its impulse [s].
        error_sd: standard deviations of the impulse over the recorded mass [m/s], of the zero [m/s^2] and of
            what the deceleration's clock is behind the force's [s].
        surroundings: nothing that an element's functions would take.
        common_depth: one depth that every impact reaches [m]; no part of the likelihood.
    """

    y: Float[Array, "impact row"]
    n_samples: Int[Array, " impact"]
    first_time: Float[Array, " impact"]
    dt: Float[Array, " impact"]
    averaged: Float[Array, " impact"]
    end: Float[Array, " impact"]
    push: Float[Array, "impact push"]
    dt_force: Float[Array, " impact"]
    middle: Float[Array, " impact"]
    error_sd: Float[Array, "impact 3"]
    surroundings: dict[str, Float[Array, " impact"]]
    common_depth: Float[Array, " impact"]

    @property
    def traces(self) -> Float[Array, "impact row"]:
        """The recorded decelerations."""
        return self.y

    @property
    def side_by_side(self) -> bool:
        """Whether nothing in it speaks against a spring and damper side by side alone."""
        return True

    @property
    def velocity(self) -> None:
        """Of no mass that arrives with one."""
        return

    @property
    def errors(self) -> dict[str, str]:
        """What each column of ``error_sd`` is called in the posterior, and which link of the chain errs."""
        return {
            "impulse_error": "hammer's noise and samples",
            "offset_error": "offset",
            "clock_error": "clocks",
        }

    def inside(self) -> Bool[Array, "impact row"]:
        """True where there is a sample."""
        return jnp.arange(self.y.shape[1]) < self.n_samples[:, None]

    def velocity_error(self, errors: Float[Array, "impact 3"], key: Array) -> None:
        """No velocity is recorded."""
        del errors, key

    def with_traces(
        self, traces: Float[np.ndarray, "impact row"], n_samples: Int[np.ndarray, " impact"]
    ) -> TapRecord:
        """The record of other decelerations, or of fewer of their samples."""
        traces = np.asarray(traces)
        inside = np.arange(traces.shape[1]) < np.asarray(n_samples)[:, None]
        return self._replace(y=jnp.where(inside, traces, 0.0), n_samples=jnp.asarray(n_samples))

    def impacts(self, rows: Int[np.ndarray, " row"]) -> TapRecord:
        """The record of some impacts."""
        chosen: TapRecord = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], self)
        return chosen

    def padded(self) -> TapRecord:
        """With as many samples, 0 past a row's end, as a `bucket` holds."""
        return self._replace(**{name: padded_zeros(getattr(self, name), 1) for name in ("y", "push")})

    def with_normal_errors(self) -> TapRecord:
        """The record itself, whose errors are normal."""
        return self


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["omega_n", "zeta", "log_sigma", "log_ratio", "record"],
    meta_fields=[],
)
@dataclass(frozen=True)
class MeasuredTap:
    """The likelihood of the ringing after taps, the chain's errors integrated out.

    Attributes:
        omega_n: natural frequency (K / m)^1/2 [rad/s].
        zeta: damping ratio.
        log_sigma: log of the standard deviation of the noise [m/s^2].
        log_ratio: a, log of the recorded force over recorded mass times recorded acceleration.
        record: the recordings.
    """

    omega_n: Float[Array, " impact"]
    zeta: Float[Array, " impact"]
    log_sigma: Float[Array, " impact"]
    log_ratio: Float[Array, " impact"]
    record: TapRecord

    @property
    def log_scatter(self) -> Float[Array, " impact"]:
        """Log of the standard deviation of a mean of samples [m/s^2]."""
        return self.log_sigma - jnp.log(self.record.averaged) / 2

    @property
    def scatter(self) -> Float[Array, " impact"]:
        """Standard deviation of a mean of samples [m/s^2]."""
        return jnp.exp(self.log_scatter)

    def _after(self, time: Float[Array, " impact"]) -> tuple[Array, Array]:
        """The answer h to a unit impulse and its rate h', at one time since it, of each impact."""
        motion = impact_motion(time, self.omega_n, self.zeta, 1.0)
        return motion.displacement, motion.velocity

    def _free(
        self, depth: Float[Array, "*what impact"], velocity: Array, step: Float[Array, " impact"], count: int
    ) -> tuple[Float[Array, "*what impact step"], Float[Array, "*what impact step"]]:
        """Depth and velocity after 0, 1, 2 and so many steps of a free motion.

        With the matrix that goes one step further, its square those that go two, and so on: an exponential
        and a sine of each time would take several times as long.
        """
        h, slope = self._after(step)
        along = slope + 2 * self.zeta * self.omega_n * h, h, -(self.omega_n**2) * h, slope
        x, v = depth[..., None], velocity[..., None]
        while x.shape[-1] < count:
            a, b, c, d = (entry[:, None] for entry in along)
            x, v = jnp.concatenate([x, a * x + b * v], -1), jnp.concatenate([v, c * x + d * v], -1)
            a, b, c, d = along
            along = a * a + b * c, b * (a + d), c * (a + d), b * c + d * d
        return x[..., :count], v[..., :count]

    def parts(
        self, late: Float[Array, " impact"] | float = 0.0
    ) -> tuple[Float[Array, "impact row"], Float[Array, "error impact row"]]:
        """The decelerations without noise and errors, and what a unit of each error adds to them.

        ``late`` is a clock's delay [s]. Both come of the same motions: XLA would make them twice.
        """
        record, none = self.record, jnp.zeros_like(self.log_ratio)
        h, slope = self._free(none, none + 1, record.dt_force, record.push.shape[1])
        of_force = (h * record.push).sum(1), (slope * record.push).sum(1)
        depth, velocity = map(jnp.stack, zip(of_force, self._after(record.end - record.middle), strict=True))
        # To half an interval of the samples before the first.
        h, slope = self._after(record.first_time - record.end - late - record.dt / 2)
        squared, damping = self.omega_n**2, 2 * self.zeta * self.omega_n
        begins = (slope + damping * h) * depth + h * velocity, slope * velocity - squared * h * depth
        x, v = self._free(*begins, record.dt, record.y.shape[1] + 1)
        squared, damping, dt = squared[:, None], damping[:, None], record.dt[:, None]
        d = damping * v + squared * x
        bends = (dt / record.averaged[:, None]) ** 2 / 24 * (squared * v - damping * d)

        def means(values: Array) -> Array:
            lower = jnp.exp(-self.log_ratio)[:, None]
            return jnp.where(record.inside(), lower * jnp.diff(values) / dt, 0.0)

        expected, of_impulse = means(-v - bends)
        columns = jnp.stack([of_impulse, record.inside() * 1.0, means(-d[0])])
        return expected, columns

    def expected(self, late: Float[Array, " impact"] | float = 0.0) -> Float[Array, "impact row"]:
        """The first of `parts` [m/s^2]."""
        return self.parts(late)[0]

    def columns(self) -> Float[Array, "error impact row"]:
        """The second of `parts`."""
        return self.parts()[1]

    def products(self) -> Products:
        """Of what the expected decelerations leave over, and of the errors' columns."""
        expected, columns = self.parts()
        rows = [self.record.y - expected, *columns]
        gram = [[(one * other).sum(1) for other in rows] for one in rows]
        count = self.record.n_samples.astype(float)
        return Products(gram, jnp.zeros_like(self.log_sigma), count)

    def log_density(self) -> Float[Array, " impact"]:
        """Log density of each recording, the chain's errors integrated out."""
        density = marginal_log_likelihood(self.products(), self.log_scatter, self.record.error_sd)
        return jnp.where(jnp.isfinite(density), density, -jnp.inf)

    def draw_errors(self, key: Array) -> Float[Array, "impact 3"]:
        """The chain's errors given the recordings."""
        return draw_errors(key, self.products(), self.log_scatter, self.record.error_sd)

    def prior_errors(self, key: Array) -> Float[Array, "impact 3"]:
        """The same before anything is recorded."""
        return prior_errors(key, (len(self.log_sigma),), self.record.error_sd)

    def residuals(self, errors: Float[Array, "impact 3"]) -> Float[Array, "impact row"]:
        """What these errors and the ringing leave of the recordings [m/s^2], 0 past a row's end."""
        expected, columns = self.parts()
        return self.record.y - expected - jnp.einsum("ie,eir->ir", errors, columns)

    def standardised(self) -> tuple[Float[Array, "impact row"], Float[Array, "impact row error"]]:
        """What is left of all samples, and what a standard deviation of each error adds, over the noise."""
        expected, columns = self.parts()
        left = (self.record.y - expected) / self.scatter[:, None]
        scaled = jnp.moveaxis(columns, 0, -1) * self.record.error_sd[:, None]
        return left, scaled / self.scatter[:, None, None]

    def slopes(self) -> Float[Array, "impact row parameter"]:
        """What a unit of log K, of log C and of a adds to all samples, over the noise."""

        def moved(logs: Float[Array, "parameter impact"]) -> Array:
            omega_n = self.omega_n * jnp.exp(logs[0] / 2)
            zeta = self.zeta * jnp.exp(logs[1] - logs[0] / 2)
            return MeasuredTap(
                omega_n, zeta, self.log_sigma, self.log_ratio + logs[2], self.record
            ).expected()

        _, along = jax.linearize(moved, jnp.zeros((3, len(self.log_sigma))))
        units = jnp.broadcast_to(jnp.eye(3)[..., None], (3, 3, len(self.log_sigma)))
        return jax.vmap(along, out_axes=-1)(units) / self.scatter[:, None, None]

    def sample(self, key: Array) -> Float[Array, "impact row"]:
        """Draw decelerations: the ringing, the chain's errors and noise."""
        key_of_noise, key_of_errors = jax.random.split(key)
        return self._with_errors(self.prior_errors(key_of_errors), key_of_noise)

    def replicate(self, key: Array) -> dict[str, Float[Array, "impact row"]]:
        """A replicate of every recording, with its own errors and new noise [m/s^2]; NaN past its end.

        Other errors of the impulse would make it ring higher by many times the noise, as a has it already.
        """
        key_of_noise, key_of_errors = jax.random.split(key)
        drawn = self._with_errors(self.draw_errors(key_of_errors), key_of_noise)
        return {"deceleration": jnp.where(self.record.inside(), drawn, jnp.nan)}

    def _with_errors(self, errors: Float[Array, "impact 3"], key: Array) -> Float[Array, "impact row"]:
        drawn = self.record.y - self.residuals(errors)
        drawn += self.scatter[:, None] * jax.random.normal(key, drawn.shape)
        return jnp.where(self.record.inside(), drawn, 0.0)

    def noise_quantities(self) -> dict[str, Float[Array, " impact"]]:
        """What the noise of each recording is, by the names that posteriors have."""
        return {"sigma_d": jnp.exp(self.log_sigma)}
