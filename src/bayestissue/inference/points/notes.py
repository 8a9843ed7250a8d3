"""What point estimates show on sound impacts too: properties of the method, said once for a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from bayestissue.signal.displacement import NO_OFFSET

THETA1 = "theta1 at its limit"
NOT_WHITE = "residuals are not white"
ARCCOS = "theta1 asks for another value of arccos"
NOT_FILTERED = "the declared low-pass is not in this method"
NOISELESS = "no noise beyond rounding: no standard errors"
ANOTHER_PEAK = "K and C imply another peak displacement than recorded"
# Flags of the method "impact": its intervals then promise nothing.
STRUCTURED = "residuals are not the white noise of a spring and damper's impact: its interval may miss"
UNCORRECTED = "importance weights are not to be trusted: its interval may miss"
# Flags that say that the fit came to no answer, whether or not the recording is sound.
NO_OSCILLATOR = "no oscillator has these coefficients"
NOT_POSITIVE = "K or C is not positive"
AT_A_LIMIT = "zeta at a limit"
FAILED = (NO_OSCILLATOR, NOT_POSITIVE, AT_A_LIMIT, ANOTHER_PEAK)
# The same of a displacement, where sound recordings come to it too.
NO_ANSWER = "the fit came to no answer"

_NAMED = 5
_INTEGRATED = (
    "White noise of an accelerometer, integrated twice, is not the noise that an ARMA(2,1) assumes: so it is "
    "at any high sampling rate. K and C hold; their standard errors and intervals here are too small. "
    'Intervals that hold are those of method "impact".'
)
_MEANING = {
    THETA1: _INTEGRATED,
    NOT_WHITE: _INTEGRATED,
    ARCCOS: "theta1 is then not that of a sampled A(2). K and C are those of the main value, the only one "
    "possible before the impactor turns back.",
    NOT_FILTERED: "The ARMA(2,1) of a displacement has no place for a low-pass: K and above all C come out "
    'too small. Method "impact" applies it.',
    NOISELESS: "K and C hold, and have no standard errors.",
    NO_ANSWER: "White noise of a position sensor is not the noise that an ARMA(2,1) assumes, and drives its "
    "fit to where no tissue is. K and C of these impacts are no estimates: leave them out.",
    ANOTHER_PEAK: "Deviations from the sample mean make K and C too large by their nature: see centring.csv. "
    'method "exact" measures from the rest position.',
    NO_OFFSET: "K and C carry the recorder's offset: 1 % of the peak changes K by some 3 %. Record some "
    "milliseconds before contact, or state uncertainty.offset_sd and fit.",
}


def flagged_recordings(impacts: Sequence[str], flags: Sequence[str]) -> dict[str, Any]:
    """Recordings that the checks of single impacts name, for a fit's diagnostics; empty where none is.

    What the point fit alone came to no answer at is left out: a fit has other ways.

    Args:
        impacts: their names.
        flags: of each, joined by "; ", as in the column ``flags`` of `estimates.csv`.
    """
    own = {
        impact: [flag for flag in text.split("; ") if flag and flag not in FAILED]
        for impact, text in zip(impacts, flags, strict=True)
    }
    named = {impact: found for impact, found in own.items() if found}
    if not named:
        return {}
    counts = Counter(flag for found in named.values() for flag in found)
    commonest = ", ".join(f"{flag} ({count})" for flag, count in counts.most_common(3))
    more = f" and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
    which = ", ".join(list(named)[:_NAMED]) + more
    words = (
        f"NOTE: of {len(own)} recordings {len(named)} {'is' if len(named) == 1 else 'are'} flagged: "
        f"{commonest}; {which}. Their K and C may be wrong. `bayestissue check` says what to do."
    )
    return {"flagged": named, "of": len(own), "words": words}


def said_once(notes: Iterable[str]) -> list[str]:
    """Sentences on the column ``notes`` of `estimates.csv`: how many impacts, and what it means for K and C.

    Args:
        notes: of each impact, joined by "; ".
    """
    rows = [[note for note in text.split("; ") if note] for text in notes]
    counts = Counter(note for row in rows for note in row)
    meanings: dict[str, list[str]] = {}
    for note, count in counts.most_common():
        meanings.setdefault(_MEANING.get(note, ""), []).append(f"{note} in {count} of {len(rows)} impacts")
    return [f"{', '.join(said)}. {meaning}".strip() for meaning, said in meanings.items()]
