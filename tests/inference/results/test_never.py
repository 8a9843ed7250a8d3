from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.inference.results.cross_validation import relative_size
from bayestissue.inference.results.summary import summarise
from bayestissue.inference.samplers.sampling import quantiles

RNG = np.random.default_rng(2)
DURATION = RNG.gamma(9.0, 0.004, (4, 500))
NEVER = RNG.uniform(size=DURATION.shape) < 0.3


def test_what_may_never_happen_has_the_share_of_draws_in_which_it_does_not() -> None:
    draws = np.stack([DURATION, np.where(NEVER, np.inf, DURATION)], axis=-1)
    posterior = xr.Dataset({"contact_duration": (("chain", "draw", "impact"), draws)}, {"impact": ["a", "b"]})
    always, seldom = (row for _, row in summarise(posterior).iterrows())
    assert (always["never"], seldom["never"]) == (0.0, NEVER.mean())
    assert_allclose(always[["mean", "sd"]].astype(float), [DURATION.mean(), DURATION.std(ddof=1)])
    # A mean over the others would be one of another quantity.
    assert seldom[["mean", "sd", "mcse_mean"]].isna().all()
    assert seldom["median"] in DURATION
    assert np.isinf(seldom["eti90_high"])
    # By ranks chains agree whatever the greatest values are.
    assert np.isfinite(seldom[["r_hat", "ess_bulk", "ess_tail"]].astype(float)).all()


def test_quantiles_lie_between_draws_where_these_are_numbers() -> None:
    draws = np.stack([DURATION.ravel(), np.where(NEVER, np.inf, DURATION).ravel()])
    low, high = quantiles(draws, [0.05, 0.95])
    assert low[0] == np.quantile(DURATION, 0.05)
    assert low[1] == np.quantile(draws[1], 0.05, method="inverted_cdf")
    assert np.isfinite(high).tolist() == [True, False]


@pytest.mark.filterwarnings("error")
def test_what_is_never_leaves_the_scores_of_cross_validation_as_they_are() -> None:
    K = xr.Dataset({"K": (("chain", "draw"), RNG.normal(3000.0, 100.0, DURATION.shape))})
    duration = (("chain", "draw"), np.where(NEVER, np.inf, DURATION))
    alone, beside = (
        xr.DataTree.from_dict({"posterior": one}) for one in (K, K.assign(contact_duration=duration))
    )
    # The effective size, by which the tail that is smoothed is chosen, is that of what has a mean.
    assert relative_size(beside) == relative_size(alone)
