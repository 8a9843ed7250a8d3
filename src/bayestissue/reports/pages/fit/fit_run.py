"""A finished `fit` as its page needs it, from memory or from its folder, with its groups and their slopes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.errors import InputError
from bayestissue.base.results.tables import read_table, table_of_rows, typed, wrong_in
from bayestissue.base.words import Words
from bayestissue.inference.answers.study import GROUPS, Study
from bayestissue.inference.results.meanings import COLUMNS, NAMES, element_alone, symbols
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.formulas.group_terms import stem_of
from bayestissue.reports.figures.impacts import end
from bayestissue.reports.pages.posterior import without_zero
from bayestissue.reports.pages.run_folder import POSTERIOR_TABLES, PosteriorRun, of_table
from bayestissue.reports.pages.wording import names_in, nouns_of

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


def _may_lack(name: str, words: str) -> cached_property[pd.DataFrame]:
    """The same of a table that few runs have, read once; empty where there is none."""

    def optional_table(run: FitRun) -> pd.DataFrame:
        with suppress(KeyError):
            return run.table(name)
        # Of a simulated dataset, which knows the truth.
        if run.folder is not None and (run.folder / f"{name}.csv").is_file():
            return read_table(run.folder, name)
        return typed(name, table_of_rows(name))

    optional_table.__doc__ = words
    return cached_property(optional_table)


@dataclass(frozen=True, eq=False, repr=False)
class FitRun(PosteriorRun):
    """A finished fit as its pages, texts and figures read it, just made or read back from its folder.

    Attributes:
        dataset: what was fitted; None of a run that was read back, which has no recordings.
        prepared: the model and its data, likewise.
        end: where the chains ended, likewise; see `chain_end`.
    """

    opened = GROUPS
    needed: ClassVar = {
        "posterior": ("K", "C", "K_new", "C_new", "intercept_K", "intercept_C"),
        "posterior_predictive": ("deceleration",),
        "observed_data": ("displacement", "deceleration"),
        "constant_data": ("time", "mass_kg", "velocity_m_s", "impact_subject", "impact_trial"),
    }
    table_files = TABLES
    again = "Make the run anew with `bayestissue fit`."

    dataset: Dataset | None = None
    prepared: Prepared | None = None
    end: ChainEnd | None = None

    contrasts = of_table("contrasts", "Ratios of K, C and outcomes between levels of categories and groups.")
    reliability = of_table("reliability", "Intraclass correlations, error of measurement, detectable change.")
    agreement = of_table("agreement", "Ratios of the thesis's method and the posterior.")
    point_estimates = of_table(
        "estimates_dds", 'Of every impact by the thesis\'s method, "dds" of `estimate`.'
    )
    cross_validation = of_table("cross_validation", "Log predictive densities of what is left out in turn.")
    interval_sources = of_table("interval_sources", "What each source of error has in the intervals.")
    levels = of_table("levels", "Quantities at each level of a factor.")
    loops = of_table("loops", "Force over depth at each level of a factor.")
    curves = of_table("curves", "Outcomes over masses and velocities at each level of a factor.")
    truth = _may_lack("truth", "What simulated data were made from; empty of others.")
    questions = _may_lack("questions", "Answers to questions of the model file; those without one say why.")

    def complete(self) -> Self:
        """The same, after every file that a page is made of was read; see `PosteriorRun.complete`."""
        return self if self.dataset is not None else super().complete()

    def _readers(self) -> list[Callable[[], Any]]:
        return [*super()._readers(), lambda: self.truth, lambda: self.questions, self._require_checks]

    def _require_checks(self) -> None:
        if self.folder and "checks" not in self.diagnostics:
            raise InputError(wrong_in(self.folder / "diagnostics.json", 'the key "checks"', self.again))

    def _shown(self, group: str) -> xr.Dataset:
        """Without draws of single impacts, whose medians and intervals stand in ``summary``."""
        data = super()._shown(group)
        single = [name for name, array in data.data_vars.items() if "impact" in array.dims]
        return data.drop_vars(single) if group == "posterior" else data

    @property
    def record(self) -> dict[str, Any]:
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
        model, description = self.record.get("model", {}).get("name", ""), self.record.get("description", "")
        return nouns_of(self.record, {description, f"“{model}”", *names_in(self.impacts_table, ())})

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


_FIRST = ("subject", "trial")


class OwnSlope(NamedTuple):
    """A coefficient that differs between the levels of a grouping.

    Attributes:
        grouping: the dimension of its levels, such as ``subject``.
        covariate: empty of a mass exponent.
        quantity: K, C, or a further parameter that has a formula.
    """

    grouping: str
    covariate: str
    quantity: str

    @property
    def name(self) -> str:
        """The name of each level's own coefficient in the posterior."""
        return f"{stem_of(self.grouping)}_{self.shared}"

    @property
    def shared(self) -> str:
        """The name of the population's coefficient."""
        what = f"effect_of_{self.covariate}" if self.covariate else "mass_exponent"
        return f"{what}_{self.quantity}"

    @property
    def words(self) -> str:
        """What it is."""
        if self.covariate:
            return f"effect of {self.covariate} on log {self.quantity}"
        return f"mass exponent of {self.quantity}"


def ranked(run: FitRun) -> dict[str, list[str]]:
    """What the levels of each grouping have in the posterior, K, C or others: people, then conditions."""
    levels = {}
    for level in dict.fromkeys((*_FIRST, *groupings(run))):
        with_effects = [q for q in run.responses if run.has(f"{stem_of(level)}_effect_{q}")]
        if quantities := [q for q in with_effects if run.of_levels(q, level)]:
            levels[level] = quantities
    return levels


def groupings(run: FitRun) -> list[str]:
    """The dimensions whose levels have effects: people and conditions, then the others."""
    of_effects = [
        str(array.dims[-1])
        for name, array in run.groups["posterior"].data_vars.items()
        if str(name).endswith(tuple(f"_effect_{q}" for q in run.responses)) and array.ndim > 2
    ]
    return list(dict.fromkeys([*(grouping for grouping in _FIRST if grouping in of_effects), *of_effects]))


def own_slopes(run: FitRun) -> list[OwnSlope]:
    """The coefficients that differ between levels."""
    slopes = []
    for variable, array in run.groups["posterior"].data_vars.items():
        name, dimension = str(variable), str(array.dims[-1])
        start = f"{stem_of(dimension)}_"
        if array.ndim != 3 or not name.startswith(start):
            continue
        for quantity in run.of_tissue:
            what = name.removeprefix(start).removesuffix(f"_{quantity}")
            if f"{start}{what}" != name and (what == "mass_exponent" or what.startswith("effect_of_")):
                covariate = "" if what == "mass_exponent" else what.removeprefix("effect_of_")
                slopes.append(OwnSlope(dimension, covariate, quantity))
    return slopes


def apart(run: FitRun, slope: OwnSlope) -> list[str]:
    """The levels whose coefficient a 90 % interval tells from the population's."""
    slopes = run.draws(slope.name)
    deviations = slopes - run.draws(slope.shared)[:, None] if run.has(slope.shared) else slopes
    return without_zero(deviations, run.labels(slope.grouping))
