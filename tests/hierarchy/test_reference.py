"""The factor of all masses by phantoms: closed forms of alike impacts, and intervals that hold the truth."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, multivariate_normal

from bayestissue.model.hierarchy.reference import mass_factor, scatter, with_declared


def test_what_is_common_to_all_impacts_is_not_averaged_away() -> None:
    apart, n = np.array([0.05, 0.07, 0.06, 0.06]), 4
    variance, same = np.full(n, 0.01**2), np.zeros(n, int)
    mean, sd = mass_factor(apart, variance, 0.003**2, np.full(n, 0.01), same)
    assert mean == pytest.approx(0.06, rel=1e-12)
    assert sd == pytest.approx(np.sqrt(0.01**2 / n + 0.003**2 + 0.01**2), rel=1e-12)
    # Of two phantoms each stiffness has an error of its own.
    _, of_two = mass_factor(apart, variance, 0.003**2, np.full(n, 0.01), np.array([0, 0, 1, 1]))
    assert of_two == pytest.approx(np.sqrt(0.01**2 / n + 0.003**2 + 0.01**2 / 2), rel=1e-12)


def test_scatter_is_that_beyond_the_errors_and_within_phantoms() -> None:
    apart = np.array([0.0, 0.2, 1.0, 1.2])
    phantom, variance = np.array([0, 0, 1, 1]), np.full(4, 1e-4)
    # Each pair has the sample variance 0.02.
    assert scatter(apart, variance, phantom) == pytest.approx(0.02 - 1e-4, rel=1e-9)
    assert scatter(apart[:1], variance[:1], phantom[:1]) == 0.0


def test_the_declared_error_of_mass_is_the_prior() -> None:
    reference = with_declared((0.06, 0.01), 0.05, pd.DataFrame())
    x = np.linspace(-0.2, 0.3, 20001)
    weight = np.exp(-(x**2) / (2 * 0.05**2) - (x - 0.06) ** 2 / (2 * 0.01**2))
    weight /= weight.sum()
    assert reference.log_mean == pytest.approx(weight @ x, abs=1e-9)
    assert reference.log_sd == pytest.approx(np.sqrt(weight @ (x - weight @ x) ** 2), rel=1e-6)


def test_intervals_hold_the_factor_where_phantoms_err_as_declared() -> None:
    rng, studies = np.random.default_rng(3), 2000
    phantom = np.repeat([0, 1], 4)
    variance, common, reference_sd = np.full(8, 0.008**2), 0.004**2, np.full(8, 0.01)
    covariance = np.diag(variance) + common + (phantom[:, None] == phantom) * 0.01**2
    errors = multivariate_normal(np.zeros(8), covariance, seed=rng).rvs(studies)
    factor = 0.05 * rng.standard_normal(studies)
    held = 0
    for true, error in zip(factor, errors, strict=True):
        apart = mass_factor(true + error, variance, common, reference_sd, phantom)
        known = with_declared(apart, 0.05, pd.DataFrame())
        held += abs(known.log_mean - true) < 1.6449 * known.log_sd
    # Scatter by chance widens some: never fewer than 90 %, once in a thousand.
    assert binom.ppf(0.001, studies, 0.9) <= held < 0.95 * studies
