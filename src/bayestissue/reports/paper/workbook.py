"""All tables of a fit in one workbook, among them one with a row a person for statistics programs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.outcome_table import DECLARED
from bayestissue.base.results.tables import declared_files
from bayestissue.inference.answers.study import Study
from bayestissue.inference.results.meanings import UNITS, symbols
from bayestissue.inference.samplers.sampling import interval
from bayestissue.reports.paper import PRINT

# A sheet of Excel has 2^20 rows, the heading among them.
MOST_ROWS = 2**20 - 1


def write_workbook(
    path: Path, table: Callable[[str], pd.DataFrame], study: Study, model: Mapping[str, Any]
) -> None:
    """Write ``people_wide``, ``impacts``, every table of a fit, its priors, and what each column means.

    Numbers are numbers and text is text, so that a spreadsheet in any language shows them by its own rules.

    Args:
        path: of the workbook.
        table: a table of the fit by its name; a KeyError where there is none.
        study: the fit, as it can be asked.
        model: the resolved model file.
    """
    wide, meanings = people_wide(study)
    of_impacts = impacts(table("summary"), study.draws, study.recorded.rows)
    sheets = {"people_wide": wide, "impacts": of_impacts}
    codebook = [["people_wide", name, meaning] for name, meaning in meanings.items()]
    for name, file in declared_files().items():
        stem = name.removesuffix(".csv")
        # A run has the tables of its command, and not all of these.
        if stem == name or "fit" not in file.by:
            continue
        with suppress(KeyError):
            sheets[stem] = table(stem)
            codebook += [[stem, column, kind.meaning] for column, kind in file.columns.items()]
    sheets["priors"] = priors(model)
    sheets["columns"] = pd.DataFrame(codebook, columns=["sheet", "column", "meaning"])
    write_sheets(sheets, path)


def people_wide(study: Study) -> tuple[pd.DataFrame, dict[str, str]]:
    """A row a person, a column for K and for C by condition and by what else divides a person's impacts.

    Beside a discrepancy K_secant stands in place of K, which is the element's own.

    A cell is the posterior median of the geometric mean over the person's impacts there, so that it is drawn
    towards those of others as the model has it; analysing cells as if they were measured ignores that, and
    their intervals. What is the same in all of a person's impacts, such as sex, has a column of its own.
    Outcomes of the reference impact on each person follow, with the ends of their intervals: see `_outcomes`.

    Returns:
        The table, and what each column means.
    """
    posterior, rows = study.draws, study.recorded.rows
    subject = rows["subject"].astype(str)
    values = rows.drop(columns="subject").groupby(subject).nunique().max()
    varies = [name for name in values.index if len(set(rows[name])) > 1]
    of_person = [name for name in varies if values[name] == 1]
    within = [name for name in varies if values[name] > 1 and not pd.api.types.is_numeric_dtype(rows[name])]
    people = list(dict.fromkeys(subject))
    columns: dict[str, Any] = {"subject": people}
    meanings = {"subject": "the person"}
    for name in of_person:
        columns[name] = rows.groupby(subject)[name].first().reindex(people).to_numpy()
        meanings[name] = f"{name} of the person"
    cells = rows[within].astype(str).agg(" ".join, axis=1) if within else pd.Series("all", index=rows.index)
    for q, quantity in symbols(posterior).items():
        logs = np.log(posterior[quantity].transpose("impact", ...).to_numpy()).reshape(len(rows), -1)
        means = pd.DataFrame(logs).groupby([cells.to_numpy(), subject.to_numpy()]).mean()
        medians = pd.Series(np.median(np.exp(means), axis=1), means.index)
        for cell in dict.fromkeys(cells):
            name = _name(f"{quantity}_{cell}", columns)
            columns[name] = medians.loc[cell].reindex(people).to_numpy()
            where = f": {', '.join(within)} {cell}" if within else ""
            meanings[name] = f"{quantity}, {UNITS[q]}{where}"
    for words, column, meaning in _outcomes(study, people, within):
        name = _name(words, columns)
        columns[name], meanings[name] = column, meaning
    return pd.DataFrame(columns), meanings


_ENDS = {
    "": ("median", "median"),
    "_low": ("lower end of the 90 % interval", "low"),
    "_high": ("upper end of the 90 % interval", "high"),
}


def _outcomes(
    study: Study, people: Sequence[str], within: Sequence[str]
) -> Iterator[tuple[str, np.ndarray, str]]:
    """Outcomes of the reference impact on each person: names, cells and meanings of columns.

    On what of ``within`` the formulas have, such as each side; conditions that stand for masses are left out,
    since the mass is the reference mass. None where no formula has the person, or where there is no law.
    """
    recorded = study.recorded
    if not recorded.tells_people:
        return
    one_mass = len(set(recorded.rows["mass_kg"])) == 1
    factors = [name for name in within if name in recorded.needed and (name != "trial" or one_mass)]
    cells = recorded.rows[["subject", *factors]].astype(str).drop_duplicates()
    names = [str(name) for name in cells]
    conditions = [dict(zip(names, row, strict=True)) for row in cells.itertuples(index=False, name=None)]
    values = study.of_reference_impact(conditions)
    mass, velocity = (float(study.motion([{}])[name][0]) for name in ("mass_kg", "velocity_m_s"))
    simulated = f"; {words}" if values and (words := study.simulated_words(values)) else ""
    of_cell = cells[factors].agg(" ".join, axis=1) if factors else pd.Series("", index=cells.index)
    for cell in dict.fromkeys(of_cell):
        chosen = (of_cell == cell).to_numpy()
        of_levels = f"{', '.join(factors)} {cell}; " if factors else ""
        for name, draws in values.items():
            unit, what, *_ = DECLARED[str(name)]
            of_impact = f"of an impact of {mass:.4g} kg at {velocity:.4g} m/s, {unit}"
            ends = interval(draws.isel(condition=np.flatnonzero(chosen)))
            for end, (which, name_of_end) in _ENDS.items():
                at = pd.Series(ends[name_of_end], cells["subject"][chosen])
                words = f"{name}_{unit}{f'_{cell}' if factors else ''}{end}"
                yield (
                    words,
                    at.reindex(list(people)).to_numpy(),
                    f"{what} {of_impact}: {of_levels}{which}{simulated}",
                )


def _name(words: str, taken: Mapping[str, Any]) -> str:
    """A name that statistics programs take: letters, digits and _, at most 64, and no other's."""
    name = re.sub(r"\W+", "_", words)[:60]
    return name if name not in taken else f"{name}_{len(taken)}"


