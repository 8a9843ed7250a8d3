"""Distributions of a whole impact for numpyro: one event an impact, to sample from and to score."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float
from numpyro.distributions import Distribution, constraints

from bayestissue.likelihood.arma.arma21 import Start, log_likelihood, masked_log_likelihood
from bayestissue.likelihood.transforms import SineTransforms
from bayestissue.oscillator import to_differences
from bayestissue.oscillator.processes import start_moments

Triple = tuple[Array, Array, Array]


class ARMA21(Distribution):
    """The displacement of one impact as an ARMA(2,1), in the differences c1 = 2 - phi1, c2 = 1 - phi1 - phi2.

    The event is the whole displacement trace. With ``start="free"`` its first two values are given and
    count nothing in the density. Passing the transforms of the observed traces as ``data`` and
    ``data.x`` as the observation makes each evaluation one pass over numbers made beforehand; any other
    value is scored by a filter.

    Args:
        c1: 2 - phi1.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient.
        sigma_a: standard deviation of the shocks [m].
        first: x_1 and x_2 on a last axis of two [m]; used by the free start only.
        n_samples: samples of each impact; those after are zero in samples, and not looked at.
        width: number of samples of the event, the longest impact's.
        data: sine transforms of the observed displacements.
        start: "free" or "stationary".
    """

    arg_constraints = {  # noqa: RUF012
        "c1": constraints.real,
        "c2": constraints.real,
        "theta1": constraints.real,
        "sigma_a": constraints.positive,
    }
    support = constraints.real_vector
    pytree_data_fields = ("c1", "c2", "theta1", "sigma_a", "first", "n_samples", "data")
    pytree_aux_fields = ("start",)

    def __init__(
        self,
        c1: ArrayLike,
        c2: ArrayLike,
        theta1: ArrayLike,
        sigma_a: ArrayLike,
        *,
        first: ArrayLike | None = None,
        n_samples: ArrayLike | None = None,
        width: int | None = None,
        data: SineTransforms | None = None,
        start: Start = "free",
        validate_args: bool | None = None,
    ) -> None:
        if data is not None:
            first, n_samples, width = data.x[:, :2], data.size + 2, data.x.shape[1]
        if width is None:
            raise ValueError("ARMA21 needs either data or a width")
        head = jnp.zeros(2) if first is None else jnp.asarray(first, float)
        lengths = jnp.asarray(width if n_samples is None else n_samples)
        values = jnp.broadcast_arrays(
            *(jnp.asarray(v, float) for v in (c1, c2, theta1, sigma_a)), head[..., 0], lengths
        )
        self.c1, self.c2, self.theta1, self.sigma_a, _, self.n_samples = values
        self.first = jnp.broadcast_to(head, (*self.c1.shape, 2))
        self.data, self.start = data, start
        super().__init__(self.c1.shape, (width,), validate_args=validate_args)

    @classmethod
    def sampled_a2(
        cls, omega_n: ArrayLike, zeta: ArrayLike, dt: ArrayLike, sigma_a: ArrayLike, **options: Any
    ) -> ARMA21:
        """The ARMA(2,1) of a sampled A(2): theta1 follows from the oscillator (thesis, section 2.11).

        Args:
            omega_n: natural frequency [rad/s].
            zeta: damping ratio.
            dt: sampling interval [s].
            sigma_a: standard deviation of the shocks [m].
            **options: as for the class.
        """
        c1, c2, theta1 = to_differences(omega_n, zeta, dt)
        return cls(c1, c2, theta1, sigma_a, **options)

    def log_prob(self, value: Float[Array, "*batch sample"]) -> Array:
        """The exact log density of each impact, see `bayestissue.likelihood.log_likelihood`."""
        parameters = (self.c1, self.c2, self.theta1, self.sigma_a)
        if self.data is not None and value is self.data.x:
            return log_likelihood(self.data, *parameters, start=self.start)
        return masked_log_likelihood(value, self.n_samples, *parameters, start=self.start)

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw displacement traces by running the recursion from the start.

        Args:
            key: a JAX random key.
            sample_shape: shape of independent draws, put first.
        """
        shape, width = (*sample_shape, *self.batch_shape), self.event_shape[0]
        shocks = self.sigma_a * jax.random.normal(key, (width + 1, *shape))
        x1, x2 = self._first_two(shocks)

        def step(carry: Triple, shock: Array) -> tuple[Triple, Array]:
            before, now, last_shock = carry
            slope = now - before
            w = shock - self.theta1 * last_shock
            after = now + slope - self.c1 * slope - self.c2 * before + w
            return (now, after, shock), after

        _, later = jax.lax.scan(step, (x1, x2, shocks[2]), shocks[3:])
        x = jnp.moveaxis(jnp.concatenate([x1[None], x2[None], later]), 0, -1)
        return jnp.where(jnp.arange(width) < self.n_samples[..., None], x, 0.0)

    def _first_two(self, shocks: Array) -> tuple[Array, Array]:
        if self.start == "free":
            return tuple(jnp.broadcast_to(self.first[..., i], shocks.shape[1:]) for i in (0, 1))  # type: ignore[return-value]
        gamma0, drop = start_moments(self.c1, self.c2, self.theta1, self.sigma_a)
        x1 = jnp.sqrt(gamma0) * shocks[0] / self.sigma_a
        # given a_2 and x_1, what is left of x_2 - x_1
        spare = jnp.sqrt(2 * drop - self.sigma_a**2 - drop**2 / gamma0)
        return x1, x1 + shocks[2] - drop / gamma0 * x1 + spare * shocks[1] / self.sigma_a
