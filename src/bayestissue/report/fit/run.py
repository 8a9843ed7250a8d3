"""A finished `fit` as its page needs it, from memory or from its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.elements.element import GRAVITY
from bayestissue.errors import InputError, all_of
from bayestissue.figures.impacts import end
from bayestissue.hierarchy import SIDE_BY_SIDE
from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.inference.results.meanings import COLUMNS, NAMES, element_alone, symbols
from bayestissue.report.run_folder import (
    POSTERIOR_TABLES,
    PosteriorRun,
    of_population,
    read_groups,
    read_json,
    require_files,
)
from bayestissue.results import read_tables
from bayestissue.results.tables import table_of_rows, typed, wrong_in
from bayestissue.words import Words

# What means the same for every element, where the truth is another element's.
COMPARABLE = {"K": "K_secant_N_per_m", "C": "C_equivalent_N_s_per_m"}
TABLES = (
    *POSTERIOR_TABLES,
    "cross_validation",
    "estimates_dds",
    "interval_sources",
    "contrasts",
    "levels",
    "loops",
    "curves",
    "reliability",
)
# Only simulated data have a truth, and few model files questions.
FURTHER_TABLES = ("truth", "questions")
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
    ``truth`` is empty unless the data were simulated, ``questions`` unless some were asked.
    """

    cross_validation: pd.DataFrame
    estimates_dds: pd.DataFrame
    truth: pd.DataFrame
    interval_sources: pd.DataFrame
    questions: pd.DataFrame
    contrasts: pd.DataFrame
    levels: pd.DataFrame
    loops: pd.DataFrame
    curves: pd.DataFrame
    reliability: pd.DataFrame

    def of_impacts(self, variable: str) -> pd.DataFrame:
        """The rows of ``summary`` for an impact's ``variable``, by impact; empty if the model has none."""
        chosen = self.summary[self.summary["variable"] == variable].set_index("label")
        return chosen if chosen.empty else chosen.reindex(self.impacts)

    @property
    def element_alone(self) -> bool:
        """Whether beside a discrepancy K is the element's own, and the tissue's stiffness is K_secant."""
        return element_alone(self.groups["posterior"])

    @property
    def symbols(self) -> dict[str, str]:
        """The variables of an impact that are the tissue's stiffness and damping."""
        return symbols(self.groups["posterior"])

    @property
    def names(self) -> dict[str, str]:
        """What they are called in figures."""
        return NAMES | ({"K": "secant stiffness K_secant"} if self.element_alone else {})

    def of_levels(self, quantity: str, level: str) -> str:
        """The variable of K (or C, or another) of the tissue in each level of a grouping; else empty."""
        name = f"{quantity}_{stem_of(level)}"
        if quantity == "K" and self.element_alone:
            name = "K_secant_of_subject" if level == "subject" else ""
        return name if self.has(name) else ""

    @cached_property
    def impacts(self) -> list[str]:
        """The names of the impacts."""
        return [str(label) for label in self.groups["constant_data"]["impact"].to_numpy()]

    @cached_property
    def estimates_by_method(self) -> dict[str, pd.DataFrame]:
        """For K and for C, in N/m and N s/m, a row an impact: its posterior and its point estimates.

        Posterior ``median``, ``eti50_*`` and ``eti90_*``, of `symbols`; ``dds``; ``truth``, of
        another element's tissue the secant stiffness or equivalent damping. What an impact lacks is NaN.
        """
        names = ["median", "eti50_low", "eti50_high", "eti90_low", "eti90_high"]
        same = self.record.get("model", {}).get("element", SIDE_BY_SIDE) == SIDE_BY_SIDE
        tables = {}
        for q, column in COLUMNS.items():
            table = self.of_impacts(self.symbols[q])[names].copy()
            table["dds"] = self.estimates_dds.set_index("impact")[column].reindex(table.index)
            comparable = same or self.symbols[q] != q
            true = COMPARABLE[q] if comparable and COMPARABLE[q] in self.truth else column
            table["truth"] = self.truth.set_index("impact")[true].reindex(table.index)
            tables[q] = table
        return tables

    @cached_property
    def nouns(self) -> Words:
        """What the dataset calls people, conditions and impacts; its own names stay as they are."""
        record, table = self.record, self.impacts_table.select_dtypes(exclude="number")
        names = {str(value) for name in table for value in table[name].unique()}
        model = record.get("model", {}).get("name", "")
        labels = {str(record.get("dataset", "")), str(record.get("description", "")), f"“{model}”", *names}
        return Words(record.get("words", {}), labels)

    @cached_property
    def impacts_table(self) -> pd.DataFrame:
        """A row an impact: who and how, K and C with their 90 % intervals, the truth of simulated data.

        ``unlike`` says how far K or C lies from what its person and condition let one expect, in robust
        standard deviations of all impacts.
        """
        further = {
            str(array.attrs.get("column", str(name).removeprefix("column_"))): array.to_numpy().astype(str)
            for name, array in self.groups["constant_data"].data_vars.items()
            if str(name).startswith("column_") and array.dtype.kind in "UOS"
        }
        table = pd.DataFrame(
            {
                "impact": self.impacts,
                "person": self.constant("impact_subject").astype(str),
                "condition": self.constant("impact_trial").astype(str),
                **further,
                "mass_kg": self.constant("mass_kg"),
                "velocity_m_s": self.constant("velocity_m_s"),
            }
        )
        unlike = np.zeros(len(table))
        for q, values in self.estimates_by_method.items():
            table[COLUMNS[q]] = values["median"].to_numpy()
            for side in ("low", "high"):
                table[end(q, side)] = values[f"eti90_{side}"].to_numpy()
            if values["truth"].notna().any():
                table[f"true_{q}"] = values["truth"].to_numpy()
            left = np.log(table[COLUMNS[q]])
            for level in ("person", "condition"):
                left = left - left.groupby(table[level]).transform("median")
            scatter = 1.4826 * float(left.abs().median())
            unlike = np.maximum(unlike, (left.abs() / scatter).to_numpy() if scatter > 0 else 0.0)
        return table.assign(unlike=np.round(unlike, 2))

    @property
    def people_count(self) -> int:
        """How many people there are: of one, nothing is said of a typical or a new person."""
        return len(self.labels("subject"))

    @cached_property
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
    def gravity(self) -> float:
        """The part of gravity along the motion [m/s^2]."""
        return float(self.groups["constant_data"].get(GRAVITY, 0.0))

    @property
    def undescribed(self) -> bool:
        """Whether the traces are not described, so that no interval of K or C is one."""
        return bool(self.diagnostics.get("model_form", {}).get("undescribed", False))

    @property
    def tested(self) -> dict[str, float]:
        """p-values of each impact's residuals being the model's noise; empty where the fit tested none."""
        return dict(self.diagnostics.get("model_form", {}).get("impacts", {}).get("p", {}))

    @property
    def force_form(self) -> dict[str, Any]:
        """What the residuals of a force beside the deceleration say; empty without one in the fit."""
        return dict(self.diagnostics.get("channels", {}).get("form", {}))

    @property
    def chain(self) -> dict[str, Any]:
        """What the traces say of their measuring chain; empty where they were not asked."""
        return dict(self.diagnostics.get("measuring_chain", {}))

    @property
    def responses(self) -> tuple[str, ...]:
        """K, C and the further parameters that have a formula."""
        return tuple(dict.fromkeys(("K", "C", *self.record.get("model", {}).get("formula", {}))))

    @property
    def of_tissue(self) -> tuple[str, ...]:
        """`responses` without a K that is the element's own."""
        return tuple(q for q in self.responses if q != "K" or not self.element_alone)

    @property
    def likelihood(self) -> str:
        """``"arma"``, ``"a2"`` or ``"impact"``."""
        return str(self.record.get("model", {}).get("likelihood", ""))

    @property
    def shown(self) -> str:
        """Which of ``"deceleration"`` and ``"displacement"`` is drawn."""
        return "displacement" if self.record.get("quantity") == "displacement" else "deceleration"

    def times(self, what: str | None = None) -> np.ndarray:
        """[impact, sample]: when the samples of what is drawn, or of ``what``, were since contact [s]."""
        return self.constant("force_time" if (what or self.shown) == "force" else "time")


