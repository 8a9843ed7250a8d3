"""The evidence with derivatives in closed form, beside the one whose every operation has its own."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bayestissue.hierarchy.gaussian.log_evidence import log_evidence
from dense_normal import Dense
from jax.flatten_util import ravel_pytree
from numpy.testing import assert_allclose

from bayestissue.hierarchy.gaussian.conditional import integrate_out


@pytest.mark.parametrize("scale", [1.0, 1e-4, 1e3])
@pytest.mark.parametrize("open_last", [False, True])
def test_value_and_slope_are_those_of_the_conditional(dense: Dense, scale: float, open_last: bool) -> None:
    mean, summaries = jnp.asarray(dense.mean), dense.summaries
    if open_last:
        summaries = summaries._replace(
            slope=summaries.slope.at[:, -1].set(0.0),
            precision=summaries.precision.at[:, -1].set(0.0).at[:, :, -1].set(0.0),
        )
    own = (dense.spread.own, dense.spread.nuisance, dense.spread.locations)
    flat, unravel = ravel_pytree(own)
    # Standard deviations of impacts far below and above what traces tell; variances go with their square.
    flat = flat * jnp.concatenate([jnp.full(3, scale**2), jnp.full(2, scale), jnp.ones(len(flat) - 5)])

    def of(flat: jax.Array) -> tuple[jax.Array, jax.Array]:
        kk_kc_cc, nuisance, locations = unravel(flat)
        spread = dense.spread._replace(own=kk_kc_cc, nuisance=nuisance, locations=locations)
        return (
            integrate_out(dense.design, spread, mean, summaries).log_evidence,
            log_evidence(dense.design, spread, mean, summaries),
        )

    known, found = of(flat)
    assert float(found) == pytest.approx(float(known), rel=1e-10)
    of_known, of_found = (jax.grad(lambda x, k=k: of(x)[k])(flat) for k in (0, 1))
    # By logs, as chains move; the terms that cancel in a slope are about as many as there are impacts.
    relative = np.asarray(flat) * np.asarray(of_known)
    assert_allclose(np.asarray(flat) * np.asarray(of_found), relative, rtol=1e-7, atol=1e-7)


def test_it_maps_over_many_spreads(dense: Dense) -> None:
    scales = jnp.array([0.5, 1.0, 2.0])

    def of(scale: jax.Array) -> jax.Array:
        spread = dense.spread._replace(locations=scale * dense.spread.locations)
        return log_evidence(dense.design, spread, jnp.asarray(dense.mean), dense.summaries)

    together = jax.vmap(jax.grad(of))(scales)
    assert_allclose(together, [jax.grad(of)(scale) for scale in scales], rtol=1e-12)
