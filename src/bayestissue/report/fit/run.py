"""A finished `fit`, read whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.errors import InputError, all_of
from bayestissue.report.run_folder import (
    POSTERIOR_TABLES,
    PosteriorRun,
    TableFile,
    read_groups,
    read_json,
    read_tables,
    require_files,
    wrong_in,
)

COLUMN = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
# What means the same for every element, where the truth is another element's.
COMPARABLE = {"K": "K_secant_N_per_m", "C": "C_equivalent_N_s_per_m"}
_ESTIMATES = (("impact", "subject", "trial", "flags"), ("mass_kg", *COLUMN.values()))
_TABLES = (
    *POSTERIOR_TABLES,
    TableFile("cross_validation", ("scheme", "label", "warning"), ("elpd", "pareto_k")),
    TableFile("estimates_exact", *_ESTIMATES),
    TableFile("estimates_dds", *_ESTIMATES),
)
_TRUTH = TableFile("truth", ("impact",), tuple(COLUMN.values()), tuple(COMPARABLE.values()))
_SOURCES = TableFile("interval_sources", ("level", "quantity", "source"), ("share", "sd"))
_QUESTIONS = TableFile(
    "questions",
    ("question", "name", "note"),
    ("posterior", "prior", "bayes_factor", "mcse", "median", "low", "high"),
)
_RATIOS = ("ratio", "low", "high")
_CONTRASTS = TableFile(
    "contrasts",
    ("factor", "level", "against", "quantity"),
    (*_RATIOS, "p_direction", "p_equivalent"),
)
_RELIABILITY = TableFile(
    "reliability", ("quantity", "measure", "form", "unit"), ("median", "low", "high"), ("prior_overlap",)
)
_PEOPLE = TableFile("people", ("quantity", "person", "against"), ("p_greater", *_RATIOS))
# Not every run has them, by the field that holds each: only simulated data a truth, earlier runs less, few
# model files questions.
_OPTIONAL = {
    "truth": _TRUTH,
    "interval_sources": _SOURCES,
    "contrasts": _CONTRASTS,
    "people_compared": _PEOPLE,
    "reliability": _RELIABILITY,
    "questions": _QUESTIONS,
}
# What the page can't do without, by group of `posterior.nc`.
_NEEDED = {
    "posterior": ("K", "C", "K_new", "C_new", "intercept_K", "intercept_C"),
    "posterior_predictive": ("deceleration",),
    "observed_data": ("displacement", "deceleration"),
    "constant_data": ("time", "mass_kg", "velocity_m_s", "impact_subject", "impact_trial"),
}
_AGAIN = "Make the run anew with `bayestissue fit`."


@dataclass(frozen=True)
class FitRun(PosteriorRun):
    """What the files of a `fit` say.

    Draws of single impacts are left out of ``groups``: their medians and intervals stand in ``summary``.
    ``truth`` is None unless the data were simulated, and so is what follows it where an earlier version made
    the run.
    """

    cross_validation: pd.DataFrame
    estimates_exact: pd.DataFrame
    estimates_dds: pd.DataFrame
    truth: pd.DataFrame | None
    interval_sources: pd.DataFrame | None = None
    questions: pd.DataFrame | None = None
    contrasts: pd.DataFrame | None = None
    people_compared: pd.DataFrame | None = None
    reliability: pd.DataFrame | None = None

    def of_impacts(self, variable: str) -> pd.DataFrame:
        """The rows of ``summary`` for an impact's ``variable``, by impact; empty if the model has none."""
        chosen = self.summary[self.summary["variable"] == variable].set_index("label")
        return chosen if chosen.empty else chosen.reindex(self.impacts)

    @property
    def impacts(self) -> list[str]:
        """The names of the impacts."""
        return [str(label) for label in self.groups["constant_data"]["impact"].to_numpy()]

    @property
    def people(self) -> int:
        """How many people there are: of one, nothing is said of a typical or a new person."""
        return len(self.labels("subject"))

    @property
    def predicted(self) -> np.ndarray:
        """The rows of `impacts` that have predicted traces: all, or some where impacts are many."""
        names = self.groups["posterior_predictive"]["impact"].to_numpy().astype(str)
        places = pd.Index(self.impacts).get_indexer(pd.Index(names))
        return np.asarray(places)

    @property
    def impact_draws(self) -> int | None:
        """How many draws of each single impact were kept; None if all."""
        count = self.record.get("kept_draws_of_an_impact")
        return None if count is None else int(count)

    @property
    def reference_mass(self) -> float:
        """The mass in kg at which people are reported."""
        stated = self.record.get("model", {}).get("reference_mass_kg")
        return float(np.exp(np.log(self.constant("mass_kg")).mean()) if stated is None else stated)

    @property
    def undescribed(self) -> bool:
        """Whether no element describes the traces, so that no interval of K or C is one."""
        return bool(self.diagnostics.get("model_form", {}).get("undescribed", False))

    @property
    def tested(self) -> dict[str, float]:
        """p-values of each impact's residuals being the model's noise; empty where the fit tested none."""
        return dict(self.diagnostics.get("model_form", {}).get("impacts", {}).get("p", {}))

    @property
    def chain(self) -> dict[str, Any]:
        """What the traces say of their measuring chain; empty where they were not asked."""
        return dict(self.diagnostics.get("measuring_chain", {}))

    @property
    def responses(self) -> tuple[str, ...]:
        """K, C and the further parameters that have a formula."""
        return tuple(dict.fromkeys(("K", "C", *self.record.get("model", {}).get("formula", {}))))

    @property
    def likelihood(self) -> str:
        """``"arma"``, ``"a2"`` or ``"impact"``."""
        return str(self.record.get("model", {}).get("likelihood", ""))

    @property
    def shown(self) -> str:
        """Which of ``"deceleration"`` and ``"displacement"`` was recorded, and so is drawn."""
        return "displacement" if self.record.get("quantity") == "displacement" else "deceleration"


def read_fit_run(folder: Path, record: dict[str, Any]) -> FitRun:
    """Read every file of the run in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: a file lacks or isn't what a run writes; all such files are named at once.
    """
    names = [f"{layout.name}.csv" for layout in _TABLES]
    require_files(folder, [*names, "diagnostics.json", "posterior.nc"])
    present = [table for table in _OPTIONAL.values() if (folder / f"{table.name}.csv").is_file()]
    layouts = (*_TABLES, *present)
    readers: tuple[Callable[[], Any], ...] = (
        lambda: dict(read_tables(folder, layouts)),
        lambda: read_groups(folder / "posterior.nc", _NEEDED, _AGAIN, of_impacts=()),
        lambda: _read_diagnostics(folder / "diagnostics.json"),
    )
    tables, groups, diagnostics = all_of(lambda read: read(), readers)
    optional: dict[str, Any] = {field: tables.pop(table.name, None) for field, table in _OPTIONAL.items()}
    return FitRun(record=record, diagnostics=diagnostics, groups=groups, **optional, **tables)


def _read_diagnostics(path: Path) -> dict[str, Any]:
    content = read_json(path)
    if "checks" not in content:
        raise InputError(wrong_in(path, 'the key "checks"', _AGAIN))
    return content
