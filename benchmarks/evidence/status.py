"""Whether a piece of evidence is of the program as it is now."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from evidence.fingerprint import changed, of_parts
from evidence.provenance import digest, read, references_of
from evidence.registry import ROOT, Piece


@dataclass(frozen=True)
class State:
    """What is known of a piece: its kind in a word, and the reason in words."""

    kind: str
    why: str


@cache
def state_of(piece: Piece) -> State:
    """Fresh, stale, unfinished, or missing."""
    rows, about = piece.rows(), read(piece)
    if about is None or (rows.empty and not about["left"]):
        return State("missing", "not measured")
    if about["left"]:
        return State("unfinished", f"unfinished: {about['left']}")
    if digest(rows) != about["rows"]:
        return State("stale", f"its rows of benchmarks/results/{piece.name}.csv are not those that it wrote")
    if moved := about["changed_meanwhile"]:
        return State("stale", f"the program changed while it ran: {', '.join(moved)}")
    if moved := changed(about.get("references", {}), references_of(piece)):
        return State("stale", f"numbers changed since: {', '.join(moved)}")
    if moved := changed(about["parts"], of_parts(ROOT, piece.parts())):
        return State("stale", f"changed since: {', '.join(moved)}")
    return State("fresh", "of this version")
