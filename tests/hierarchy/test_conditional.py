from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from dense_normal import SIZE, Dense
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from bayestissue.hierarchy.gaussian.conditional import (
    effects_from_standard,
    impact_parameters,
    log_evidence_of,
)
from bayestissue.hierarchy.population import (
    expected,
)


def test_evidence_is_the_dense_integral(dense: Dense) -> None:
    noise = dense.blocks(dense.inverses + dense.covariance)
    whole = noise + dense.X @ dense.of_b @ dense.X.T
    direct = multivariate_normal(dense.X @ dense.mean, whole).logpdf(dense.seen.ravel())
    assert_allclose(dense.conditional().log_evidence, direct + dense.constants.sum(), rtol=1e-10)


def test_b_has_its_dense_conditional_mean_and_covariance(dense: Dense) -> None:
    noise = np.linalg.inv(dense.blocks(dense.inverses + dense.covariance))
    precision = dense.X.T @ noise @ dense.X + np.linalg.inv(dense.of_b)
    mean = dense.mean + np.linalg.solve(
        precision, dense.X.T @ noise @ (dense.seen.ravel() - dense.X @ dense.mean)
    )
    found = dense.conditional()
    size = len(mean)
    assert_allclose(effects_from_standard(found, jnp.zeros(size)), mean, rtol=1e-9, atol=1e-10)
    # The map is affine: its slope times its transpose is the covariance.
    root = np.asarray(jax.jacfwd(lambda z: effects_from_standard(found, z))(jnp.zeros(size)))
    assert_allclose(root @ root.T, np.linalg.inv(precision), rtol=1e-8, atol=1e-10)


def test_each_impacts_parameters_have_their_dense_conditional(dense: Dense) -> None:
    found = dense.conditional()
    b = dense.mean + dense.sd * dense.rng.normal(size=len(dense.mean))
    about = expected(dense.design, jnp.asarray(b))
    prior = np.linalg.inv(dense.covariance)
    precision = np.asarray(dense.summaries.precision)
    left = np.linalg.inv(precision + prior)
    pulled = np.einsum("iab,ib->ia", precision, dense.seen) + np.stack(about, axis=1) @ prior
    mean = np.einsum("iab,ib->ia", left, pulled)

    def parameters(z: jax.Array) -> jax.Array:
        return jnp.stack(impact_parameters(found, dense.summaries, about, z), axis=1)

    start = jnp.zeros((dense.number, SIZE))
    assert_allclose(parameters(start), mean, rtol=1e-9, atol=1e-10)
    root = np.asarray(jax.jacfwd(parameters)(start)).reshape(dense.number * SIZE, -1)
    assert_allclose(root @ root.T, dense.blocks(left), rtol=1e-8, atol=1e-10)


def test_each_traces_evidence_is_the_dense_integral(dense: Dense) -> None:
    b = dense.mean + dense.sd * dense.rng.normal(size=len(dense.mean))
    about = expected(dense.design, jnp.asarray(b))
    direct = [
        multivariate_normal(np.stack(about, axis=1)[i], dense.inverses[i] + dense.covariance).logpdf(
            dense.seen[i]
        )
        for i in range(dense.number)
    ]
    found = log_evidence_of(dense.conditional().parts, dense.summaries, about)
    assert_allclose(found, direct + dense.constants, rtol=1e-10)


def test_a_summary_is_a_parabola_about_its_centre(dense: Dense) -> None:
    away = dense.rng.normal(size=(dense.number, SIZE))
    u = np.asarray(dense.summaries.centre) + away
    direct = (
        np.asarray(dense.summaries.log_likelihood)
        + (away * np.asarray(dense.summaries.slope)).sum(1)
        - np.einsum("ia,iab,ib->i", away, np.asarray(dense.summaries.precision), away) / 2
    )
    assert_allclose(
        dense.summaries.log_summary([jnp.asarray(u[:, a]) for a in range(SIZE)]), direct, rtol=1e-11
    )
