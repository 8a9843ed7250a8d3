"""A finished `reproduce` run, read whole."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.report.run_folder import (
    POSTERIOR_TABLES,
    PosteriorRun,
    read_groups,
    read_json,
    require_files,
)
from bayestissue.results import read_tables

_TABLES = (*POSTERIOR_TABLES, "reproduction", "audit", "comparison", "predictive_checks")
_GROUPS: dict[str, tuple[str, ...]] = dict.fromkeys(
    ("posterior", "observed_data", "posterior_predictive", "constant_data"), ()
)


@dataclass(frozen=True)
class PublishedRun(PosteriorRun):
    """What the files of a `reproduce` run say."""

    reproduction: pd.DataFrame
    audit: pd.DataFrame
    comparison: pd.DataFrame
    predictive_checks: pd.DataFrame

    def observed(self, name: str) -> np.ndarray:
        """What was published, such as ``K_observed`` [impact]."""
        return self.groups["observed_data"][name].to_numpy()

    @property
    def reference_mass(self) -> float:
        """The mass in kg at which people and conditions are reported."""
        return float(self.constant("reference_mass_kg"))


def read_published_run(folder: Path, record: dict[str, Any]) -> PublishedRun:
    """Read every file of the run in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: a file lacks or isn't what a run writes; all that lack are named at once.
    """
    names = [f"{name}.csv" for name in _TABLES]
    require_files(folder, [*names, "diagnostics.json", "posterior.nc"])
    return PublishedRun(
        record=record,
        diagnostics=read_json(folder / "diagnostics.json"),
        groups=read_groups(
            folder / "posterior.nc", _GROUPS, "Make the run anew with `bayestissue reproduce`."
        ),
        **read_tables(folder, _TABLES),
    )
