"""A trace is channels, what each sensor recorded of one impact: y = f(u) + A e + noise of the same errors e.

f is what the impact of parameters u makes, A what a unit of each error adds: those of the measuring chain
and, where there is one, the weights of a discrepancy's modes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerParameter
from bayestissue.model.likelihood.linear_errors import Errors, Products, draw_errors, marginal_log_likelihood


class Noise(Protocol):
    """A noise's covariance over sigma^2, T, of one impact; with impacts along all first axes of many."""

    @property
    def inside(self) -> Bool[Array, " row"]:
        """Where there is a sample."""

    def whitened(self, parts: Float[Array, "*part row"]) -> Float[Array, "*part row"]:
        """T^-1/2 of rows, 0 where there is no sample."""


class SensorTrace[N: Noise](NamedTuple):
    """What one sensor recorded, for contact in each cell; of a known contact one cell.

    Attributes:
        residual: y - f.
        columns: A.
        log_sigma: log of the noise's standard deviation.
        noise: of every impact, on every ``stride``-th row.
        stride: how many rows lie from one that is asked to the next.
    """

    residual: Float[Array, "impact cell row"]
    columns: Float[Array, "impact cell error row"]
    log_sigma: JaxPerImpact
    noise: N
    stride: int = 1

    def parts(self) -> Float[Array, "impact cell part row"]:
        """Residual and columns."""
        return jnp.concatenate([self.residual[:, :, None], self.columns], axis=2)

    def left(self, errors: Float[Array, "impact error"]) -> Float[Array, "impact row"]:
        """What such errors leave of the residual; contact is known."""
        return self.residual[:, 0] - jnp.einsum("ie,ier->ir", errors, self.columns[:, 0])

    def replicate(
        self,
        recorded: Float[Array, "impact row"],
        errors: Float[Array, "impact error"],
        shocks: Float[Array, "impact row"],
    ) -> Float[Array, "impact row"]:
        """Y as such errors and noise, over sigma, would have made it; contact is known."""
        return recorded - self.left(errors) + jnp.exp(self.log_sigma)[:, None] * shocks

    def over_noise(
        self, rows: Float[Array, "impact cell part row"]
    ) -> Float[Array, "impact cell part shock"]:
        """T^-1/2 of such rows."""
        samples = jnp.where(self.noise.inside[:, None, None], rows[..., :: self.stride], 0.0)
        white: Array = jax.vmap(lambda noise, rows: noise.whitened(rows))(self.noise, samples)
        return white


class Whitened(NamedTuple):
    """The channels side by side, in units of their noise.

    Attributes:
        left: what the impact leaves of the traces.
        slopes: what a unit of each of its parameters adds.
        shared: what one standard deviation of each error adds.
        inside: where there is a sample.
    """

    left: Float[Array, "impact shock"]
    slopes: Float[Array, "impact parameter shock"]
    shared: Float[Array, "impact error shock"]
    inside: Bool[Array, "impact shock"]


def whitened(
    traces_of: Callable[[Array], MeasuredTraces], u: JaxPerParameter, which: slice = slice(None)
) -> Whitened:
    """The channels of the traces at u, or ``which`` of them; contact is known."""
    traces, size = traces_of(u), u.shape[1]
    channels = traces.channels()[which]

    def residuals(u: Array) -> list[Array]:
        return [channel.residual for channel in traces_of(u).channels()[which]]

    def along(direction: Array) -> list[Array]:
        """What a step along one parameter takes off every residual."""
        _, changes = jax.jvp(residuals, (u,), (jnp.broadcast_to(direction, u.shape),))
        return [-change for change in changes]

    rows = []
    for channel, slopes in zip(channels, jax.vmap(along, out_axes=2)(jnp.eye(size)), strict=True):
        parts = jnp.concatenate([channel.parts(), slopes], axis=2)
        rows.append(channel.over_noise(parts)[:, 0] / jnp.exp(channel.log_sigma)[:, None, None])
    white = jnp.concatenate(rows, axis=-1)
    inside = jnp.concatenate([channel.noise.inside for channel in channels], axis=-1)
    shared = white[:, 1:-size] * traces.errors.sd[..., None]
    return Whitened(white[:, 0], white[:, -size:], shared, inside)


class MeasuredTraces(Protocol):
    """The likelihood of every impact's channels, the errors that they share integrated out."""

    @property
    def errors(self) -> Errors:
        """What is known of the errors beforehand."""

    def channels(self) -> list[SensorTrace[Any]]:
        """The traces; contact is known."""

    def products(self) -> Products:
        """Of residuals and error columns, over all channels."""

    def log_density(self) -> JaxPerImpact:
        """Log density of each recorded trace, its errors integrated out."""
        return marginal_log_likelihood(self.products(), self.errors)

    def draw_errors(self, key: Array) -> Float[Array, "impact error"]:
        """The errors given the recorded traces."""
        return draw_errors(key, self.products(), self.errors)

    def prior_errors(self, key: Array) -> Float[Array, "impact error"]:
        """The errors before any trace is seen; contact is known."""
        return self.errors.drawn(key)
