from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from bayestissue.thesis.reanalysis.observations import average_and_sd, average_statistics
from published_model import AveragesOfLognormals, average_moments

PEOPLE = 10
SIMULATIONS = 40_000


def pairs(sd_K: float, sd_C: float, r: float, *, spread: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Log means of ten people, ``spread`` apart, and the factor of the logs' covariance."""
    person = np.random.default_rng(3).standard_normal((PEOPLE, 2))
    loc = np.array([2.5, 0.3]) + spread * (person - person.mean(0))
    scale_tril = np.array([[sd_K, 0.0], [r * sd_C, sd_C * np.sqrt(1 - r**2)]])
    return loc, scale_tril


def test_statistics_and_their_inverse_are_one_to_one() -> None:
    average, sd = np.array([15.975, 3.557, 0.903]), np.array([0.497, 0.470, 0.561])
    m, root = average_statistics(jnp.asarray(average), jnp.asarray(sd))
    # s² = log(1 + (sd/average)²), once by hand.
    assert_allclose(root[2] ** 3, np.log(1 + (0.561 / 0.903) ** 2), rtol=1e-14)
    assert_allclose(m[2], np.log(0.903) - root[2] ** 3 / 2, rtol=1e-14)
    # log1p and expm1 of the same number: a few roundings.
    assert_allclose(average_and_sd(m, root), (average, sd), rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize(("sd_K", "sd_C", "r"), [(0.03, 0.3, -0.5), (0.8, 0.8, 0.3)])
def test_moments_are_those_of_simulated_averages(sd_K: float, sd_C: float, r: float) -> None:
    loc, scale_tril = pairs(sd_K, sd_C, r)
    events = np.asarray(
        AveragesOfLognormals(jnp.asarray(loc), jnp.asarray(scale_tril)).sample(
            jax.random.key(1), (SIMULATIONS,)
        )
    )
    mean, sd, correlation = (
        np.asarray(x) for x in average_moments(jnp.asarray(loc), jnp.asarray(scale_tril))
    )
    # Four standard errors of the simulation, and as much again for the table, simulated as often.
    assert_allclose((events.mean(0) - mean) / sd, 0, atol=8 / np.sqrt(SIMULATIONS))
    assert_allclose(events.std(0) / sd, 1, atol=8 * np.sqrt(0.75 / SIMULATIONS))
    made = np.corrcoef(events.T)
    # The correlation of logs passes to averages only to first order in the spread: 0.1 up to 0.8.
    assert_allclose([made[0, 1], made[2, 3]], correlation, atol=0.1)
    # The model takes a mean and a spread as independent: their correlation stays below 0.05
    # where the spreads are small, and below a quarter at 0.8.
    bound = 0.05 if max(sd_K, sd_C) < 0.5 else 0.25
    assert np.abs(made[:2, 2:]).max() < bound


def test_people_who_differ_add_their_variance_to_the_published_spread() -> None:
    loc, scale_tril = pairs(0.1, 0.3, -0.3, spread=0.1)
    distribution = AveragesOfLognormals(jnp.asarray(loc), jnp.asarray(scale_tril))
    events = np.asarray(distribution.sample(jax.random.key(2), (SIMULATIONS,)))
    mean, sd, _ = (np.asarray(x) for x in average_moments(jnp.asarray(loc), jnp.asarray(scale_tril)))
    # Treating fixed differences as random ones is an approximation: a tenth of a standard deviation in the
    # mean. The sd of the root is then overstated, never understated, because fixed differences don't vary.
    assert_allclose((events.mean(0) - mean) / sd, 0, atol=0.1)
    assert np.all(events.std(0) / sd < 1.05)
    assert np.all(events.std(0) / sd > 0.75)


def test_log_density_is_the_normal_of_those_moments() -> None:
    loc, scale_tril = pairs(0.05, 0.4, -0.5)
    mean, sd, (r_mean, r_root) = (
        np.asarray(x) for x in average_moments(jnp.asarray(loc), jnp.asarray(scale_tril))
    )
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = r_mean
    correlation[2, 3] = correlation[3, 2] = r_root
    covariance = correlation * np.outer(sd, sd)
    values = mean + sd * np.random.default_rng(0).standard_normal((50, 4))
    ours = AveragesOfLognormals(jnp.asarray(loc), jnp.asarray(scale_tril)).log_prob(jnp.asarray(values))
    assert_allclose(ours, multivariate_normal(mean, covariance).logpdf(values), rtol=1e-11)
