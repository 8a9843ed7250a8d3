"""Where figures come from, in a table."""

from __future__ import annotations

from typing import Any

import pandas as pd

from evidence.figures import figures
from evidence.provenance import head, read
from evidence.registry import content, pieces
from evidence.status import state_of
from evidence.texts import Figure, table

NOT_MEASURED = "not measured yet"
_MINUTE, _HOUR = 60, 3600


def figure(name: str) -> Figure:
    """The figure of this name, or where all come from (evidence.provenance), and of which version they are.

    Raises:
        KeyError: there is none of this name, nor could there be: the family is none of evidence.toml, or has
            its results and no such figure.
    """
    family = name.partition(".")[0]
    if name == "evidence.provenance":
        return Figure(_provenance(), block=True)
    if name == "evidence.versions":
        return Figure(_versions(), block=True)
    if family not in content()["pieces"]:
        raise KeyError(f"{name}: evidence.toml has no pieces {family!r}")
    if name in figures():
        return figures()[name]
    if any(known.startswith(f"{family}.") for known in figures()):
        raise KeyError(f"{name}: there is no such figure; `python -m evidence figures` lists all")
    return Figure(NOT_MEASURED, measured=False)


def _provenance() -> str:
    rows = []
    for piece in pieces().values():
        record = {"date": "", "machine": "", **(read(piece) or {})}
        row = {"asked": piece.asks, "NAME": f"`{piece.name}`", "command": f"`{piece.command_line}`"}
        row |= {"date": record["date"], "commit": _commit(record), "machine": record["machine"]}
        row["versions"] = ", ".join(f"{name} {number}" for name, number in record.get("versions", {}).items())
        rows.append(row | {"took": _duration(record.get("seconds"))})
    return table(pd.DataFrame(rows), words=True)


def _versions() -> str:
    """Which figures are of the program as it is now; each of the others with the commit that measured it."""
    earlier, open_ = [], []
    for piece in pieces().values():
        state = state_of(piece)
        if state.kind == "stale":
            earlier.append(f"`{piece.name}` ({_commit(read(piece) or {})})")
        elif state.kind != "fresh":
            open_.append(f"`{piece.name}` ({state.why})")
    written = f"The manual was built at commit {head()}. "
    if not earlier and not open_:
        return f"{written}All figures were of that version."
    said = [f"Measured on an earlier version, at the commit given: {', '.join(earlier)}."] if earlier else []
    said += [f"Not measured in full: {', '.join(open_)}."] if open_ else []
    return f"{written}{' '.join(said)} All others were of that version."


def _commit(record: dict[str, Any]) -> str:
    return f"{record.get('commit', '')}{' with changes' if record.get('dirty') else ''}"


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return ""
    if seconds < 2 * _MINUTE:
        return f"{seconds:.0f} s"
    return f"{seconds / _MINUTE:.0f} min" if seconds < 2 * _HOUR else f"{seconds / _HOUR:.1f} h"
