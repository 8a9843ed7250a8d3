"""A finished `reproduce` run, read whole, and the tables of its page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np

from bayestissue.base.outline import counted
from bayestissue.inference.results.meanings import UNITS
from bayestissue.reports.pages.page_tables import Field, Table, shown, table_of_cells, tag
from bayestissue.reports.pages.posterior import QUANTITIES, spread
from bayestissue.reports.pages.run_folder import POSTERIOR_TABLES, PosteriorRun, of_table
from bayestissue.reports.pages.wording import listed, significant
from bayestissue.thesis.audit import SEVERITIES
from bayestissue.thesis.reproduction.conditions import Quantity

_GROUPS = ("posterior", "observed_data", "posterior_predictive", "constant_data")


@dataclass(frozen=True, eq=False, repr=False)
class PublishedRun(PosteriorRun):
    """A finished `reproduce` run."""

    opened = _GROUPS
    needed: ClassVar = dict.fromkeys(_GROUPS, ())
    table_files = (*POSTERIOR_TABLES, "reproduction", "audit", "comparison", "predictive_checks")
    again = "Make the run anew with `bayestissue reproduce`."

    reproduction = of_table("reproduction", "Every published number beside the recomputed one.")
    audit = of_table("audit", "What the audit found, the worst first.")
    comparison = of_table("comparison", "How well each explanation predicts.")
    predictive_checks = of_table("predictive_checks", "Statistics of the data beside those predicted.")

    def observed(self, name: str) -> np.ndarray:
        """What was published, such as ``K_observed`` [impact]."""
        return self.groups["observed_data"][name].to_numpy()

    @property
    def reference_mass(self) -> float:
        """The mass in kg at which people and conditions are reported."""
        return float(self.constant("reference_mass_kg"))


def checks_table(run: PublishedRun) -> Table:
    """`predictive_checks.csv`: statistics of the published numbers beside what the model predicts."""
    return shown(
        "predictive_checks",
        run.predictive_checks,
        mark=lambda row: (
            "" if row["predicted_low"] <= row["observed"] <= row["predicted_high"] else "disagrees"
        ),
    )


def estimates_table(run: PublishedRun) -> Table:
    """Each published impact beside the posterior of that person in that condition."""
    cells = [run.labels("impact")]
    titles = ["impact"]
    for quantity in QUANTITIES:
        spreads = [spread(draws) for draws in run.draws(quantity).T]
        cells.append([significant(value, 5) for value in run.observed(f"{quantity}_observed")])
        cells.append([one.value for one in spreads])
        cells.append([one.range for one in spreads])
        titles += [f"published {quantity} ({UNITS[quantity]})", f"posterior {quantity}", f"{quantity}, 90 %"]
    return table_of_cells(zip(*cells, strict=True), *titles, number=titles[1:])


def lines_table(run: PublishedRun, printed: Mapping[Quantity, tuple[float, float]]) -> Table:
    """The thesis's regression lines over mass beside those through the posterior means."""
    rows = []
    for quantity, line in printed.items():
        for name, per, value in zip(("intercept", "slope"), ("", " per kg"), line, strict=True):
            if run.has(variable := f"linear_{name}_{quantity}"):
                drawn = spread(run.draws(variable))
                title, inside = f"{name} of {quantity} ({UNITS[quantity]}{per})", drawn.holds(value)
                thesis, answer = f"{value:g}".replace("-", "−"), "yes" if inside else "no"
                rows.append((title, thesis, drawn.value, drawn.range, answer))
    titles = ("straight line over mass", "thesis", "posterior", "90 %", "thesis inside")
    return table_of_cells(rows, *titles, number=titles[1:4])


_AGREES = {"true": ("yes", "agrees"), "false": ("no", "differs"), "": ("note-level", "not derivable")}


def agreement(run: PublishedRun) -> dict[str, int]:
    """How many published numbers were recomputed, agree, differ, fill a lost cell, and can't be derived."""
    answer = run.reproduction["agrees"].str.lower()
    agree, differ = (int((answer == word).sum()) for word in ("true", "false"))
    derived = int((run.reproduction["reproduced"] != "").sum())
    return {
        "agree": agree,
        "differ": differ,
        "derived": derived,
        "filled_in": derived - agree - differ,
        "not_derived": len(run.reproduction) - derived,
        "all": len(run.reproduction),
    }


def reproduction_table(run: PublishedRun) -> Table:
    """Every published number beside the recomputed one."""
    return shown(
        "reproduction",
        run.reproduction.assign(reproduced=run.reproduction["reproduced"].astype(str).map(_shortened)),
        fields={"agrees": Field("agrees", _agreement_tag)},
        mark=lambda row: "disagrees" if str(row["agrees"]).lower() == "false" else "",
    )


def _agreement_tag(row: Mapping[str, Any]) -> str:
    answer = str(row["agrees"]).lower()
    kind, words = _AGREES.get(answer, _AGREES[""])
    return tag(kind, "not printed" if answer == "" and row["reproduced"] else words)


def _shortened(text: str) -> str:
    try:
        value = float(text)
    except ValueError:
        return text
    return significant(value, 6)


def severities(run: PublishedRun) -> str:
    """How many findings of which severity, in words."""
    counts = run.audit["severity"].value_counts()
    return listed([counted(counts[name], f"{name} finding") for name in SEVERITIES if name in counts])


def findings(run: PublishedRun) -> list[dict[str, Any]]:
    """Every finding of the audit, worst first: the columns of `audit.csv`, a coloured tag and an anchor."""
    rows = cast("list[dict[str, Any]]", run.audit.replace("ω_n", "ωₙ", regex=True).to_dict("records"))
    for position, row in enumerate(rows, start=1):
        severity = row["severity"]
        row["anchor"] = f"finding-{position}"
        row["tag"] = tag("note-level" if severity == "note" else severity, severity)
    return rows
