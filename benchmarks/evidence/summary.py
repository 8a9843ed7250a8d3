"""Where figures come from, in a table."""

from __future__ import annotations

from typing import Any

import pandas as pd

from evidence.figures import figures
from evidence.provenance import read
from evidence.registry import content, pieces
from evidence.status import EARLIER, State, state_of
from evidence.texts import Figure, table

NOT_MEASURED = "not measured yet"
_MINUTE, _HOUR = 60, 3600
_IN_SHORT = {"fresh": "of this version", "stale": EARLIER, "missing": NOT_MEASURED}


def figure(name: str) -> Figure:
    """The figure of this name, or where all come from (evidence.provenance).

    Raises:
        KeyError: there is none of this name, nor could there be: the family is none of evidence.toml, or has
            its results and no such figure.
    """
    family = name.partition(".")[0]
    if name == "evidence.provenance":
        return Figure(_provenance(), (), block=True)
    if family not in content()["pieces"]:
        raise KeyError(f"{name}: evidence.toml has no pieces {family!r}")
    if name in figures():
        return figures()[name]
    if any(known.startswith(f"{family}.") for known in figures()):
        raise KeyError(f"{name}: there is no such figure; `python -m evidence figures` lists all")
    return Figure(NOT_MEASURED, ())


def in_words(state: State) -> str:
    """As pages say it, without what has changed."""
    return _IN_SHORT.get(state.kind, state.why)


def _provenance() -> str:
    rows = []
    for piece in pieces().values():
        record = read(piece) or {}
        versions = record.get("versions", {})
        rows.append(
            {
                "asked": piece.asks,
                "NAME": f"`{piece.name}`",
                "command": f"`{piece.command_line}`",
                "date": record.get("date", ""),
                "commit": _commit(record),
                "machine": record.get("machine", ""),
                "versions": ", ".join(f"{name} {number}" for name, number in versions.items()),
                "took": _duration(record.get("seconds")),
                "state": in_words(state_of(piece)),
            }
        )
    return table(pd.DataFrame(rows), words=True)


def _commit(record: dict[str, Any]) -> str:
    return f"{record.get('commit', '')}{' with changes' if record.get('dirty') else ''}"


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return ""
    if seconds < 2 * _MINUTE:
        return f"{seconds:.0f} s"
    return f"{seconds / _MINUTE:.0f} min" if seconds < 2 * _HOUR else f"{seconds / _HOUR:.1f} h"
