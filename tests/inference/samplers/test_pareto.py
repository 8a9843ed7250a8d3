"""Weights of points without any likelihood: no infinity is taken from another, and no warning is raised."""

from __future__ import annotations

import numpy as np
import pytest

from bayestissue.inference.factors import importance_ratios as ratios
from bayestissue.inference.factors.conditional import ConditionalPrior
from bayestissue.inference.factors.importance_ratios import (
    importance_ratios,
    log_evidence_corrections,
)
from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.samplers.psis import (
    below_greatest,
    effective_size,
    k_threshold,
    pareto_smoothed,
    relative_variance,
)


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


def test_the_limit_of_pareto_k_follows_the_number_of_draws() -> None:
    # Ten to the power of 10 / 3 draws and more bear 0.7 (Vehtari et al. 2024).
    assert [k_threshold(number) for number in (100, 1000, 2154, 2155, 10**6)] == pytest.approx(
        [0.5, 2 / 3, 0.7, 0.7, 0.7], abs=1e-4
    )
    # So few that nothing vouches for them.
    assert k_threshold(1) == k_threshold(10) == 0


def test_an_effective_size_is_the_number_of_equal_weights() -> None:
    weight = np.array([[1.0, 0.0, 0.0], [1.0, 3.0, 0.0], [1.0, 0.0, 0.0], [1.0, 3.0, 0.0]])
    np.testing.assert_allclose(effective_size(weight), [4.0, 2.0, 0.0])


def test_one_impact_without_likelihood_does_not_spoil_what_the_others_tell() -> None:
    log_ratio = 0.3 * np.random.default_rng(6).normal(size=(64, 40))
    log_ratio[:, 7] = -np.inf
    found = Correction(np.ones((2, 100)), 0.1, 10.0, relative_variance(log_ratio))
    assert 0.8 < found.relative_of_points < 1
    assert found.trusted
    varies = relative_variance(log_ratio)
    assert varies[7] == np.inf
    assert np.delete(varies, 7).max() < 1


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
    monkeypatch.setattr(ratios.GaussianFactor, "log_density", summary)
    own = np.broadcast_to(np.eye(size), (impacts, size, size))
    zero = np.zeros((impacts, size))
    summaries = ratios.GaussianFactor(zero, zero, own, np.zeros(impacts))  # type: ignore[arg-type]
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


class _WithDepth:
    nuisance = ("noise", "log_depth")


def test_a_parameter_that_impacts_nearly_share_is_corrected_wherever_the_draws_have_it(monkeypatch) -> None:
    """Its mean moves fifty times as far as its conditional is wide; likelihoods are skew in it."""
    rng = np.random.default_rng(4)
    impacts, draws = 5, 64
    skew = np.array([0.1, 0.2, 0.3, 0.4, 0.5])

    def density(model, data, u):
        return -np.square(u).sum(-1) / 2 + skew * np.tanh(u[..., 3])

    monkeypatch.setattr(ratios, "log_likelihoods", density)
    own = np.broadcast_to(np.eye(4), (impacts, 4, 4))
    zero = np.zeros((impacts, 4))
    sites = ratios.GaussianFactor(zero, zero, own, np.zeros(impacts))  # type: ignore[arg-type]
    mean = 0.1 * rng.normal(size=(draws, impacts, 4))
    mean[..., 3] = rng.normal(size=(draws, 1))
    sd = np.array([1.0, 1.0, 1.0, 0.02])
    priors = ConditionalPrior(mean, np.broadcast_to(np.diag(sd**-2), (draws, 1, 4, 4)))
    found = importance_ratios(_WithDepth, None, sites, priors, rng.normal(size=(draws, 4)))  # type: ignore[arg-type]
    assert len(found.tables) == 2
    corrections = log_evidence_corrections(sites, found, priors)
    # So narrow a normal is its mean: the correction is the skew there, but for 0.02^2 and one constant.
    true = skew * np.tanh(mean[..., 3] / (1 + 0.02**2))
    error = corrections - true
    # Chebyshev's polynomial of nine nodes follows tanh over plus and minus three to about a hundredth.
    np.testing.assert_allclose(error - error.mean(0), 0, atol=0.02)


@pytest.mark.parametrize("scatter", [300.0, 744.0, 3000.0])
def test_weights_of_hundreds_of_nats_are_no_reason_to_trust_or_to_stop(scatter: float) -> None:
    log_weight = scatter * np.random.default_rng(3).normal(size=(4, 1000))
    log_weight[0, 0] = -np.inf
    found = Correction.from_log_weights(log_weight, 4000)
    assert found.pareto_k > 1
    assert not found.trusted
    assert np.isfinite(found.effective)
    assert found.row()["passed"] is False