def fit_run(
    record: dict[str, Any],
    diagnostics: dict[str, Any],
    tree: xr.DataTree,
    tables: Mapping[str, pd.DataFrame],
) -> FitRun:
    """A fit in memory: the content of ``run.json`` and ``diagnostics.json``, its draws, tables by name."""
    return FitRun(
        record=record,
        diagnostics=diagnostics,
        groups=of_population({name: tree[name].to_dataset() for name in _NEEDED}),
        **{name: typed(name, tables[name]) for name in TABLES},
        **_further(tables),
    )


def read_fit_run(folder: Path, record: dict[str, Any]) -> FitRun:
    """Read every file of the run in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: a file lacks or isn't what a run writes; all such files are named at once.
    """
    require_files(folder, [*(f"{name}.csv" for name in TABLES), "diagnostics.json", "posterior.nc"])
    record = record | {"dataset": record.get("dataset") or folder.name}
    readers: tuple[Callable[[], Any], ...] = (
        lambda: read_tables(folder, TABLES, FURTHER_TABLES),
        lambda: read_groups(folder / "posterior.nc", _NEEDED, _AGAIN, of_impacts=()),
        lambda: _read_diagnostics(folder / "diagnostics.json"),
    )
    tables, groups, diagnostics = all_of(lambda read: read(), readers)
    return FitRun(record=record, diagnostics=diagnostics, groups=groups, **(tables | _further(tables)))


def _further(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """The tables that a run may lack; those that it lacks are empty."""
    return {
        name: typed(name, tables[name] if name in tables else table_of_rows(name)) for name in FURTHER_TABLES
    }


def _read_diagnostics(path: Path) -> dict[str, Any]:
    content = read_json(path)
    if "checks" not in content:
        raise InputError(wrong_in(path, 'the key "checks"', _AGAIN))
    return content
