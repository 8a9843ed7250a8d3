from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayestissue.model.likelihood import arma21_log_likelihood, quadratic

# Compiled once for all cases.
log_determinant = jax.jit(quadratic.log_determinant)
slope_of_determinant = jax.grad(quadratic.log_determinant)
slopes_of_determinant = jax.jit(jax.vmap(slope_of_determinant))
bends_of_determinant = jax.jit(jax.vmap(jax.grad(slope_of_determinant)))


@jax.jit
@partial(jax.grad, argnums=1)
def slopes_of_total(x: np.ndarray, p: jax.Array) -> jax.Array:
    return arma21_log_likelihood(x, *p).sum()


bends_of_total = jax.jit(jax.jacfwd(slopes_of_total, argnums=1))


def walks(impacts: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(impacts, 150)).cumsum(1)


@pytest.mark.parametrize("theta1", [-1.3, -1.0, -0.9999, -0.5, -0.4999, 0.0, 0.3, 1.0])
@pytest.mark.parametrize("count", [1, 7, 4000])
def test_determinant_is_the_sum_of_even_powers(theta1: float, count: int) -> None:
    powers = 2 * np.arange(count + 1) * np.log(max(abs(theta1), 1e-300))
    expected = np.logaddexp.reduce(powers)
    assert float(log_determinant(jnp.array(theta1), jnp.array(float(count)))) == pytest.approx(
        expected, abs=1e-9
    )
    weights = np.exp(powers - expected)
    slope = float(weights @ (2 * np.arange(count + 1))) / theta1 if theta1 else 0.0
    (found,) = slopes_of_determinant(jnp.array([theta1]), jnp.array([float(count)]))
    assert float(found) == pytest.approx(slope, rel=1e-8, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 7, 4000])
def test_slope_of_the_determinant_is_smooth_where_its_formulas_meet(count: int) -> None:
    # series and closed form meet at (count + 1) |log|theta1|| = 1/2, inside and outside of 1
    for edge in (np.exp(-0.5 / (count + 1)), 1.0, np.exp(0.5 / (count + 1))):
        theta1 = edge + np.array([-3, -1, 1, 3]) * 1e-6 / count
        powers = 2.0 * np.arange(count + 1)
        weights = np.exp(powers * np.log(theta1)[:, None])
        mean, size = (weights @ powers) / weights.sum(1), jnp.full(4, float(count))
        slopes = slopes_of_determinant(jnp.asarray(theta1), size)
        np.testing.assert_allclose(slopes, mean / theta1, rtol=1e-11)
        bends = bends_of_determinant(jnp.asarray(theta1), size)
        variance = (weights @ powers**2) / weights.sum(1) - mean**2
        # the difference of two numbers of the order of count^2
        np.testing.assert_allclose(bends, (variance - mean) / theta1**2, rtol=1e-9, atol=1e-11 * count**2)
    (bend,) = bends_of_determinant(jnp.zeros(1), jnp.full(1, 7.0))
    assert float(bend) == pytest.approx(2.0)


@pytest.mark.parametrize("theta1", [-1.0, -0.4, 0.0, 0.9])
def test_second_derivatives_are_the_differences_of_the_first(theta1: float) -> None:
    x, at = walks(1), jnp.array([1.9, -0.92, theta1, 0.7])
    curvature, step = bends_of_total(x, at), 1e-5
    for k in range(4):
        ahead, behind = (slopes_of_total(x, at.at[k].add(sign * step)) for sign in (1, -1))
        # central differences: third derivatives by step squared, and rounding by 1e-16 / step
        scale = np.abs(curvature[k]).max()
        np.testing.assert_allclose(curvature[k], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-6 * scale)


def test_chains_side_by_side_are_the_chains_one_by_one() -> None:
    x, phi1 = walks(3), 2 - jnp.linspace(0.05, 0.15, 12).reshape(4, 3)

    def total(phi1: jax.Array) -> jax.Array:
        return arma21_log_likelihood(x, phi1, 0.98 - phi1, -0.3, 0.5).sum()

    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(total)))(phi1)
    for chain in range(4):
        value, slope = jax.jit(jax.value_and_grad(total))(phi1[chain])
        assert float(values[chain]) == pytest.approx(float(value), rel=1e-13)
        np.testing.assert_allclose(slopes[chain], slope, rtol=1e-12)
