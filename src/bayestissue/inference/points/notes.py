"""What point estimates show on sound impacts too: properties of the method, said once for a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from bayestissue.base.errors import Coded
from bayestissue.base.outline import counted
from bayestissue.base.remedies import codes_in, entries

if TYPE_CHECKING:
    import pandas as pd

THETA1 = Coded.stated("integrated-noise")
ARCCOS = Coded.stated("theta1-branch")
NOT_FILTERED = Coded.stated("low-pass-not-applied")
NOISELESS = Coded.stated("noiseless")
ANOTHER_PEAK = Coded.stated("peak-disagrees")
PHANTOM = Coded.stated("known-stiffness")
UNUSED = Coded.stated("channel-unused")
TOO_DEEP = Coded.stated("too-deep")
# Flags of posteriors: their intervals then promise nothing.
STRUCTURED = Coded.stated("structured-residuals")
UNCORRECTED = Coded.stated("pareto-k.impact")
# Flags, and of displacements notes, that the fit came to no answer, whether or not the recording is sound.
NO_OSCILLATOR = Coded.stated("no-answer.oscillator")
NOT_POSITIVE = Coded.stated("no-answer.positive")
AT_A_LIMIT = Coded.stated("no-answer.limit")
UNTOLD, MOSTLY_UNTOLD = (
    {q: Coded.stated(key, quantity=q) for q in ("K", "C")} for key in ("no-answer.untold", "mostly-untold")
)

ANOTHER_VELOCITY = Coded.stated("velocity-contradicted")


def people_alone(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of `estimates.csv` without springs and phantoms of known stiffness; all where all are such."""
    if "notes" not in table:
        return table
    people = table[[PHANTOM not in notes.split("; ") for notes in table["notes"]]]
    return people if len(people) else table


def said_once(notes: Iterable[str]) -> list[str]:
    """Sentences on the column ``notes`` of `estimates.csv`: how many impacts, and what it means for K and C.

    Args:
        notes: of each impact, joined by "; ".
    """
    rows = [[note for note in text.split("; ") if note] for text in notes]
    counts = Counter(note for row in rows for note in row)
    meanings: dict[str, list[str]] = {}
    for note, count in counts.most_common():
        meaning = " ".join(entries()[code].advice for code in codes_in(note)[:1])
        meanings.setdefault(meaning, []).append(f"{note} in {count} of {counted(len(rows), 'impact')}")
    return [f"{', '.join(said)}. {meaning}".strip() for meaning, said in meanings.items()]
