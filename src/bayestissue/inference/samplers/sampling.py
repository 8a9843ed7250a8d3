"""Draws of everything that a fit reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class ConstrainedDraws:
    """Draws of everything, each array [chain, draw, ...].

    ``sites`` are the hierarchy's quantities by the names of `bayestissue.hierarchy.effects`, ``impacts``
    those of every impact, ``log_likelihood`` the log density of each impact, subject and trial with its own
    parameters and effects integrated out. With ``kept_numbers`` impacts have these draws of each chain only,
    and log densities are those of some impacts.
    """

    sites: dict[str, np.ndarray]
    impacts: dict[str, np.ndarray]
    log_likelihood: dict[str, np.ndarray]
    kept_numbers: np.ndarray | None = None


def quantiles(
    draws: Float[np.ndarray, "quantity draw"],
    probabilities: Sequence[float],
    method: Literal["linear", "weibull"] = "linear",
) -> Float[np.ndarray, "probability quantity"]:
    """Quantiles of each quantity; where it is infinite in some draws, each is one of them.

    A quantity is infinite where what it is the time of never happens. Between a number and infinity there is
    nothing to interpolate.
    """
    with np.errstate(invalid="ignore"):
        between = np.quantile(draws, probabilities, axis=1, method=method)
    never = np.isinf(draws).any(axis=1)
    if never.any():
        between[:, never] = np.quantile(draws[never], probabilities, axis=1, method="inverted_cdf")
    return between


def thinned(draws: dict[str, Any], number: int) -> dict[str, Any]:
    """Every so many draws of each chain, so that about ``number`` are left of all chains."""
    chains, length = next(iter(draws.values())).shape[:2]
    step = max(1, chains * length // number)
    return {name: values[:, ::step] for name, values in draws.items()}
