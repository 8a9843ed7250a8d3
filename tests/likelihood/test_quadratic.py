from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayestissue.likelihood import SineTransforms, log_likelihood, quadratic, sine_transforms
from bayestissue.likelihood.quadratic import quadratic_form

# Compiled once for all cases.
log_determinant = jax.jit(quadratic.log_determinant)
slope_of_determinant = jax.grad(quadratic.log_determinant)
slopes_of_determinant = jax.jit(jax.vmap(slope_of_determinant))
bends_of_determinant = jax.jit(jax.vmap(jax.grad(slope_of_determinant)))


@jax.jit
@partial(jax.grad, argnums=1)
def slopes_of_total(data: SineTransforms, p: jax.Array) -> jax.Array:
    return log_likelihood(data, *p).sum()


bends_of_total = jax.jit(jax.jacfwd(slopes_of_total, argnums=1))


def made(impacts: int = 3, n: int = 150) -> tuple:
    data = sine_transforms(np.random.default_rng(0).normal(size=(impacts, n)).cumsum(1))
    return (
        data,
        (jnp.ones(impacts), jnp.full(impacts, 0.1), jnp.full(impacts, 0.02)),
        jnp.array([-1.0, 0.2, 0.9]),
    )


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
    data, _, _ = made(impacts=1)
    at = jnp.array([0.1, 0.02, theta1, 0.7])
    curvature, step = bends_of_total(data, at), 1e-5
    for k in range(4):
        ahead, behind = (slopes_of_total(data, at.at[k].add(sign * step)) for sign in (1, -1))
        # central differences: third derivatives by step squared, and rounding by 1e-16 / step
        scale = np.abs(curvature[k]).max()
        np.testing.assert_allclose(curvature[k], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-6 * scale)


def test_chains_side_by_side_are_the_chains_one_by_one() -> None:
    data, _, _ = made()
    c1 = jnp.linspace(0.05, 0.15, 12).reshape(4, 3)

    def total(c1: jax.Array) -> jax.Array:
        return log_likelihood(data, c1, 0.02, -0.3, 0.5).sum()

    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(total)))(c1)
    for chain in range(4):
        value, slope = jax.jit(jax.value_and_grad(total))(c1[chain])
        assert float(values[chain]) == pytest.approx(float(value), rel=1e-13)
        np.testing.assert_allclose(slopes[chain], slope, rtol=1e-12)


def test_form_is_differentiable_by_the_data_too() -> None:
    data, coefficients, theta1 = made()
    direction = tuple(jnp.cos(column) for column in data.columns)

    def form(step: jax.Array) -> jax.Array:
        moved = tuple(c + step * d for c, d in zip(data.columns, direction, strict=True))
        return quadratic_form(coefficients, theta1, moved, data.spread).sum()

    both = jax.jit(jax.value_and_grad(form))
    _, slope = both(jnp.array(0.0))
    # a quadratic form: central differences are exact but for rounding
    finite = (both(jnp.array(0.5))[0] - both(jnp.array(-0.5))[0]) / 1.0
    assert float(slope) == pytest.approx(float(finite), rel=1e-9)


def test_more_columns_carry_more_linear_unknowns() -> None:
    # an offset of x is linear in the residual: a fourth column with its size for coefficient
    n, offset = 150, 0.7
    data, coefficients, theta1 = made(n=n)
    moved = sine_transforms(np.asarray(data.x) + offset)
    one = sine_transforms(np.ones((3, n)))
    columns = (*data.columns, one.columns[2])
    direct = quadratic_form(coefficients, theta1, moved.columns, data.spread)
    linear = quadratic_form((*coefficients, offset * coefficients[2]), theta1, columns, data.spread)
    np.testing.assert_allclose(linear, direct, rtol=1e-9)


def test_frequencies_are_no_parameter() -> None:
    data, coefficients, theta1 = made()
    with pytest.raises(TypeError, match="frequencies"):
        jax.grad(lambda s: quadratic_form(coefficients, theta1, data.columns, s).sum())(data.spread)
