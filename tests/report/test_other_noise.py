"""Recorded noise is called another than the model's at a known rate, whatever the number of impacts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from bayestissue.reports.pages.fit.trace_predictions import OTHER_NOISE, Residuals

DRAWS, SAMPLES = 100, 60


def residuals(rng: np.random.Generator, impacts: int, correlation: float = 0.0) -> Residuals:
    """White replicates beside measured noise of this correlation from sample to sample."""
    shocks = rng.standard_normal((impacts, SAMPLES))
    measured = shocks.copy()
    for t in range(1, SAMPLES):
        measured[:, t] += correlation * measured[:, t - 1]
    return Residuals(measured, rng.standard_normal((DRAWS, impacts, SAMPLES)), np.arange(impacts))


@pytest.mark.slow
@pytest.mark.parametrize("impacts", [1, 3, 30])
def test_noise_of_the_models_kind_is_called_another_in_one_of_a_hundred_fits(impacts):
    rng, fits = np.random.default_rng(impacts), 600
    alarms = sum(residuals(rng, impacts).other_noise_p < OTHER_NOISE for _ in range(fits))
    assert alarms <= binom.ppf(0.999, fits, 0.01)


@pytest.mark.parametrize("impacts", [3, 30])
def test_correlated_noise_beside_a_white_model_is_called_another(impacts):
    rng = np.random.default_rng(impacts)
    assert all(residuals(rng, impacts, correlation=0.6).other_noise_p < OTHER_NOISE for _ in range(20))
