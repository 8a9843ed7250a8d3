"""Expansions of traces' likelihoods."""

import numpy as np

from bayestissue.inference.factors.laplace import curvature_floor


def test_an_expansion_that_bends_the_wrong_way_promises_little() -> None:
    slope = np.array([0.5, 7.0, -14.0, 3.0])
    bend = np.array([-3.0, 1e-9, -60.0, 0.0])
    firm = np.asarray(curvature_floor(bend, slope))
    gain = slope**2 / (2 * firm)
    np.testing.assert_allclose(gain, 1.0, rtol=1e-12)


def test_an_expansion_that_bends_as_it_should_stays() -> None:
    # Up to a maximum that is six standard deviations away.
    slope, bend = np.array([0.0, 6.0, 0.1]), np.array([2.0, 1.0, 1e-3])
    np.testing.assert_array_equal(curvature_floor(bend, slope), bend)


def test_a_flat_likelihood_keeps_a_trace_of_a_bend() -> None:
    assert (np.asarray(curvature_floor(np.zeros(2), np.zeros(2))) > 0).all()
