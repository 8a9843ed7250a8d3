"""Draws in proportion to their importance weights."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int


def systematic(
    weight: Float[np.ndarray, "chain transition"], number: int, rng: np.random.Generator
) -> Int[np.ndarray, "chain number"]:
    """Systematic resampling (Kitagawa 1996): transitions of each chain, as often as their weights say.

    Of N transitions with weights w the i-th is taken floor or ceil(number w_i / sum w) times, in its order.
    Chains are resampled apart, so that R-hat still compares them; one without any weight stays as it is.

    Args:
        weight: not negative, up to a constant.
        number: how many transitions of each chain.
        rng: makes one offset of each chain.
    """
    weight = np.where(weight.sum(axis=1, keepdims=True) > 0, weight, 1.0)
    reached = np.cumsum(weight / weight.sum(axis=1, keepdims=True), axis=1)
    position = (np.arange(number) + rng.uniform(size=(len(weight), 1))) / number
    chosen = [np.searchsorted(*pair) for pair in zip(reached, position, strict=True)]
    return np.minimum(chosen, weight.shape[1] - 1)
