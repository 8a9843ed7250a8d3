"""Weights of points without any likelihood: no infinity is taken from another, and no warning is raised."""

from __future__ import annotations

import numpy as np
import pytest

from bayestissue.inference.factors import importance_ratios as ratios
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    importance_ratios,
    log_evidence_corrections,
)
from bayestissue.inference.factors.laplace import ConditionalPrior
from bayestissue.inference.posterior import recipe as summary_path
from bayestissue.inference.posterior.recipe import Correction
from bayestissue.inference.samplers.psis import below_greatest, pareto_smoothed


def test_below_the_greatest() -> None:
    log_weight = np.array([[1.0, -np.inf, -np.inf], [3.0, 2.0, -np.inf]])
    found = below_greatest(log_weight)
    np.testing.assert_array_equal(found, [[-2.0, -np.inf, -np.inf], [0.0, 0.0, -np.inf]])


def test_draws_without_weight_get_none_and_leave_the_others_as_they_are() -> None:
    log_weight = np.random.default_rng(1).normal(size=1000)
    alone, k = pareto_smoothed(log_weight)
    among, k_among = pareto_smoothed(np.concatenate([log_weight, [-np.inf, np.nan, -np.inf]]))
    np.testing.assert_array_equal(among[:1000], alone)
    assert np.exp(among).sum() == pytest.approx(1.0)
    assert np.isneginf(among[1000:]).all()
    assert k_among == k < 0.7
    nothing, k = pareto_smoothed(np.full(10, -np.inf))
    assert np.exp(nothing).sum() == pytest.approx(1.0)
    assert k == np.inf


def test_one_impact_without_likelihood_does_not_spoil_what_the_others_tell() -> None:
    log_ratio = 0.3 * np.random.default_rng(6).normal(size=(64, 40))
    log_ratio[:, 7] = -np.inf
    nothing = np.zeros((64, 40, 3))
    found = Correction(0.1, 0.9, ImportanceRatios(nothing, log_ratio, log_ratio, ()))  # type: ignore[arg-type]
    assert 0.8 < found.told < 1
    assert found.trusted
    assert summary_path._relative_variance(log_ratio) == np.inf
    assert summary_path._relative_variance(np.delete(log_ratio, 7, axis=1)) < 1


def test_a_chain_without_weight_stays_as_it_is() -> None:
    weight = np.array([[0.0, 2.0, 0.0, 2.0], [0.0, 0.0, 0.0, 0.0]])
    chosen = summary_path._resample(weight, 4, np.random.default_rng(0))
    np.testing.assert_array_equal(chosen, [1, 1, 3, 3, 4, 5, 6, 7])


class _Model:
    nuisance = ("log_noise",)


def test_ratios_where_one_impact_has_no_likelihood_and_one_no_summary(monkeypatch) -> None:
    """Of three impacts with normal likelihoods: of one nothing is left anywhere, of one at some points."""
    rng = np.random.default_rng(2)
    impacts, size = 3, 3

    def density(model, data, u):
        found = -np.square(u).sum(-1) / 2
        found[:, 1] = -np.inf
        found[::3, 2] = -np.inf
        return found

    def summary(summaries, u):
        found = -np.square(u).sum(-1) / 2
        found[::3, 2] = -np.inf
        return found

    monkeypatch.setattr(ratios, "log_likelihoods", density)
    monkeypatch.setattr(ratios, "log_site", summary)
    own = np.broadcast_to(np.eye(size), (impacts, size, size))
    zero = np.zeros((impacts, size))
    summaries = ratios.Sites(zero, zero, own, np.zeros(impacts))  # type: ignore[arg-type]
    anchors = ConditionalPrior(
        0.1 * rng.normal(size=(64, impacts, size)), np.broadcast_to(np.eye(size), (64, 1, size, size))
    )
    found = importance_ratios(_Model, None, summaries, anchors, rng.normal(size=(64, 2)))  # type: ignore[arg-type]
    assert np.isneginf(found.log_ratio[:, 1]).all()
    np.testing.assert_allclose(found.log_ratio[:, 0], 0, atol=1e-12)
    (table,) = found.tables
    assert np.isfinite(table.coefficients).all()
    np.testing.assert_allclose(table.coefficients[:, :2], 0, atol=1e-12)
    told = log_evidence_corrections(summaries, found, anchors)
    # The truth is the summary itself: there is nothing to correct.
    np.testing.assert_allclose(told[:, 0], 0, atol=1e-9)
    assert np.isneginf(told[:, 1]).all()
    assert np.isfinite(told[:, 2]).all()
