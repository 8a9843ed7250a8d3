"""What was recomputed of the thesis, and what the audit found in it."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayestissue.report.tables import Row, Table, columns, lines, tag
from bayestissue.report.wording import (
    listed,
    significant,
)
from bayestissue.thesis.pages.published.run import PublishedRun

_SEVERITIES = ("major", "minor", "note")
_AGREES = {"true": ("yes", "agrees"), "false": ("no", "differs"), "": ("note-level", "not derivable")}


def agreement(run: PublishedRun) -> dict[str, int]:
    """How many published numbers were recomputed, agree, differ, fill a lost cell, and can't be derived."""
    answer = run.reproduction["agrees"].str.lower()
    counts = {name: int((answer == key).sum()) for key, name in (("true", "agree"), ("false", "differ"))}
    derived = int((run.reproduction["reproduced"] != "").sum())
    return {
        **counts,
        "derived": derived,
        "filled_in": derived - sum(counts.values()),
        "not_derived": len(run.reproduction) - derived,
        "all": len(run.reproduction),
    }


def reproduction_table(run: PublishedRun) -> Table:
    """Every published number beside the recomputed one."""
    rows = []
    for line in lines(run.reproduction):
        answer = str(line.agrees).lower()
        kind, words = _AGREES.get(answer, _AGREES[""])
        if answer == "" and line.reproduced:
            words = "not printed"
        shown = _shortened(str(line.reproduced))
        rows.append(
            Row(
                (line.table, line.row, line.quantity, line.published, shown, tag(kind, words), line.note),
                "disagrees" if answer == "false" else "",
            )
        )
    titles = columns(
        *("table", "row", "quantity", "published", "reproduced", "agrees", "note"),
        number=("published", "reproduced"),
        words=("quantity", "note"),
    )
    return Table(titles, rows)


def _shortened(text: str) -> str:
    try:
        value = float(text)
    except ValueError:
        return text
    return significant(value, 6)


def severities(run: PublishedRun) -> str:
    """How many findings of which severity, in words."""
    counts = [(name, int((run.audit["severity"] == name).sum())) for name in _SEVERITIES]
    return listed([f"{count} {name}" for name, count in counts if count]) or "none"


def severity_tag(severity: str) -> Markup:
    """The severity of a finding as a coloured word."""
    return tag("note-level" if severity == "note" else severity, severity)


def findings(run: PublishedRun) -> list[dict[str, str]]:
    """Every finding of the audit, worst first: the columns of `audit.csv`, a tag and an anchor."""
    return [
        {
            "anchor": f"finding-{line.Index + 1}",
            "tag": severity_tag(line.severity),
            "where": line.where,
            "what": line.what,
            "published": line.published,
            "implied": line.implied,
            "explanation": line.explanation,
        }
        for line in lines(run.audit)
    ]


def findings_by_severity(run: PublishedRun) -> dict[str, list[dict[str, str]]]:
    """`findings` under "major", "minor" and "note"; a severity without findings is left out."""
    every, severity = findings(run), run.audit["severity"]
    groups = {name: [every[place] for place in np.flatnonzero(severity == name)] for name in _SEVERITIES}
    return {name: group for name, group in groups.items() if group}
