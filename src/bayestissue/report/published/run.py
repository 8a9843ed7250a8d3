"""A finished `reproduce` run, read whole."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.errors import InputError, Problem
from bayestissue.report.run_folder import TableFile, read_json, read_tables, require_files

_INTERVALS = ("median", "eti50_low", "eti50_high", "eti90_low", "eti90_high")
_TABLES = (
    TableFile("reproduction", ("table", "row", "quantity", "published", "reproduced", "agrees", "note")),
    TableFile("audit", ("where", "what", "published", "implied", "severity", "explanation")),
    TableFile(
        "summary",
        ("variable", "label", "unit"),
        ("mean", "sd", *_INTERVALS, "ess_bulk", "ess_tail", "r_hat", "mcse_mean"),
    ),
    TableFile("hypotheses", ("quantity", "hypothesis"), ("value", "rope_low", "rope_high", "probability")),
    TableFile(
        "comparison",
        ("scheme", "model", "warning"),
        ("elpd", "se", "elpd_difference", "se_difference", "p_effective", "weight"),
    ),
    TableFile("sensitivity", ("variable", "diagnosis"), ("prior", "likelihood")),
    TableFile(
        "predictive_checks",
        ("statistic", "quantity"),
        ("observed", "predicted_median", "predicted_low", "predicted_high", "p_value"),
    ),
)
_GROUPS = ("posterior", "observed_data", "posterior_predictive", "constant_data")


@dataclass(frozen=True)
class PublishedRun:
    """What the files of a `reproduce` run say.

    ``groups`` holds the data sets of `posterior.nc` that the report shows; the tables keep their column
    names, text as it was written and numbers as float64.
    """

    about: dict[str, Any]
    diagnostics: dict[str, Any]
    groups: dict[str, xr.Dataset]
    reproduction: pd.DataFrame
    audit: pd.DataFrame
    summary: pd.DataFrame
    hypotheses: pd.DataFrame
    comparison: pd.DataFrame
    sensitivity: pd.DataFrame
    predictive_checks: pd.DataFrame

    def draws(self, variable: str, group: str = "posterior") -> np.ndarray:
        """All draws of ``variable``, [draw, ...]: chains one after the other."""
        array = self.groups[group][variable].transpose("chain", "draw", ...)
        return array.to_numpy().reshape(-1, *array.shape[2:])

    def has(self, variable: str, group: str = "posterior") -> bool:
        """Whether the model has ``variable``; one without mass, say, has no mass exponent."""
        return variable in self.groups[group]

    def labels(self, dimension: str) -> list[str]:
        """The labels along ``dimension``."""
        return [str(label) for label in self.groups["posterior"][dimension].to_numpy()]

    def constant(self, name: str) -> np.ndarray:
        """One of the numbers that the model was given, such as ``mass_kg`` [trial]."""
        return self.groups["constant_data"][name].to_numpy()

    def observed(self, name: str) -> np.ndarray:
        """What was published, such as ``K_observed`` [impact]."""
        return self.groups["observed_data"][name].to_numpy()

    @property
    def reference_mass(self) -> float:
        """The mass in kg at which people and conditions are reported."""
        return float(self.constant("reference_mass_kg"))


def read_published_run(folder: Path, about: dict[str, Any]) -> PublishedRun:
    """Read every file of the run in ``folder``, whose ``run.json`` holds ``about``.

    Raises:
        InputError: a file lacks or isn't what a run writes; all such files are named at once.
    """
    names = [f"{layout.name}.csv" for layout in _TABLES]
    require_files(folder, [*names, "diagnostics.json", "posterior.nc"])
    return PublishedRun(
        about=about,
        diagnostics=read_json(folder / "diagnostics.json"),
        groups=_read_groups(folder / "posterior.nc"),
        **read_tables(folder, _TABLES),
    )


def _read_groups(path: Path) -> dict[str, xr.Dataset]:
    try:
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            return {name: tree[name].to_dataset().load() for name in _GROUPS}
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            Problem(
                str(path),
                expected="a DataTree with the groups " + ", ".join(_GROUPS),
                remedy="Make the run anew with `bayestissue reproduce`.",
                value=str(error),
                code="damaged-run",
            )
        ) from error
