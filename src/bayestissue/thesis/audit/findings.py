"""What a check reports, and the table of all reports with the worst first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

import pandas as pd

Severity = Literal["major", "minor", "note"]
Bearing = Literal["tissue", "physics", "inputs", "method", "conclusions", "tables", "wording"]

SEVERITIES: tuple[Severity, ...] = get_args(Severity)
BEARINGS: tuple[Bearing, ...] = get_args(Bearing)
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
        severity: where it differs from what the check declares for all its findings; see `Registry.run`.
        bearing: what it bears on (`BEARINGS`, most damaging first), the check's.
    """

    where: str
    what: str
    published: str
    implied: str
    explanation: str
    severity: Severity | None = None
    bearing: Bearing | None = None


def as_table(graded: Iterable[Finding]) -> pd.DataFrame:
    """A table with `COLUMNS`, worst first: by severity, then by what is at stake, then in the order found."""
    ranked = sorted(graded, key=lambda one: (SEVERITIES.index(one.severity), BEARINGS.index(one.bearing)))
    rows = [[getattr(one, name) for name in COLUMNS] for one in ranked]
    return pd.DataFrame(rows, columns=list(COLUMNS), dtype="str")
