"""`left_out.csv`: the impacts that somebody left out of a dataset, and why; recordings stay as they are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from bayestissue.base.errors import InputError, Problem, has_control_characters, printable, refuse
from bayestissue.base.remedies import entries
from bayestissue.base.results.files import sync_folder, whole_file
from bayestissue.base.results.tables import csv_text
from bayestissue.recordings.dataset.cells import read_cells
from bayestissue.recordings.dataset.source_files import Source

FILE = "left_out.csv"
# How the reason of a recording begins that `bayestissue init --skip-bad` left out, and impacts.csv lacks.
NEVER_READ = "not in the dataset: "
COLUMNS = {
    "impact": "an impact of impacts.csv that is left out, or a recording that init left out",
    "reason": "why, in words; not empty",
}


def reasons(folder: Path) -> dict[str, str]:
    """The reason of every impact that is left out, by its name; none where there is no such file.

    Raises:
        InputError: it is no table with these columns, or a name or reason is empty or stands there twice.
    """
    if not (folder / FILE).exists():
        return {}
    try:
        cells, rows = read_cells(Source(folder / FILE, FILE), list(COLUMNS))
    except InputError as error:
        if [problem.code for problem in error.problems] == ["no-rows"]:
            # Who takes the last row out uses every impact again.
            return {}
        raise
    problems, by_impact = [], dict[str, str]()
    for row, impact, reason in zip(rows, cells["impact"], cells["reason"], strict=True):
        if not impact or not reason or impact in by_impact or has_control_characters(reason):
            value = f"{impact}: {reason}"
            problems.append(Problem.stated("left-out.row", FILE, row, value=value, impact=impact))
        by_impact[impact] = reason
    refuse(problems)
    return by_impact


def read_left_out(folder: Path, impacts: pd.Series) -> tuple[list[Problem], list[Problem]]:
    """The problem that stands for each reason of `left_out.csv`, beside a table that has these ``impacts``.

    Returns:
        Of the impacts that are left out, and, to warn of, of names that `impacts.csv` does not have.

    Raises:
        InputError: as of `reasons`.
    """
    known: list[Problem] = []
    unknown: list[Problem] = []
    for impact, reason in reasons(folder).items():
        there, never = impact in set(impacts), reason.startswith(NEVER_READ)
        key = "stated" if there else "never-read" if never else "unknown"
        problem = Problem.stated(f"left-out.{key}", FILE, None, "reason", reason, impact=impact)
        (known if there or never else unknown).append(problem)
    return known, unknown


def reason_of(problem: Problem) -> str:
    """Why an impact is left out, in words that stand in a sentence: what somebody wrote, or what is wrong."""
    if problem.code == "left-out":
        return str(problem.value).removeprefix(NEVER_READ)
    title = entries()[problem.code].title
    value = "" if problem.value is None else f": {problem.value}"
    return " ".join(printable(f"{title[:1].lower()}{title[1:]}{value}").split())


def write_left_out(folder: Path, by_impact: Mapping[str, str]) -> None:
    """Write `left_out.csv`, whole or not at all; without any impact there is no such file."""
    if not by_impact:
        (folder / FILE).unlink(missing_ok=True)
        sync_folder(folder)
        return
    with whole_file(folder / FILE) as staging:
        staging.write_bytes(left_out_text(by_impact).encode())


def left_out_text(by_impact: Mapping[str, str]) -> str:
    """What `write_left_out` writes; nothing without any impact."""
    table = pd.DataFrame(by_impact.items(), columns=list(COLUMNS))
    return csv_text(table) if by_impact else ""
