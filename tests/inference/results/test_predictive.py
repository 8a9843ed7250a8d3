from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from bayestissue.thesis.reanalysis.analysis import predictive_checks

TRIAL = np.repeat(np.arange(7), 10).astype(str)
MASS = np.repeat(np.array([0.375, 0.489, 0.562, 0.734, 0.75, 0.979, 1.0]), 10)


def made(rng: np.random.Generator, count: int) -> np.ndarray:
    """(log K, log C) with one scatter for all masses and correlation −0.5 within trials."""
    z = rng.standard_normal((count, 70, 2))
    z[..., 1] = -0.5 * z[..., 0] + np.sqrt(0.75) * z[..., 1]
    return np.array([2.8, 0.3]) + np.log(MASS)[:, None] + np.array([0.05, 0.4]) * z


def test_p_values_of_data_from_the_model_are_uniform() -> None:
    rng = np.random.default_rng(1)
    replicates, data = made(rng, 1000), made(rng, 100)
    p = np.array([predictive_checks(x, replicates, TRIAL, MASS)["p_value"].to_numpy() for x in data])
    # A hundred uniform numbers: mean within four standard errors, √(1/12/100) = 0.029.
    assert_allclose(p.mean(0), 0.5, atol=4 * 0.029)
    assert p.shape == (100, 13)
    # A uniform number's standard deviation is 0.289; its own relative standard error here is about 0.045.
    assert_allclose(p.std(0), 0.289, rtol=4 * 0.045 + 0.02)


def test_what_the_model_does_not_make_is_shown_by_its_own_statistic() -> None:
    rng = np.random.default_rng(2)
    replicates, data = made(rng, 1000), made(rng, 1)[0]
    light = np.median(MASS) >= MASS
    centre = np.array([2.8, 0.3]) + np.log(MASS)[:, None]
    scattered = np.where(light[:, None], centre + 3 * (data - centre), data)
    table = predictive_checks(scattered, replicates, TRIAL, MASS).set_index(["statistic", "quantity"])
    row = table.loc[("scatter at light masses over scatter at heavy ones", "K")]
    assert row["p_value"] == 0
    assert row["observed"] > row["predicted_high"] > row["predicted_median"] > row["predicted_low"]


def test_statistics_worked_by_hand() -> None:
    trial, mass = np.array(["a", "a", "b", "b"]), np.array([1.0, 1.0, 2.0, 2.0])
    K = np.log([1.0, np.e**2, 1.0, np.e**4])
    observed = np.stack([K, -K], axis=-1)
    table = predictive_checks(observed, np.stack([observed] * 3), trial, mass)
    found = table.set_index(["statistic", "quantity"])["observed"]
    assert_allclose(found["smallest value", "K"], 1)
    assert_allclose(found["largest value", "K"], np.exp(4))
    # Deviations from the trials' means: −1, 1, −2, 2.
    assert_allclose(found["standard deviation of the log within trials", "K"], np.sqrt(10 / 4))
    assert_allclose(found["skewness of the log within trials", "K"], 0, atol=1e-12)
    assert_allclose(found["scatter at light masses over scatter at heavy ones", "K"], 0.5)
    assert_allclose(found["correlation of K and C within trials", "K, C"], -1)
    values = np.exp(K)
    assert_allclose(found["correlation with mass", "K"], np.corrcoef(values, mass)[0, 1])
    # Every replicate equals the data, and counts as at or above them.
    assert (table["p_value"] == 1).all()
