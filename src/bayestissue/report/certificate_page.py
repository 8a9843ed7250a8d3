"""The page of a certificate, and the same as text to attach to a paper."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.outline import markdown_rows
from bayestissue.report.page import render_page
from bayestissue.report.tables import Field, Table, number_field, sensitivity_table, table_of, tag
from bayestissue.report.wording import decimals, names_in, nouns_of, with_error
from bayestissue.results import read_table

TABLES = ("calibration", "ranks", "sensitivity", "checklists")
_CHECK = "\N{CHECK MARK}"


def certificate_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the page of the certificate in ``folder``.

    Raises:
        InputError: a file of it lacks or isn't what `certify` writes.
    """
    return certificate_html(record, {name: read_table(folder, name) for name in TABLES})


def certificate_html(record: Mapping[str, Any], tables: Mapping[str, pd.DataFrame]) -> str:
    """The HTML of a certificate: the content of ``run.json``, and its tables by name."""
    return render_page(
        "certificate.html",
        page=sys.modules[__name__],
        nouns=nouns_of(record, names_in(tables["calibration"])),
        record=record,
        calibration=tables["calibration"],
        sensitivity=tables["sensitivity"],
        checklists=tables["checklists"],
    )


def calibration_rows(calibration: pd.DataFrame) -> Table:
    """What the ranks of each quantity say."""
    return table_of(
        calibration,
        Field("quantity"),
        number_field("of them", "elements", str),
        Field("90 % intervals that held", lambda row: _held(row), "number"),
        Field("shift, sd", lambda row: with_error(row["shift"], row["shift_se"]), "number"),
        number_field("p", words=decimals(3)),
        Field("ranks", lambda row: tag("yes", "uniform") if row["passed"] else tag("no", "NOT UNIFORM")),
        mark=lambda row: "" if row["passed"] else "failed",
    )


def _held(row: Mapping[Any, Any]) -> str:
    return f"{100 * row['held']:.1f} ± {100 * row['held_se']:.1f} %"


def moved_by_priors(sensitivity: pd.DataFrame) -> Table:
    """The rows of `sensitivity.csv` in which the prior has a part."""
    return sensitivity_table(sensitivity[sensitivity["diagnosis"] != _CHECK])


def items(checklists: pd.DataFrame, guideline: str) -> Table:
    """One checklist."""
    return table_of(
        checklists[checklists["guideline"] == guideline],
        Field("", "number"),
        Field("item", kind="words"),
        Field("what the run knows", "answer", "words"),
        Field("for you to say", "question", "words"),
    )


def as_markdown(
    record: Mapping[str, Any],
    checklists_as_lines: list[str],
    calibration: pd.DataFrame,
    sensitivity: pd.DataFrame,
) -> str:
    """The file to attach to a paper: verdict, versions, calibration, what priors move, both checklists."""
    verdict = record["verdict"]
    facts = {"fit of": record["dataset"], "fitted": record["run"]["started"], "certified": record["started"]}
    facts |= record["versions"]
    rows = (
        (
            row["quantity"],
            row["elements"],
            _held(row),
            with_error(row["shift"], row["shift_se"]),
            f"{row['p']:.3f}",
        )
        for row in calibration.to_dict("records")
    )
    moved = sensitivity[sensitivity["diagnosis"] != _CHECK]
    columns = ("variable", "prior", "likelihood", "diagnosis")
    headings = ("quantity", "of them", "90 % intervals that held", "shift, sd", "p")
    return "\n".join(
        [
            f"# Certificate of the fit of {record['dataset']}",
            *("", verdict["words"], "", verdict["prior"], ""),
            *markdown_rows(("", ""), facts.items()),
            *("", "## Calibration about this study", ""),
            *(markdown_rows(headings, rows) if len(calibration) else ["Not made."]),
            *("", "## What the priors move", ""),
            *(markdown_rows(columns, moved[[*columns]].to_numpy().tolist()) if len(moved) else ["Nothing."]),
            "",
            *checklists_as_lines,
        ]
    )