def impacts(summary: pd.DataFrame, posterior: xr.Dataset, rows: pd.DataFrame) -> pd.DataFrame:
    """A row an impact: what was recorded of it, and medians and 90 % intervals of what the model tells."""
    names = posterior["impact"].to_numpy().astype(str)
    parts = [rows.set_axis(names)]
    of_impacts = [name for name in posterior if posterior[name].dims[2:] == ("impact",)]
    for variable, part in summary[summary["variable"].isin(of_impacts)].groupby("variable", sort=False):
        ends = part.set_index("label")[["median", "eti90_low", "eti90_high"]].reindex(names)
        parts.append(ends.set_axis([str(variable), f"{variable}_low", f"{variable}_high"], axis=1))
    return pd.concat(parts, axis=1).rename_axis("impact").reset_index()


def priors(model: Mapping[str, Any]) -> pd.DataFrame:
    """A row for each parameter of a prior, by the keys of the model file."""
    numbers = pd.json_normalize(model["priors"], sep=".").iloc[0]
    return pd.DataFrame({"key": [f"priors.{key}" for key in numbers.index], "value": numbers.to_numpy()})


def write_sheets(sheets: Mapping[str, pd.DataFrame], path: Path) -> None:
    """Write a workbook of tables by the names of their sheets; an infinite number is text."""
    # Text that begins with = is text, whoever called an impact so.
    options = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
    settings: dict[str, Any] = {"engine": "xlsxwriter", "engine_kwargs": {"options": options}}
    with pd.ExcelWriter(path, **settings) as writer:
        heading = writer.book.add_format({"bold": True, "bottom": 1})
        for name, table in sheets.items():
            shown, sheet = table[:MOST_ROWS], writer.book.add_worksheet(name[:31])
            for column, title in enumerate(table):
                sheet.write_string(0, column, str(title), heading)
                longest = max((len(cell) for cell in shown[title] if isinstance(cell, str)), default=10)
                sheet.set_column(column, column, min(max(longest, len(str(title))) + 2, PRINT.widest))
            sheet.freeze_panes(1, 1)
            body = shown.replace(-np.inf, "−∞")
            body.to_excel(writer, sheet_name=sheet.name, header=False, index=False, startrow=1, inf_rep="∞")
