"""What point estimates show on sound impacts too: properties of the method, said once for a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from bayestissue.dataset.settings import ChannelSettings
from bayestissue.errors import Coded
from bayestissue.outline import counted, first_of
from bayestissue.remedies import codes_in, entries

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
K_UNTOLD = Coded.stated("no-answer.untold", quantity="K")
C_UNTOLD = Coded.stated("no-answer.untold", quantity="C")
K_MOSTLY_UNTOLD = Coded.stated("mostly-untold", quantity="K")
C_MOSTLY_UNTOLD = Coded.stated("mostly-untold", quantity="C")

ANOTHER_VELOCITY = Coded.stated("velocity-contradicted")
_NAMED = 5


def flagged_recordings(
    impacts: Sequence[str], flags: Sequence[Sequence[str]], explained: Collection[str] = ()
) -> dict[str, Any]:
    """Recordings that the checks of single impacts name, for a fit's diagnostics; empty where none is.

    Args:
        impacts: their names.
        flags: of each.
        explained: flags that the fit's own law accounts for.

    Returns:
        ``flagged``, the flags of each impact that has some; ``of`` how many; ``words``; and, where recordings
        imply another velocity at contact than was stated, ``velocity``, the words of a warning.
    """
    of_each = ([flag for flag in one if flag not in explained] for one in flags)
    named = {impact: warnings for impact, warnings in zip(impacts, of_each, strict=True) if warnings}
    if not named:
        return {}
    counts = Counter(flag for warnings in named.values() for flag in warnings)
    commonest = ", ".join(f"{flag} ({count})" for flag, count in counts.most_common(3))
    are, their = ("is", "Its") if len(named) == 1 else ("are", "Their")
    words = (
        f"NOTE: of {len(impacts)} recordings {len(named)} {are} flagged: {commonest}; "
        f"{first_of(list(named), _NAMED)}. {their} K and C may be wrong. `bayestissue check` says what to do."
    )
    note = {"flagged": named, "of": len(impacts), "words": words}
    if count := counts[ANOTHER_VELOCITY]:
        note["velocity"] = (
            f"The recordings imply another velocity at contact than was stated: {count} of {len(impacts)}. "
            "Every error of the velocity is in K and C. `bayestissue check` says which velocity."
        )
    return note


def clipped_recordings(impacts: Sequence[str], clipped: Sequence[bool]) -> dict[str, Any]:
    """Recordings with samples at the sensor's limit, for a fit's diagnostics; empty where none is.

    Args:
        impacts: their names.
        clipped: whether the part of each that the fit is of holds such samples.
    """
    named = [impact for impact, is_clipped in zip(impacts, clipped, strict=True) if is_clipped]
    if not named:
        return {}
    words = (
        f"Of {len(impacts)} recordings {len(named)} {'is' if len(named) == 1 else 'are'} clipped: "
        f"{first_of(named, _NAMED)}. Samples at the sensor's limit count as that much or more."
    )
    return {"impacts": named, "of": len(impacts), "words": words}


def unused_channels(channels: Sequence[ChannelSettings], why: str) -> str:
    """Sentences on further channels that a fit is not of.

    Args:
        channels: the further ones.
        why: they are not used.
    """
    named = first_of([f"{channel.name} ({channel.quantity})" for channel in channels], _NAMED)
    return (
        f"The further channel {named} is not used here: {why}. K and C are those of the first one, at the "
        "declared mass. `bayestissue check` compares the two."
    )


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
