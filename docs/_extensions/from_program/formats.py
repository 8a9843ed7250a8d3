"""The formats of recordings, by the modules that read them."""

from __future__ import annotations

from collections.abc import Sequence

from bayestissue.recordings.dataset.formats import EACH
from bayestissue.recordings.dataset.sample_tables import TABLE_SUFFIXES, TEXT_SUFFIXES
from from_program.markdown import code, table


def formats() -> str:
    """Each format with the endings of its files, and where the times and the values are."""
    texts = _endings((*TABLE_SUFFIXES, *TEXT_SUFFIXES))
    texts += ", and any text that goes on in lines of numbers, such as `.mot` or `.trc`"
    rows = [("tables", texts, "the column `time_column`", "the column `value_column`")]
    rows += [(form.name, _endings(form.suffixes), form.time, form.value) for form in EACH]
    return table(["from", "files", "time", "value"], rows)


def _endings(suffixes: Sequence[str]) -> str:
    return ", ".join(map(code, suffixes))
