"""The explanations of a trace: which maxima of its likelihood are different, and count."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from bayestissue.inference.chain.explanations import DISTINCT, LEAST, MOST, _distinct
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor


def tried(*starts: list[tuple[float, float]]) -> GaussianFactor:
    """Expansions of two parameters, of each start and impact a place along both and a log likelihood."""
    places, value = np.moveaxis(np.array(starts), -1, 0)
    centre = np.stack([places, places], axis=-1)
    precision = np.broadcast_to(np.eye(2), (*places.shape, 2, 2)).copy()
    return GaussianFactor(centre, np.zeros_like(centre), precision, value)


def test_the_best_comes_first_and_what_is_near_it_is_the_same():
    sites = _distinct(tried([(0.0, -1.0)], [(0.1, 0.0)], [(-0.1, -0.5)]))
    assert sites.centre.shape == (1, 1, 2)
    assert_allclose(sites.centre[0, 0], 0.1)


def test_another_maximum_is_kept_if_it_is_far_and_not_far_less_likely():
    far = DISTINCT
    sites = _distinct(tried([(0.0, 0.0)] * 3, [(far, -1.0), (far, -2 * LEAST), (0.5, -1.0)]))
    assert sites.log_scale.shape == (2, 3)
    assert_allclose(sites.log_scale[:, 0], [0.0, -1.0])
    assert_allclose(sites.centre[1, 0], far)
    # Of the others the second site says nothing.
    assert np.isneginf(sites.log_scale[1, 1:]).all()
    assert np.isfinite(sites.centre).all()


def test_a_search_that_ended_nowhere_is_none():
    sites = _distinct(tried([(0.0, 0.0)], [(9.0, -np.inf)]))
    assert len(sites.centre) == 1


def test_there_are_no_more_than_some_of_one_trace():
    sites = _distinct(tried(*([(10.0 * n, -float(n))] for n in range(MOST + 2))))
    assert len(sites.centre) == MOST
    assert_allclose(sites.log_scale[:, 0], -np.arange(MOST))
