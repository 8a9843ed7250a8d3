"""A weakly identified parameter's likelihood on a grid of places."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayestissue.inference.factors.grid import PLACES, LikelihoodGrid

log_evidence = jax.jit(LikelihoodGrid.log_evidence)


def grid_of(sd: np.ndarray, centre: float = 0.83) -> LikelihoodGrid:
    """Normal likelihoods so wide, about a centre between two places."""
    return LikelihoodGrid(jnp.asarray(-(((PLACES[:, None] - centre) / sd) ** 2) / 2))


@pytest.mark.parametrize(
    ("sd", "resolved"),
    [
        pytest.param([0.3] * 20, True, id="wider than the places are apart"),
        # All twenty of these have their maximum at one place, whatever their truth between two.
        pytest.param([0.006] * 20, False, id="narrower"),
        pytest.param([0.3] * 17 + [0.006] * 3, False, id="three of twenty narrower"),
        pytest.param([0.3] * 19 + [0.006], True, id="one of twenty narrower"),
        pytest.param([1e3] * 20, True, id="level"),
    ],
)
def test_likelihoods_between_the_places_are_refused(sd: list[float], resolved: bool) -> None:
    assert grid_of(np.array(sd)).resolved == resolved


def test_a_grid_without_a_number_is_refused() -> None:
    table = np.array(grid_of(np.full(20, 0.3)).log_likelihood)
    table[:, 7] = np.nan
    assert not LikelihoodGrid(jnp.asarray(table)).resolved


def test_the_evidence_of_a_resolved_grid_is_the_normals() -> None:
    sd, spread, mean = np.array([0.3, 0.1, 0.05]), 0.2, 0.9
    with jax.enable_x64(True):
        grid = grid_of(sd)
        found = log_evidence(grid, mean, spread)
    variance = sd**2 + spread**2
    exact = np.log(sd) - np.log(variance) / 2 - (mean - 0.83) ** 2 / 2 / variance
    # Cubics repeat a quadratic; what is left is of the points over a population four times as wide.
    np.testing.assert_allclose(found, exact, atol=1e-3)
