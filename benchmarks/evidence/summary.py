"""Where figures come from, in tables: the provenance of each family, and all promises on one page."""

from __future__ import annotations

import re

import pandas as pd

from evidence.figures import figures
from evidence.provenance import read
from evidence.registry import Piece, content, of_family
from evidence.status import EARLIER, State, state_of
from evidence.texts import Figure, table

NOT_MEASURED = "not measured yet"
_MINUTE, _HOUR = 60, 3600
_IN_SHORT = {"fresh": "of this version", "stale": EARLIER, "missing": NOT_MEASURED}


def figure(name: str) -> Figure:
    """The figure of this name, a provenance (FAMILY.provenance), or the summary of all (evidence.summary).

    Raises:
        KeyError: there is none of this name, nor could there be: the family is none of evidence.toml, or has
            its results and no such figure.
    """
    family, _, what = name.partition(".")
    if name == "evidence.summary":
        return Figure(_summary(), (), block=True)
    if family not in content()["pieces"]:
        raise KeyError(f"{name}: evidence.toml has no pieces {family!r}")
    if what == "provenance":
        return Figure(_provenance(of_family(family)), (), block=True)
    if name in figures():
        return figures()[name]
    if any(known.startswith(f"{family}.") for known in figures()):
        raise KeyError(f"{name}: there is no such figure; `python -m evidence figures` lists all")
    return Figure(NOT_MEASURED, ())


def in_words(state: State) -> str:
    """As pages say it, without what has changed."""
    return _IN_SHORT.get(state.kind, state.why)


def _summary() -> str:
    rows = []
    for family, declared in content()["pieces"].items():
        own = of_family(family)
        measured = any(not piece.rows().empty for piece in own)
        said = declared["says"] if measured else NOT_MEASURED
        for name in re.findall(r"\{(\w+)\}", said):
            # The row says for all of its figures whether they are stale.
            said = said.replace(f"{{{name}}}", figure(f"{family}.{name}").text)
        rows.append(
            {
                "promise": declared["promise"],
                "figure": f"{said[0].upper()}{said[1:]}",
                "state": _together([state_of(piece) for piece in own]),
                "commit": ", ".join(dict.fromkeys(_commit(piece) for piece in own)),
                "NAME": f"`{family}`",
            }
        )
    return table(pd.DataFrame(rows), words=True)


def _together(states: list[State]) -> str:
    words = [in_words(state) for state in states]
    if len(set(words)) == 1:
        return words[0]
    return "; ".join(f"{words.count(each)} of {len(words)} {each}" for each in dict.fromkeys(words))


def _provenance(own: list[Piece]) -> str:
    rows = []
    for piece in own:
        about = read(piece) or {}
        versions = about.get("versions", {})
        rows.append(
            {
                "command": f"`{piece.command_line}`",
                "commit": _commit(piece),
                "date": about.get("date", "unknown"),
                "machine": about.get("machine", "unknown"),
                "versions": ", ".join(f"{name} {number}" for name, number in versions.items()) or "unknown",
                "took": _took(about.get("seconds")),
                "state": in_words(state_of(piece)),
            }
        )
    return table(pd.DataFrame(rows), words=True)


def _commit(piece: Piece) -> str:
    about = read(piece)
    if about is None:
        return "unknown"
    return about["commit"] + (" with changes" if about["dirty"] else "")


def _took(seconds: float | None) -> str:
    if seconds is None:
        return "unknown"
    if seconds < 2 * _MINUTE:
        return f"{seconds:.0f} s"
    return f"{seconds / _MINUTE:.0f} min" if seconds < 2 * _HOUR else f"{seconds / _HOUR:.1f} h"
