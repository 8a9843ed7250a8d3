"""K and C of every impact by itself, as `bayestissue estimate` has them, and their page."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayestissue.base.remedies import codes_in
from bayestissue.base.result import Result, Say
from bayestissue.base.results.tables import read_tables, table_of_rows, typed
from bayestissue.base.runtime import CommandStart, in_float64, run_record
from bayestissue.inference.points.notes import PHANTOM, people_alone, said_once
from bayestissue.inference.results.meanings import COLUMNS, NAMES, QUANTITIES, UNITS
from bayestissue.inference.single import impact_estimates
from bayestissue.inference.single.impact_estimates import Method
from bayestissue.recordings.dataset import as_dataset
from bayestissue.recordings.signal import SignalOptions, displacements
from bayestissue.reports.figures.impacts import MASS, axis_title, end
from bayestissue.reports.figures.study_comparisons import points
from bayestissue.reports.figures.theme import Figure, number
from bayestissue.reports.pages.page import render_page
from bayestissue.reports.pages.page_settings import LIMITS
from bayestissue.reports.pages.page_tables import Table, settings_table, shown
from bayestissue.reports.pages.wording import SENTENCES, interval, listed, nouns_of, significant
from bayestissue.reports.pages.wording import number as in_words
from bayestissue.studies.simulation import simulate
from bayestissue.studies.simulation.simulation_file import (
    Condition,
    Recording,
    Simulation,
    StudyDesign,
    Tissue,
)

if TYPE_CHECKING:
    from bayestissue.recordings.dataset import Dataset

# Tables that a run may hold beside its estimates, with their heading and what to look for.
_FURTHER: dict[str, list[str]] = SENTENCES["beside_estimates"]
_SETTINGS = ("options", "method", "signal", "model")
# Of the one tissue of `centring_table`.
MASSES_KG = (0.375, 0.666, 1.0, 1.333)
_K, _C = 3000.0, 25.0


class Estimates(pd.DataFrame, Result):
    """The table of `estimate`, a row an impact, with the page and the folder that the command makes of it.

    What is made of it by pandas is a plain table.

    Attributes:
        dataset: whose impacts they are.
        method: "impact" or "dds".
        options: where contact is in the recordings, and which part of them was used.
        file: the model file that stated these, if there was one.
        clock: when the work began, and how many seconds it took.
    """

    command = "estimate"
    files = ("estimates.csv", "report.html")
    # As pandas has it: attributes that are no columns.
    _metadata = ["dataset", "method", "options", "file", "clock"]  # noqa: RUF012
    dataset: Dataset
    method: Method
    options: SignalOptions
    file: Path | None
    clock: tuple[datetime, float]

    @cached_property
    def about(self) -> dict[str, Any]:  # type: ignore[override]
        """The content of ``run.json``."""
        data, options = self.dataset, self.options
        return run_record(
            "estimate",
            "estimates",
            *self.clock,
            dataset=data.name,
            method=self.method,
            words=dict(data.words),
            model={"file": self.file.name if self.file else None, "signal": options.model_dump()},
            contact=in_float64(displacements)(data, options).phase.words,
            input_hash=data.input_hash,
        )

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The estimates; by "dds" also what centring does to one tissue; what was left out, if any was."""
        tables: dict[str, pd.DataFrame] = {"estimates": self}
        if self.method == "dds":
            # What this fit makes of one tissue under several masses, so that readers can judge their own.
            tables["centring"] = in_float64(centring_table)()
        if left_out := [problem.as_dict() for problem in self.dataset.left_out]:
            tables["left_out"] = table_of_rows("left_out", left_out).astype({"row": "Int64"})
        return tables

    def page(self) -> str:
        """The HTML of the page."""
        return page_of(self.tables, self.about)

    def as_json(self) -> Any:
        """The rows."""
        return json.loads(self.to_json(orient="records"))


