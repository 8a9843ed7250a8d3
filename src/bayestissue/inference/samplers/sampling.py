"""Draws as samplers return them, and those of everything that follows from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

STATISTICS = ("diverging", "num_steps", "accept_prob", "energy", "potential_energy")


@dataclass(frozen=True)
class Draws:
    """What the sampler returned: ``sites`` [chain, draw, ...] and ``statistics`` [chain, transition]."""

    sites: dict[str, np.ndarray]
    statistics: dict[str, np.ndarray]
    max_tree_depth: int

    def thinned(self, thinning: int) -> Draws:
        """The same with the last of so many draws only, and the statistics of all."""
        sites = {name: values[:, thinning - 1 :: thinning] for name, values in self.sites.items()}
        return replace(self, sites=sites)


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


def thinned(draws: dict[str, Any], number: int) -> dict[str, Any]:
    """Every so many draws of each chain, so that about ``number`` are left of all chains."""
    chains, length = next(iter(draws.values())).shape[:2]
    step = max(1, chains * length // number)
    return {name: values[:, ::step] for name, values in draws.items()}
