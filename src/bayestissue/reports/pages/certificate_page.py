"""The page of a certificate, and the same as text to attach to a paper."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.base.outline import markdown_rows
from bayestissue.base.results.tables import read_table
from bayestissue.reports.pages.page import render_page
from bayestissue.reports.pages.page_tables import Field, Table, shown, tag
from bayestissue.reports.pages.wording import names_in, nouns_of

TABLES = ("calibration", "ranks", "sensitivity", "checklists")
_CHECK = "\N{CHECK MARK}"
# All but the verdict, which has a colour.
_CALIBRATION = ("quantity", "elements", "held", "shift", "p")


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


def items(checklists: pd.DataFrame, guideline: str) -> Table:
    """One checklist."""
    return shown("checklists", checklists[checklists["guideline"] == guideline])


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
    moved = moved_by_priors(sensitivity)
    return "\n".join(
        [
            f"# Certificate of the fit of {record['dataset']}",
            *("", verdict["words"], "", verdict["prior"], ""),
            *markdown_rows(("", ""), facts.items()),
            *("", "## Calibration about this study", ""),
            *(
                shown("calibration", calibration, _CALIBRATION).markdown()
                if len(calibration)
                else ["Not made."]
            ),
            *("", "## What the priors move", ""),
            *(moved.markdown() if moved.rows else ["Nothing."]),
            "",
            *checklists_as_lines,
        ]
    )
