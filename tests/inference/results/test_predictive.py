from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from bayestissue.thesis.reanalysis.analysis import predictive_checks


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
    # Every replicate equals the data, and counts as at or above them; smaller ones do not.
    assert (table["p_value"] == 1).all()
    less = predictive_checks(observed + 1, np.stack([observed] * 3), trial, mass)
    assert less.set_index(["statistic", "quantity"])["p_value"]["largest value", "K"] == 0
