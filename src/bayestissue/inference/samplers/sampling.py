"""What samplers return."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
