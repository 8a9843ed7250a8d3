"""What a check reports, and the table of all reports with the worst first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import pandas as pd

Severity = Literal["major", "minor", "note"]
Bearing = Literal["tissue", "physics", "inputs", "method", "conclusions", "tables", "wording"]

SEVERITIES: tuple[Severity, ...] = ("major", "minor", "note")
BEARINGS: tuple[Bearing, ...] = (
    "tissue",
    "physics",
    "inputs",
    "method",
    "conclusions",
    "tables",
    "wording",
)
COLUMNS = ("where", "what", "published", "implied", "severity", "explanation")


@dataclass(frozen=True)
class Finding:
    """One thing that does not hold together.

    Attributes:
        where: the table or section.
        what: the quantity, in a few words.
        published: the figure as it stands there.
        implied: the figure that follows from something else.
        explanation: one or two sentences that hold without the other columns.
        severity: only where it differs from what the check declares for all its findings.
    """

    where: str
    what: str
    published: str
    implied: str
    explanation: str
    severity: Severity | None = None


@dataclass(frozen=True)
class Graded:
    """A finding with the severity it was given and what it bears on (`BEARINGS`, most damaging first)."""

    finding: Finding
    severity: Severity
    bearing: Bearing


def as_table(graded: Iterable[Graded]) -> pd.DataFrame:
    """A table with `COLUMNS`, worst first: by severity, then by what is at stake, then in the order found."""
    ranked = sorted(graded, key=lambda one: (SEVERITIES.index(one.severity), BEARINGS.index(one.bearing)))
    rows = [
        (
            one.finding.where,
            one.finding.what,
            one.finding.published,
            one.finding.implied,
            one.severity,
            one.finding.explanation,
        )
        for one in ranked
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS), dtype="str")
