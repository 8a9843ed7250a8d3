"""One-step prediction errors of an MA(1): residuals, and densities of impacts of any length."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

Pair = tuple[Array, Array]


def innovations(
    w: Float[Array, "*batch sample"], theta1: Float[Array, "*batch"], valid: Bool[Array, "*batch sample"]
) -> tuple[Float[Array, "*batch sample"], Float[Array, "*batch sample"]]:
    """v_t = w_t + theta1 v_{t-1} / r_{t-1} with r_t = 1 + theta1^2 - theta1^2 / r_{t-1}.

    r_1 is 1 + theta1^2.
    v_t / sqrt(r_t) are the shocks as far as the past tells them: white with variance sigma_a^2, also at
    |theta1| = 1 (Brockwell & Davis 1991, section 5.2).

    Args:
        w: the MA(1), w_t = a_t - theta1 a_{t-1}.
        theta1: moving-average coefficient.
        valid: which values count; the valid ones of a series must be neighbours. Where not valid, v = 0
            and r = 1.

    Returns:
        v and r.
    """
    square = theta1**2

    def step(
        carry: tuple[Array, Array], part: tuple[Array, Array]
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        error_over, one_over = carry
        value, counts = part
        r = jnp.where(counts, 1 + square * (1 - one_over), 1.0)
        v = jnp.where(counts, value + theta1 * error_over, 0.0)
        return (v / r, jnp.where(counts, 1 / r, 0.0)), (v, r)

    start = (jnp.zeros_like(w[..., 0]), jnp.zeros_like(w[..., 0]))
    _, (v, r) = jax.lax.scan(step, start, (jnp.moveaxis(w, -1, 0), jnp.moveaxis(valid, -1, 0)))
    return jnp.moveaxis(v, 0, -1), jnp.moveaxis(r, 0, -1)
