"""The half-normal prior on its own coordinate is still the half-normal."""

import jax
import numpy as np
import numpyro.distributions as dist
import pytest
from numpyro.distributions import biject_to

from bayestissue.model.hierarchy.trace_models import HalfNormalSpread

SCALE = 0.3
EPSILON = np.finfo(float).eps


@pytest.fixture
def transform():
    return biject_to(HalfNormalSpread(SCALE).support)


def test_the_density_is_the_half_normal_s():
    x = np.linspace(0.01, 2.0, 50)
    found, known = (jax.jit(each(SCALE).log_prob)(x) for each in (HalfNormalSpread, dist.HalfNormal))
    assert np.array_equal(found, known)


def test_the_coordinate_gives_every_positive_number_and_is_given_back(transform):
    y = np.linspace(-20.0, 30.0, 101)
    x = np.asarray(jax.jit(lambda y: transform(y))(y))
    assert (x > 0).all()
    # The inverse log(e^x - 1) loses what e^x - 1 does beside 1.
    assert np.allclose(
        jax.jit(lambda x: transform.inv(x))(x), y, rtol=0, atol=50 * EPSILON * np.maximum(1, np.exp(-y))
    )


def test_its_slope_is_the_derivative(transform):
    y = np.linspace(-10.0, 10.0, 41)
    slope = jax.jit(jax.vmap(jax.grad(transform)))(y)
    found = jax.jit(lambda y: transform.log_abs_det_jacobian(y, transform(y)))(y)
    assert np.allclose(found, np.log(slope), rtol=1e-12)


def test_the_upper_tail_is_a_normal_s_and_the_lower_one_the_logarithm_s(transform):
    # Second derivatives of the log density, up the tail: -1 as a normal of unit scale has; by the log
    # coordinate it would be -2 e^2y.
    def log_density(y):
        x = transform(y)
        return HalfNormalSpread(SCALE).log_prob(x) + transform.log_abs_det_jacobian(y, x)

    slope = jax.grad(log_density)
    bend = jax.jit(jax.grad(slope))
    # log(1 + e^y) - y is e^-y, which is 5e-5 at 10, and times the deviation there 5e-4.
    assert float(bend(10.0)) == pytest.approx(-1.0, abs=1e-3)
    assert float(jax.jit(slope)(-12.0)) == pytest.approx(1.0, abs=1e-3)
