from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from bayestissue.inference.checking.model_form import (
    LIMIT,
    model_form,
    pooled_score,
    stated,
    with_discrepancy,
)


def traces(seed: int, swing: float) -> tuple[np.ndarray, np.ndarray]:
    """Thirty traces with white noise about half a sine, beside replicates; ``swing`` adds another wave."""
    rng = np.random.default_rng(seed)
    length, draws = 80, 100
    time = np.linspace(0, 1, length)
    shape = 100 * np.sin(np.pi * time)
    measured = shape + rng.standard_normal((30, length)) + swing * np.sin(6 * np.pi * time)
    # The chain's errors are other in every replicate.
    slope = 2 * rng.standard_normal((draws, 30, 1)) * time
    replicated = shape + rng.standard_normal((draws, 30, length)) + slope
    measured[:, 70:], replicated[..., 70:] = np.nan, np.nan
    return measured, replicated


def test_noise_scores_as_a_standard_normal() -> None:
    scores = np.array([pooled_score(*traces(seed, 0.0)) for seed in range(20)])
    # Twenty draws: their mean is within four standard errors of 0, and none is beyond the limit.
    assert abs(scores.mean()) < 4 / np.sqrt(20)
    assert scores.max() < LIMIT


def test_a_wave_as_large_as_the_noise_is_structure() -> None:
    assert pooled_score(*traces(1, 1.0)) > LIMIT


def tree(swing: float) -> xr.DataTree:
    measured, replicated = traces(1, swing)
    dims, drawn = ("impact", "sample"), ("chain", "draw", "impact")
    names = {"impact": [f"i{k}" for k in range(len(measured))]}
    sizes = np.linspace(0.05, 0.07, 30) * np.ones((2, 50, 1))
    # Evenly from exp(-0.1) to exp(0.1): 90 % of it lies within exp(0.09) of the middle.
    stiffness = np.exp(np.linspace(-0.1, 0.1, 100)).reshape(2, 50, 1) * np.ones(30)
    replicates = replicated.reshape(2, 50, *measured.shape)
    return xr.DataTree.from_dict(
        {
            "observed_data": xr.Dataset({"deceleration": (dims, measured)}, names),
            "posterior_predictive": xr.Dataset({"deceleration": ((*drawn[:2], *dims), replicates)}, names),
            "posterior": xr.Dataset({"discrepancy": (drawn, sizes), "K_secant": (drawn, stiffness)}, names),
        }
    )


FIRST = model_form(tree(1.0), "deceleration")


def test_the_words_of_a_fit_with_a_discrepancy_keep_the_first_fit_s_score() -> None:
    last = model_form(tree(0.0), "deceleration")
    assert FIRST["structured"]
    assert "intervals are too narrow" in FIRST["words"]
    found = with_discrepancy(FIRST, tree(0.0))
    assert found["structured"]
    assert (found["score"], found["left"]) == (FIRST["score"], last["score"])
    assert found["discrepancy"] == pytest.approx(0.06)
    parts = ("another law", "include a discrepancy", "6 % of the peak", "other elements", "known to 9.4 %")
    assert [part for part in parts if part not in found["words"]] == []
    assert "too narrow" not in found["words"]


def test_the_impacts_that_obey_another_law_are_named() -> None:
    made = tree(0.0)
    made["posterior"].dataset["discrepancy"].to_numpy()[:] *= 0.01
    made["posterior"].dataset["discrepancy"].to_numpy()[..., [3, 5]] = [0.1, 0.12]
    found = with_discrepancy(FIRST, made)
    assert found["apart"] == ["i5", "i3"]
    assert "% of the peak in the median impact, and up to 12 % in 2 of 30 (i5, i3)" in found["words"]
    assert with_discrepancy(FIRST, tree(0.0))["apart"] == []


def test_a_discrepancy_beyond_the_limit_leaves_no_interval() -> None:
    made = tree(0.0)
    made["posterior"].dataset["discrepancy"].to_numpy()[..., 3] = 0.4
    found = with_discrepancy(FIRST, made)
    assert (found["undescribed"], found["undescribed_impacts"]) == (False, ["i3"])
    made["posterior"].dataset["discrepancy"].to_numpy()[:] *= 5
    found = with_discrepancy(FIRST, made)
    assert found["undescribed"]
    assert len(found["undescribed_impacts"]) == 30
    assert "No element of this program describes these traces" in found["words"]
    # No interval in the words either.
    assert "known to" not in found["words"]


def test_structure_that_a_measuring_chain_explains_is_not_called_another_law() -> None:
    form = with_discrepancy(FIRST, tree(0.0))
    chain = {"passed": False, "error": "velocity and gain", "structure_left": 0.4}
    words = stated(form, chain)["words"]
    assert "wrong measuring chain explains it" in words
    assert "another law than" not in words
    assert "Mend the measuring chain first" in words
    assert stated(form, {"passed": None}) == form
