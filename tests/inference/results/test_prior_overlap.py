from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from bayestissue.inference.results.summary import prior_overlap


@pytest.mark.slow
def test_the_overlap_of_normals_is_the_integral_of_the_lesser_density_on_any_scale() -> None:
    # Quantiles in the place of draws, so that nothing but the bins is off.
    at = (np.arange(200_000) + 0.5) / 200_000
    for mean, sd in ((0.0, 1.0), (0.0, 1 / 3), (1.5, 0.5), (0.0, 3.0)):
        posterior, prior = stats.norm(mean, sd).ppf(at), stats.norm().ppf(at)
        lesser = lambda x, mean=mean, sd=sd: min(stats.norm(mean, sd).pdf(x), stats.norm().pdf(x))  # noqa: E731
        exact = quad(lesser, -12, 12, points=[0, mean], limit=200)[0]
        found = prior_overlap(posterior, prior)
        # A bin that holds a crossing of the two densities counts as if it held none.
        assert exact - 1e-3 < found < exact + 0.02
        assert prior_overlap(np.exp(posterior), np.exp(prior)) == pytest.approx(found, abs=1e-9)


def test_infinite_draws_are_greatest_and_one_number_has_no_overlap() -> None:
    rng = np.random.default_rng(0)
    posterior, prior = rng.exponential(size=4000), rng.exponential(size=1000)
    with np.errstate(divide="ignore"):
        cut = [np.where(each < 2, 1 / (2 - np.minimum(each, 2)), np.inf) for each in (posterior, prior)]
    assert prior_overlap(*cut) == pytest.approx(prior_overlap(posterior, prior), abs=0.02)
    assert np.isnan(prior_overlap(np.ones(10), prior))
