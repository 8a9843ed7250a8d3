"""A finished fit, as a comparison reads it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr


@dataclass(frozen=True)
class FinishedRun:
    """A finished `fit`.

    Attributes:
        name: what tables call it.
        model: the model as resolved, from ``run.json``.
        tree: the groups ``posterior`` (of single impacts what `bayestissue.inference.comparing.implied` asks
            for), ``log_likelihood``, ``log_likelihood_of_groups``, ``observed_data`` and ``constant_data``.
    """

    name: str
    model: Mapping[str, Any]
    tree: xr.DataTree

    @property
    def quantity(self) -> str:
        """What the likelihood is a density of: "deceleration" or "displacement"."""
        return "deceleration" if self.model["likelihood"] == "impact" else "displacement"

    @property
    def observed(self) -> xr.DataArray:
        """[impact, sample]: the very numbers that the likelihood is a density of."""
        return self.tree["observed_data"].dataset[self.quantity]

    @property
    def people(self) -> np.ndarray:
        """[impact]: whose each impact is."""
        return self.tree["constant_data"].dataset["impact_subject"].astype(str).to_numpy()
