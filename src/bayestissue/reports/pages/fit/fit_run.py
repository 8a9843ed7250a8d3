"""A finished `fit` as its page needs it, from memory or from its folder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.errors import InputError, all_of
from bayestissue.base.results.tables import read_table, table_of_rows, typed, wrong_in
from bayestissue.base.words import Words
from bayestissue.inference.answers.study import GROUPS, Study
from bayestissue.inference.results.meanings import COLUMNS, NAMES, element_alone, symbols
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.formulas.group_terms import stem_of
from bayestissue.reports.figures.impacts import end
from bayestissue.reports.pages.run_folder import (
    POSTERIOR_TABLES,
    PosteriorRun,
    of_population,
    open_tree,
    read_json,
    require_files,
    require_groups,
)

if TYPE_CHECKING:
    from bayestissue.inference.chain.results import ChainEnd
    from bayestissue.model.hierarchy.trace_data import Prepared
    from bayestissue.recordings.dataset import Dataset

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
# What the page can't do without, by group of `posterior.nc`.
_NEEDED = {
    "posterior": ("K", "C", "K_new", "C_new", "intercept_K", "intercept_C"),
    "posterior_predictive": ("deceleration",),
    "observed_data": ("displacement", "deceleration"),
    "constant_data": ("time", "mass_kg", "velocity_m_s", "impact_subject", "impact_trial"),
}
_AGAIN = "Make the run anew with `bayestissue fit`."


def _table(name: str, words: str) -> property:
    """The table of a run of this name, text and numbers as they are declared; ``words`` say what it has."""
    return property(lambda run: run.table(name), doc=words)


def _may_lack(name: str, words: str) -> cached_property[pd.DataFrame]:
    """The same of a table that few runs have, read once; empty where there is none."""

    def found(run: FitRun) -> pd.DataFrame:
        with suppress(KeyError):
            return run.table(name)
        # Of a simulated dataset, which knows the truth.
        if run.folder is not None and (run.folder / f"{name}.csv").is_file():
            return read_table(run.folder, name)
        return typed(name, table_of_rows(name))

    found.__doc__ = words
    return cached_property(found)


@dataclass(frozen=True, eq=False, repr=False)
class FitRun(PosteriorRun):
    """A finished fit as its pages, texts and figures read it, just made or read back from its folder.

    Attributes:
        about: the content of ``run.json``.
        posterior: the ArviZ DataTree with all groups of ``posterior.nc``: draws, predictions, densities,
            data. Of a run that was read back they are read from the file as they are needed.
        diagnostics: whether the sampler did its work (``passed``), and each check: ``diagnostics.json``.
            Besides, what is in doubt whatever the sampler did: ``measuring_chain`` (see
            `bayestissue.inference.checking.measuring_chain.judge`) and ``model_form``.
        table: a table of the folder by its name, such as "summary"; a KeyError where there is none.
        folder: of the run that was read back, or of the dataset that was fitted; None where it has none.
        dataset: what was fitted; None of a run that was read back, which has no recordings.
        prepared: the model and its data, likewise.
        end: where the chains ended, likewise; see `chain_end`.
    """

    about: dict[str, Any]
    posterior: xr.DataTree
    diagnostics: dict[str, Any]
    table: Callable[[str], pd.DataFrame]
    folder: Path | None = None
    dataset: Dataset | None = None
    prepared: Prepared | None = None
    end: ChainEnd | None = None

    summary = _table("summary", "Mean, median, intervals, R-hat, effective sample sizes of all quantities.")
    contrasts = _table("contrasts", "Ratios of K, C and outcomes between levels of categories and groups.")
    reliability = _table("reliability", "Intraclass correlations, error of measurement, detectable change.")
    agreement = _table("agreement", "Ratios of the thesis's method and the posterior.")
    point_estimates = _table("estimates_dds", 'Of every impact by the thesis\'s method, "dds" of `estimate`.')
    hypotheses = _table("hypotheses", "Probabilities of what is claimed of mass exponents.")
    sensitivity = _table("sensitivity", "How much prior and data move each quantity of the population.")
    cross_validation = _table("cross_validation", "Log predictive densities of what is left out in turn.")
    interval_sources = _table("interval_sources", "What each source of error has in the intervals.")
    levels = _table("levels", "Quantities at each level of a factor.")
    loops = _table("loops", "Force over depth at each level of a factor.")
    curves = _table("curves", "Outcomes over masses and velocities at each level of a factor.")
    truth = _may_lack("truth", "What simulated data were made from; empty of others.")
    questions = _may_lack("questions", "Answers to questions of the model file; those without one say why.")

    @classmethod
    def read(cls, folder: Path, record: dict[str, Any]) -> Self:
        """The run in a folder, whose ``run.json`` holds ``record``; its files are read as they are needed.

        Raises:
            InputError: files lack, or aren't what a run writes.
        """
        require_files(folder, ["posterior.nc", "diagnostics.json"])
        tree = open_tree(folder / "posterior.nc", dict.fromkeys(GROUPS, ()), _AGAIN)
        return cls(
            record, tree, read_json(folder / "diagnostics.json"), cache(partial(_stored, folder)), folder
        )

    def complete(self) -> Self:
        """The same, after every file that a page is made of was read.

        Raises:
            InputError: a file lacks or isn't what a run writes; all such files are named at once.
        """
        if self.dataset is None and (folder := self.folder) is not None:
            require_files(folder, [f"{name}.csv" for name in TABLES])
            readers: list[Callable[[], Any]] = [partial(self.table, name) for name in TABLES]
            readers += [lambda: self.truth, lambda: self.questions, lambda: self.groups, self._require_checks]
            all_of(lambda read: read(), readers)
        return self

    def _require_checks(self) -> None:
        if self.folder and "checks" not in self.diagnostics:
            raise InputError(wrong_in(self.folder / "diagnostics.json", 'the key "checks"', _AGAIN))

    @cached_property
    def groups(self) -> dict[str, xr.Dataset]:  # type: ignore[override]
        """The groups that pages show, in memory, without draws of single impacts.

        Their medians and intervals stand in ``summary``.
        """
        require_groups(self.posterior, _NEEDED, (self.folder or Path()) / "posterior.nc", _AGAIN)
        shown = of_population({name: self.posterior[name].to_dataset() for name in _NEEDED})
        return {name: data.load() for name, data in shown.items()}

    @property
    def record(self) -> dict[str, Any]:  # type: ignore[override]
        """``about``, with a name of the dataset."""
        name = self.about.get("dataset") or (self.folder.name if self.folder is not None else "")
        return self.about | {"dataset": name}

    @cached_property
    def study(self) -> Study:
        """The fit as questions and predictions need it."""
        return Study.from_tree(self.posterior, self.about["model"])

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
            name = f"K_secant_of_{stem_of(level)}"
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
            table["dds"] = self.point_estimates.set_index("impact")[column].reindex(table.index)
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


def _stored(folder: Path, name: str) -> pd.DataFrame:
    """A table of a run.

    Raises:
        KeyError: the run has none of this name.
    """
    if not (folder / f"{name}.csv").is_file():
        raise KeyError(name)
    return read_table(folder, name)
