"""The secant stiffness of the recorded impacts together, and of each person's."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from bayestissue.inference.quantities.secants import comparable_draws

SHAPE = (2, 5)


@pytest.mark.parametrize("dimension", ["draw", "kept_draw"])
def test_these_impacts_and_each_person_s_have_the_geometric_mean_of_their_own(dimension: str) -> None:
    draws = np.exp(np.random.default_rng(2).normal(7, 0.3, (*SHAPE, 3)))
    people = np.array(["b", "a", "b"])
    posterior = xr.Dataset({"K_secant": (("chain", dimension, "impact"), draws)})
    found = comparable_draws(posterior, {"subject": people, "pad:site": people})
    assert set(found) == {"K_secant_of_impacts", "K_secant_of_subject", "K_secant_of_pad_site"}
    # Roundings of a logarithm, a sum and an exponential.
    close = {"rtol": 100 * np.finfo(float).eps}
    np.testing.assert_allclose(found["K_secant_of_impacts"], draws.prod(-1) ** (1 / 3), **close)
    of_people = found["K_secant_of_subject"]
    np.testing.assert_allclose(of_people.sel(subject="a"), draws[..., 1], **close)
    np.testing.assert_allclose(of_people.sel(subject="b"), np.sqrt(draws[..., 0] * draws[..., 2]), **close)
