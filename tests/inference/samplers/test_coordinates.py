"""Coordinates in which a posterior of standard deviations is nearly normal, on densities that are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi, halfnorm, norm

from bayestissue.inference.samplers.coordinates import Coordinates, unwarped, warp_about

# Of the log: a spread that the data leave anywhere below a tenth, one of ten people, one of ninety impacts.
LOGS = {
    "open": lambda x: halfnorm.logpdf(np.exp(x) / 0.1) + x,
    "few": lambda x: chi.logpdf(np.exp(x) / 0.2, 9) + x,
    "many": lambda x: chi.logpdf(np.exp(x) / 0.05, 89) + x,
}
QUANTILES = {
    "open": lambda p: np.log(0.1 * halfnorm.ppf(p)),
    "few": lambda p: np.log(0.2 * chi.ppf(p, 9)),
    "many": lambda p: np.log(0.05 * chi.ppf(p, 89)),
}
PROBABILITIES = norm.cdf([-1.645, 0.0, 1.645])


def log_densities(points: np.ndarray) -> np.ndarray:
    return sum(each(values) for each, values in zip(LOGS.values(), points.T, strict=True))


MODE = np.array([np.log(0.1), np.log(0.2 * 3.0), np.log(0.05 * np.sqrt(89))])


@pytest.mark.parametrize("scale", [0.3, 1.0])
def test_a_warp_has_the_quantiles_of_each_axis(scale: float) -> None:
    warp = warp_about(log_densities, MODE, scale * np.array([1.0, 0.5, 0.1]))
    y = norm.ppf(PROBABILITIES)
    found = np.stack([np.asarray(warp(value)) for value in y])
    known = np.stack([each(PROBABILITIES) for each in QUANTILES.values()], axis=1)
    # Cubics between 17 values of the log density give quantiles to a hundredth of the range.
    for place in range(3):
        assert_allclose(found[:, place], known[:, place], atol=0.01 * np.ptp(known[:, place]))


def test_the_warped_density_is_nearly_normal() -> None:
    warp = warp_about(log_densities, MODE, np.array([1.0, 0.5, 0.1]))
    y = np.linspace(-2.0, 2.0, 17)
    for place, each in enumerate(LOGS.values()):
        own = warp.part(place)
        away = np.array([each(value) for value in own(y)]) + np.log(own.slope(y)) + y**2 / 2
        # On the log scale the first of them is off by 1.3 there.
        assert np.ptp(away) < 0.5


def test_where_nothing_is_likely_or_known_the_warp_stays_increasing() -> None:
    def steep(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, 0] > 0, np.nan, 5 * points[:, 0])

    warp = warp_about(steep, np.zeros(1), np.ones(1))
    assert (warp.slope(np.linspace(-9.0, 9.0, 37)[:, None]) > 0).all()
    assert np.isfinite(warp(np.array([0.0]))).all()
    # An exponential of rate 5 has its median at log 2 / 5 below its wall.
    assert float(warp.location[0]) == pytest.approx(-np.log(2) / 5, abs=0.05)


def test_values_come_back_by_name() -> None:
    coordinates = Coordinates(("a", "b"), unwarped(2)._replace(location=np.array([1.0, 2.0])), np.eye(2))
    assert coordinates.raw(np.zeros(2)) == {"a": 1.0, "b": 2.0}
    found = coordinates.raw(np.zeros((4, 5, 2)))
    assert found["b"].shape == (4, 5)
    assert (found["b"] == 2.0).all()


def test_a_density_that_is_nowhere_is_no_place_for_coordinates() -> None:
    with pytest.raises(FloatingPointError, match="no finite value along an axis"):
        warp_about(lambda points: np.full(len(points), np.nan), np.zeros(2), np.ones(2))