def estimate(
    dataset: Dataset | str | Path,
    *,
    method: Method = "impact",
    options: SignalOptions | None = None,
    say: Say | None = None,
) -> Estimates:
    """K and C of every impact by itself, with intervals and flags.

    Args:
        dataset: as `bayestissue.read_dataset` or `bayestissue.dataset` returns it, or its folder.
        method: "impact" for the posterior of each impact under the likelihood of its own trace, the errors of
            its measuring chain integrated out, and weak priors (those of ``models/impact.toml``, of
            displacements ``models/arma.toml``, on the intercepts and the noise, and one of the damping
            ratio). "dds" for points by the thesis's conditional least squares about the sample mean.
        options: where contact is in the recordings, and which part of them is used.
        say: told the stage, how much of it is done, and its total.

    Returns:
        A table of pandas, which also has ``.page()`` and ``.report(folder)``: see `Estimates`. One row per
        impact with the columns of `estimates.csv`: the ARMA(2,1) coefficients, omega_n, zeta, K and C, and
        ``flags``, what is wrong with the impact, joined by "; "; last ``notes``, what is not
        wrong with the impact but a property of the method or of how it was recorded (see
        `bayestissue.inference.points.notes`). By "impact" K and C are posterior medians, with posterior
        standard deviations and 90 % intervals; omega_n, zeta, phi1 and phi2 are those of an oscillator of
        this K and C; ``pareto_k`` is of the importance weights. Of decelerations theta1 is that oscillator's
        too, the noise is the recorder's, in ``noise_sd_m_s2``, and what the impact came to follows, see
        `INTERVAL_COLUMNS`, the chain's errors in its intervals; of displacements theta1 and ``sigma_a`` are
        posterior medians of the ARMA(2,1), which a position sensor's noise is not: intervals of C may miss.
        K, or C, is empty and flagged where its interval spans more than a factor of 10: the interval is then
        from 0 to an upper bound that holds with 95 %; and where nothing was found, which has no interval
        either. Where that befalls most impacts of a trial its others are flagged too. Of displacements, whose
        sound recordings often come to it, these are notes.

    Raises:
        InputError: the method or the recordings' times or limits ask for what can't be given, such as even
            times.
        ValueError: there is no such method.
    """
    start, data = CommandStart(), as_dataset(dataset)
    table = Estimates(impact_estimates.estimate(data, method=method, options=options, say=say))
    table.dataset, table.method, table.options, table.file = data, method, options or SignalOptions(), None
    table.clock = start.time, start.seconds
    return table


def centring_table() -> pd.DataFrame:
    """Estimates of one tissue from noise-free impacts of four masses, about the mean.

    Columns: ``mass_kg``; ``K_N_per_m``, ``C_N_s_per_m``, the truth; ``K_centred``, ``C_centred``, the
    thesis's fit to deviations from the sample mean (section 2.3).
    """
    conditions = tuple(Condition(trial=f"{mass:g} kg", mass_kg=mass, velocity_m_s=1.5) for mass in MASSES_KG)
    simulation = Simulation(
        name="one tissue",
        design=StudyDesign(conditions=conditions, subjects=1),
        tissue=Tissue(K_N_per_m=_K, C_N_s_per_m=_C),
        recording=Recording(sampling_rate_hz=10_000.0),
    )
    centred = impact_estimates.estimate(simulate(simulation).dataset(simulation.name), method="dds")
    known = {"mass_kg": centred["mass_kg"], "K_N_per_m": _K, "C_N_s_per_m": _C}
    fitted = {"K_centred": centred["K_N_per_m"], "C_centred": centred["C_N_s_per_m"]}
    return pd.DataFrame(known | fitted)


