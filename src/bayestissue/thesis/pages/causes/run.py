"""A finished `causes` run, read whole."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.errors import InputError
from bayestissue.report.run_folder import TableFile, read_tables, require_files, wrong_in
from bayestissue.thesis.causes.statistics import WORDS

_AGAIN = "Make the run anew with `bayestissue causes`."
_NUMBERS = (
    "probability",
    "probability_error",
    "campaigns",
    "complete",
    "p_joint",
    "smallest_p",
    "calibration_below_10",
    "calibration_below_50",
    "calibration_campaigns",
    "calibration_p",
)
_QUANTILES = ("q01", "q05", "q25", "q50", "q75", "q95", "q99")
_TABLES = (
    TableFile("causes", ("cause", "title", "nearest", "fails", "verdict"), _NUMBERS),
    TableFile("predictive", ("cause", "statistic"), _QUANTILES),
    TableFile("observed", ("statistic", "compared"), ("value",)),
    TableFile("confusion", ("truth",)),
    TableFile("reliability", (), ("probability", "right", "cases")),
)
# Causes that lie in how K was found, and not in what was hit.
_OF_METHOD = ("none", "centring", "conversion", "fixed window", "own time", "velocity")


@dataclass(frozen=True)
class CausesRun:
    """What the files of a `causes` run say; tables keep the columns of their files."""

    about: dict[str, Any]
    causes: pd.DataFrame
    predictive: pd.DataFrame
    observed: pd.DataFrame
    confusion: pd.DataFrame
    reliability: pd.DataFrame

    @property
    def statistics(self) -> list[str]:
        """The statistics that are drawn: those of the comparison, and the size of K/M."""
        return [name for name in self.observed["statistic"] if name in WORDS and name != "without_estimate"]

    @property
    def compared(self) -> list[str]:
        """The statistics of the joint comparison."""
        return list(self.observed.loc[self.observed["compared"] == "yes", "statistic"])

    def value(self, statistic: str) -> float:
        """The observed value of a statistic."""
        values = dict(zip(self.observed["statistic"], self.observed["value"], strict=True))
        return float(values[statistic])

    def mechanism(self, cause: str) -> str:
        """What acts in a cause."""
        return str(self.about["model"]["causes"][cause]["mechanism"])

    @property
    def of_method(self) -> pd.Series:
        """For each cause whether it lies in the method."""
        return self.causes["cause"].map(self.mechanism).isin(_OF_METHOD)


def read_causes_run(folder: Path, about: dict[str, Any]) -> CausesRun:
    """Read every file of the run in ``folder``, whose ``run.json`` holds ``about``.

    Raises:
        InputError: a file lacks or isn't what a run writes; all such files are named at once.
    """
    lacking = [key for key in ("model", "subject") if not isinstance(about.get(key), dict)]
    if lacking or "causes" not in about["model"]:
        column = (*lacking, "model")[0]
        raise InputError(wrong_in(folder / "run.json", "what every such run writes", _AGAIN, column=column))
    require_files(folder, [f"{layout.name}.csv" for layout in _TABLES])
    tables = dict(read_tables(folder, _TABLES))
    for name in tables["causes"].columns[tables["causes"].columns.str.startswith("p_")]:
        tables["causes"][name] = pd.to_numeric(tables["causes"][name], errors="coerce")
    told = list(tables["confusion"].columns[1:])
    tables["confusion"][told] = tables["confusion"][told].apply(pd.to_numeric, errors="coerce")
    return CausesRun(about=about, **tables)
