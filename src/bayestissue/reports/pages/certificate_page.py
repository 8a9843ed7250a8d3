"""The page of a certificate, and the same as text to attach to a paper."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.base.results.tables import read_table
from bayestissue.reports.pages.page import part, render_page
from bayestissue.reports.pages.page_tables import Field, Table, shown, table_of_cells, tag
from bayestissue.reports.pages.wording import names_in, nouns_of

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
        nouns=nouns_of(record, names_in(tables["calibration"])),
        record=record,
        calibration=tables["calibration"],
        sensitivity=tables["sensitivity"],
        checklists=tables["checklists"],
    )


def calibration_rows(calibration: pd.DataFrame) -> Table:
    """What the ranks of each quantity say."""
    passed = Field("ranks", lambda row: tag("yes", "uniform") if row["passed"] else tag("no", "NOT UNIFORM"))
    return shown(
        "calibration",
        calibration,
        fields={"passed": passed},
        mark=lambda row: "" if row["passed"] else "failed",
    )


def moved_by_priors(sensitivity: pd.DataFrame) -> Table:
    """The rows of `sensitivity.csv` in which the prior has a part."""
    return shown("sensitivity", sensitivity[sensitivity["diagnosis"] != _CHECK])


def as_markdown(
    record: Mapping[str, Any],
    checklists_as_lines: list[str],
    calibration: pd.DataFrame,
    sensitivity: pd.DataFrame,
) -> str:
    """The file to attach to a paper: verdict, versions, calibration, what priors move, both checklists."""
    facts = {"fit of": record["dataset"], "fitted": record["run"]["started"], "certified": record["started"]}
    tables = {
        "facts": table_of_cells((facts | record["versions"]).items(), "", ""),
        "calibration": shown("calibration", calibration, "attached"),
        "moved": moved_by_priors(sensitivity),
    }
    lines = {name: "\n".join(table.markdown()) if table.rows else "" for name, table in tables.items()}
    return str(part("words/certificate.jinja").attached(record, lines, "\n".join(checklists_as_lines)))
