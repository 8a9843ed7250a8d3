"""What seems to stand twice in a dataset: one name written in two ways, one recording under two impacts."""

from __future__ import annotations

import re
import unicodedata

import numpy as np
import pandas as pd

from bayestissue.dataset.recordings import Recordings
from bayestissue.errors import Problem

_GROUPS = ("subject", "trial")
_WHOLE_NUMBER = re.compile(r"(?<![\d.])(\d+)\.0+(?![\d.])")


def alike_names(table: pd.DataFrame, rows: np.ndarray, file: str) -> list[Problem]:
    """Names of people or conditions that differ only in case, spaces, hyphens or leading zeros.

    Args:
        table: ``impacts.csv``, with the columns ``subject`` and ``trial``.
        rows: the row of each impact in that file.
        file: what messages call it.

    Returns:
        A warning for each further way of writing a name: two people where there is one make the spread
        between people too small, and that within a person too large.
    """
    warnings = []
    for column in _GROUPS:
        first: dict[str, str] = {}
        for text in dict.fromkeys(table[column]):
            usual = first.setdefault(_plain(text), text)
            if usual == text:
                continue
            at = int(np.argmax(table[column] == text))
            warnings.append(
                Problem(
                    file,
                    f'one way to write the {column} "{usual}"',
                    f"They count as two. Write both alike if they are one {column}.",
                    row=int(rows[at]),
                    column=column,
                    value=text,
                    impact=str(table["impact"].iloc[at]) or None,
                    code="two-spellings",
                )
            )
    return warnings


def same_recordings(recordings: Recordings) -> list[Problem]:
    """Recordings whose samples are, to the last digit, those of an earlier impact.

    Noise never repeats itself: such a recording was exported or copied twice. As two impacts it makes K and
    C of that person seem known better than they are, and wrong where the stated mass or velocity differs.
    """
    samples = recordings.samples
    first: dict[bytes, int] = {}
    warnings = []
    for which, (begin, end) in enumerate(zip(samples.start[:-1], samples.start[1:], strict=True)):
        earlier = first.setdefault(samples.value[begin:end].tobytes(), which)
        if earlier != which:
            warnings.append(
                recordings.problem(
                    which,
                    "a recording of its own",
                    "Export the right recording, or take one of the two impacts out.",
                    value=f"the same samples as impact {recordings.name[earlier]}",
                    code="recording-twice",
                )
            )
    return warnings


def _plain(text: str) -> str:
    """A name without what people write in different ways: case, leading zeros, what stands after a word."""
    text = unicodedata.normalize("NFKC", text).casefold().strip()
    text = _WHOLE_NUMBER.sub(r"\1", text)
    # A sign or a separator between digits is part of a number: 1.5 is not 15, -5 is not 5, 1-1 is not 11.
    text = re.sub(r"(?<=[^\W\d_])[\s_\-]+", "", text)
    return re.sub(r"(?<![\d.,])0+(?=\d)", "", text)
