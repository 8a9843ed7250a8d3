"""What point estimates show on sound impacts too: properties of the method, said once for a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from bayestissue.signal.displacement import NO_OFFSET

THETA1 = "theta1 at its limit"
NOT_WHITE = "residuals are not white"
ARCCOS = "theta1 asks for another value of arccos"
NOISELESS = "no noise beyond rounding: no standard errors"
ANOTHER_PEAK = "K and C imply another peak displacement than recorded"
# Flags that say that the fit came to no answer, whether or not the recording is sound.
NO_OSCILLATOR = "no oscillator has these coefficients"
NOT_POSITIVE = "K or C is not positive"
AT_A_LIMIT = "zeta at a limit"
FAILED = (NO_OSCILLATOR, NOT_POSITIVE, AT_A_LIMIT, ANOTHER_PEAK)

_INTEGRATED = (
    "White noise of an accelerometer, integrated twice, is not the noise that an ARMA(2,1) assumes: so it is "
    "at any high sampling rate. K and C hold; their standard errors and intervals here are too small. For "
    "intervals fit models/impact.toml."
)
_MEANING = {
    THETA1: _INTEGRATED,
    NOT_WHITE: _INTEGRATED,
    ARCCOS: "theta1 is then not that of a sampled A(2). K and C are those of the main value, the only one "
    "possible before the impactor turns back.",
    NOISELESS: "K and C hold, and have no standard errors.",
    ANOTHER_PEAK: "Deviations from the sample mean make K and C too large by their nature: see centring.csv. "
    'method "exact" measures from the rest position.',
    NO_OFFSET: "K and C carry the recorder's offset: 1 % of the peak changes K by some 3 %. Record some "
    "milliseconds before contact, or state uncertainty.offset_sd and fit.",
}


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