def estimates_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the page of the point estimates in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: `estimates.csv` lacks, or lacks a column.
    """
    return page_of(read_tables(folder, ["estimates"], list(_FURTHER)), record)


def page_of(tables: Mapping[str, pd.DataFrame], record: dict[str, Any]) -> str:
    """The HTML of the page of point estimates: ``tables`` by name, the content of ``run.json``."""
    table = typed("estimates", tables["estimates"])
    notes = list(table.get("notes", []))
    return render_page(
        "estimates.html",
        page=sys.modules[__name__],
        nouns=nouns_of(record, set(table[["impact", "subject", "trial"]].to_numpy(str).ravel())),
        codes=codes_in(*table["flags"], *notes),
        record=record,
        impacts=table,
        people=people_alone(table),
        flagged=int((table["flags"] != "").sum()),
        notes=said_once(notes),
        plots=[estimate_figure(table, q) for q in QUANTITIES] if table["mass_kg"].notna().any() else [],
        further={
            name: (heading, words, shown(name, typed(name, tables[name])))
            for name, (heading, words) in _FURTHER.items()
            if name in tables
        },
        sections=[(name, heading) for name, (heading, _) in _FURTHER.items() if name in tables],
        settings=settings_table({key: record[key] for key in _SETTINGS if key in record}),
    )


def by_posterior(table: pd.DataFrame) -> bool:
    """Whether the method was "impact", which alone weights importance."""
    return "pareto_k" in table


def level(table: pd.DataFrame, q: str) -> dict[str, str]:
    """The middle and the spread of K or C over the impacts, as text.

    ``sure`` is half of a single impact's interval, as a share of it, in the median impact; of posteriors.
    """
    values, half_width = table[COLUMNS[q]].dropna(), np.nan
    if by_posterior(table):
        half_width = ((table[end(q, "high")] - table[end(q, "low")]) / 2 / table[COLUMNS[q]]).median()
    low, median, high = np.percentile(values, [5, 50, 95]) if len(values) else [np.nan] * 3
    return {
        "name": NAMES[q],
        "unit": UNITS[q],
        "median": significant(median),
        "range": interval(low, high),
        "sure": "" if pd.isna(half_width) else f"{100 * half_width:.2g} %",
        "missing": str(len(table) - len(values)) if len(values) < len(table) else "",
    }


def flag_counts(table: pd.DataFrame) -> str:
    """How often each flag was raised, the commonest first, in words."""
    flags = table["flags"].str.split("; ").explode()
    counts = flags[flags != ""].value_counts()
    return listed([f"{flag} ({count})" for flag, count in counts.items()])


def estimates_table(table: pd.DataFrame) -> Table:
    """The impacts that need a look first: those with flags, then the others in their order."""
    order = (
        table.assign(_clean=table["flags"] == "").sort_values("_clean", kind="stable").index[: LIMITS.rows]
    )
    return shown(
        "estimates",
        table.loc[order],
        "posteriors" if by_posterior(table) else "points",
        mark=lambda row: "disagrees" if row["flags"] else "",
    )


def estimate_figure(table: pd.DataFrame, q: str) -> Figure:
    """K or C of every impact over the mass; flagged impacts have a colour and a shape of their own."""
    rows = table[["impact", "subject", "trial", "mass_kg", COLUMNS[q]]]
    rows = rows.rename(columns={"subject": "person", "trial": "condition"})
    rows["kind"] = np.where(table["flags"] != "", "flagged", "no flag")
    phantom = table.index.difference(people_alone(table).index)
    rows.loc[phantom, "kind"] = rows.loc[phantom, "kind"].replace("no flag", PHANTOM)
    if by_posterior(table):
        rows["low"], rows["high"] = (table[end(q, side)] for side in ("low", "high"))
    kinds = ["no flag", "flagged", PHANTOM]
    rows = rows.sort_values("kind", key=lambda kind: kind.map(kinds.index), kind="stable", ignore_index=True)
    return points(
        rows,
        number("mass_kg", MASS, scale={"zero": False, "padding": 12}),
        number(COLUMNS[q], axis_title(q), scale={"zero": False}),
        f"Point estimates of {NAMES[q]} of every impact over the mass; the legend names the marks.",
    )


def mass_trend(table: pd.DataFrame) -> str:
    """The slopes of log K and log C on log mass over all impacts, least squares; empty if mass doesn't vary.

    No interval is given: impacts of one person and of one condition are not independent.
    """
    words = []
    for q in QUANTITIES:
        known = table[(table[COLUMNS[q]] > 0) & (table["mass_kg"] > 0)]
        mass = np.log(known["mass_kg"].to_numpy())
        if mass.size and np.ptp(mass) > 0:
            slope = np.polynomial.polynomial.polyfit(mass, np.log(known[COLUMNS[q]].to_numpy()), 1)[1]
            words.append(f"{NAMES[q]} goes with mass to the power {in_words(slope, 2)}")
    return f"Over these impacts {listed(words)}." if words else ""
