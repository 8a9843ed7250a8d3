from __future__ import annotations

import numpy as np

from bayestissue.inference.model_form import LIMIT, pooled_score


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
