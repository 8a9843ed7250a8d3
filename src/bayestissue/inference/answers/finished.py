"""A finished fit as questions and predictions need it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import xarray as xr

from bayestissue.elements.element import GRAVITY
from bayestissue.elements.head_injury import HEADFORM
from bayestissue.hierarchy import SIDE_BY_SIDE
from bayestissue.hierarchy.recorded import Recorded
from bayestissue.inference.answers.law import SLIGHT, Law
from bayestissue.inference.results.meanings import element_alone

GROUPS = ("posterior", "prior", "constant_data")


@dataclass(frozen=True, eq=False)
class Finished:
    """A finished fit.

    Attributes:
        posterior: draws, [chain, draw, ...].
        prior: draws of the same quantities from the priors alone; None where the run has none.
        recorded: what was measured.
        element: what the impactor met.
        discrepancy: whether a force of unknown shape acts beside the element's.
        gravity: along the motion [m/s^2].
        headform: whether what hits stands for a head.
    """

    posterior: xr.Dataset
    prior: xr.Dataset | None
    recorded: Recorded
    element: str = SIDE_BY_SIDE
    discrepancy: bool = False
    gravity: float = 0.0
    headform: bool = False

    @property
    def element_alone(self) -> bool:
        """Whether K is not the tissue's but the element's."""
        return element_alone(self.posterior)

    @property
    def law(self) -> Law | None:
        """What all impacts follow; beside a discrepancy there is none."""
        return None if self.discrepancy else self.law_of_levels

    @cached_property
    def law_of_levels(self) -> Law | None:
        """What impacts at given levels follow: beside a discrepancy those where it is `SLIGHT`, if any."""
        law = Law(self.element, self.gravity, self.headform)
        if not self.discrepancy:
            return law
        if "discrepancy" not in self.posterior:
            return None
        draws = self.posterior["discrepancy"]
        share = draws.median([name for name in draws.dims if name != "impact"]).to_numpy()
        return replace(law, described=share < SLIGHT) if (share < SLIGHT).any() else None

    @classmethod
    def from_tree(cls, tree: xr.DataTree, model: Mapping[str, Any]) -> Finished:
        """Of the groups `GROUPS` of ``posterior.nc`` and the model as ``run.json`` has it resolved."""
        posterior = tree["posterior"].to_dataset()
        constants = tree["constant_data"].to_dataset()
        return cls(
            posterior,
            tree["prior"].to_dataset() if "prior" in tree.children else None,
            Recorded.of_run(constants, model),
            str(model.get("element", SIDE_BY_SIDE)),
            # A reader may have left out what impacts have.
            "discrepancy_mean" in posterior,
            float(constants[GRAVITY]) if GRAVITY in constants else 0.0,
            HEADFORM in constants,
        )
