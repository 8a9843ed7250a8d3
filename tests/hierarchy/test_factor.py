"""Each impact's parameters, integrated out or drawn, against a dense normal of each."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_normal import SIZE, Dense
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from bayestissue.model.hierarchy.gaussian.factor import Conditional, GaussianFactor, cell_factors
from bayestissue.model.likelihood.small import stacked


@pytest.fixture(scope="module")
def dense() -> Dense:
    return Dense("people", 2)


def conditional(dense: Dense, of_u: np.ndarray) -> Conditional:
    return Conditional(np.linalg.inv(of_u), GaussianFactor(*map(np.asarray, dense.sites)).batch_last())


def test_u_has_its_dense_conditional(dense: Dense) -> None:
    about = np.random.default_rng(1).normal(size=(SIZE, dense.number))
    found, prior = conditional(dense, dense.of_u), np.linalg.inv(dense.of_u)
    precision = np.asarray(dense.sites.precision)
    left = np.linalg.inv(precision + prior)
    pulled = np.einsum("iab,ib->ia", precision, dense.seen) + about.T @ prior
    mean = found.draw(about, np.zeros(about.shape))
    assert_allclose(np.transpose(mean), np.einsum("iab,ib->ia", left, pulled), rtol=1e-9, atol=1e-10)
    unit = np.broadcast_to(np.eye(SIZE)[..., None], (SIZE, SIZE, dense.number))
    root = np.stack([np.subtract(found.draw(about, unit[:, a]), mean) for a in range(SIZE)], axis=1)
    assert_allclose(np.einsum("aki,bki->iab", root, root), left, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("scale", [1.0, 1e-4, 1e3])
def test_a_site_with_u_integrated_out_is_the_dense_integral(dense: Dense, scale: float) -> None:
    """Standard deviations of impacts far below and above what traces tell included."""
    about = np.random.default_rng(1).normal(size=(SIZE, dense.number))
    of_u = scale**2 * dense.of_u
    found, whole = conditional(dense, of_u), dense.inverses + of_u
    direct = [multivariate_normal(about[:, i], whole[i]).logpdf(dense.seen[i]) for i in range(dense.number)]
    assert_allclose(found.marginal(about).log_scale, direct + dense.constants, rtol=1e-10)
    weight = np.linalg.inv(whole)
    assert_allclose(
        np.moveaxis(stacked(found.marginal(about).precision), -1, 0),
        weight,
        rtol=1e-8,
        atol=1e-10 * np.abs(weight).max(),
    )
    pull = np.einsum("iab,ib->ai", weight, dense.seen - about.T)
    assert_allclose(found.marginal(about).shift, pull, rtol=1e-7, atol=1e-9 * np.abs(pull).max())


def test_a_parameter_that_a_site_says_nothing_of_keeps_its_prior(dense: Dense) -> None:
    precision, slope = np.array(dense.sites.precision), np.array(dense.sites.shift)
    precision[:, -1], precision[:, :, -1], slope[:, -1] = 0.0, 0.0, 0.0
    opened = Dense("people", 2)
    opened.sites = dense.sites._replace(precision=precision, shift=slope)  # type: ignore[arg-type]
    found = conditional(opened, dense.of_u)
    weight = stacked(found.marginal(np.zeros((SIZE, dense.number))).precision)
    assert not weight[-1].any()
    assert not weight[:, -1].any()
    nothing, last = np.zeros((SIZE, dense.number)), np.eye(SIZE)[-1][:, None] + np.zeros(dense.number)
    sd = np.subtract(found.draw(nothing, last), found.draw(nothing, nothing))[-1]
    assert_allclose(sd**2, dense.of_u[-1, -1], rtol=1e-12)


def test_products_of_small_matrices_are_written_out() -> None:
    """A sum over an axis of three would be a reduction, which XLA makes a loop of its own through memory."""
    blocks, places = 2, 32
    vector, single = jnp.zeros((blocks, SIZE, 1, places)), jnp.zeros((blocks, 1, places))
    laid = GaussianFactor(vector, vector, jnp.zeros((blocks, SIZE, SIZE, 1, places)), single)
    compiled = jax.jit(cell_factors).lower(jnp.eye(SIZE), jnp.zeros((SIZE, places)), laid).compile()
    assert " reduce(" not in compiled.as_text()


def test_a_site_is_a_parabola_about_its_centre(dense: Dense) -> None:
    sites = GaussianFactor(*map(np.asarray, dense.sites))
    away = dense.rng.normal(size=(dense.number, SIZE))
    slope = (away * sites.shift).sum(1)
    direct = sites.log_scale + slope - np.einsum("ia,iab,ib->i", away, sites.precision, away) / 2
    assert_allclose(sites.log_density(sites.centre + away), direct, rtol=1e-11)
