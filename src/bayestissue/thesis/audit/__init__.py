"""The audit: the program finds what does not hold together, and says why.

A check is a function that yields the numbers of everything it does not believe, by their names in its texts;
``inconsistencies.toml`` names it, in the table of its module, with what is said of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import pandas as pd

from bayestissue.base.declarations import declared
from bayestissue.base.results.tables import table_of_rows
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.audit import people, plausibility, publication
from bayestissue.thesis.audit.plausibility import AuditedImpacts, published_impacts
from bayestissue.thesis.audit.publication import Publication

# How serious a finding is, and what it puts in doubt: worst first.
SEVERITIES = ("major", "minor", "note")
BEARINGS = ("tissue", "physics", "inputs", "method", "conclusions", "tables", "wording")
TEXTS = declared(__package__, "inconsistencies.toml")


def findings(
    checks: ModuleType, subject: AuditedImpacts | Publication, where: str = ""
) -> Iterator[dict[str, str]]:
    """What a module's checks find in ``subject``, in words: rows of `audit.csv`, each with its ``bearing``.

    ``where`` is the table or section of a finding that names none. The explanation holds without the other
    columns.
    """
    for check, texts in TEXTS[checks.__name__.rpartition(".")[2]].items():
        for numbers in getattr(checks, check)(subject):
            yield {"where": where} | {name: text.format(**numbers) for name, text in texts.items()}


def audit_published(published: PublishedTables, reproduction: pd.DataFrame) -> pd.DataFrame:
    """What does not hold together in the published tables and the text about them, worst first.

    Args:
        published: the tables.
        reproduction: of these, as of `reproduce_published`.

    Returns:
        columns where, what, published, implied, severity ("major", "minor", "note") and explanation; of the
        same severity by what is at stake, then in the order of the checks.
    """
    names, impacts = published.estimates["table"].unique(), published_impacts(published)
    where = f"Tables {names[0]} to {names[-1]}"
    rows = [
        *findings(plausibility, impacts, where),
        *findings(people, impacts, where),
        *findings(publication, Publication(published, reproduction)),
    ]
    grades = {"severity": SEVERITIES, "bearing": BEARINGS}
    ranked = sorted(rows, key=lambda row: [order.index(row[name]) for name, order in grades.items()])
    return table_of_rows("audit", ranked).astype("str")
