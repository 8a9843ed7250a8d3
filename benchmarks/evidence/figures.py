"""Tables, sentences and single figures, made of the result files."""

from __future__ import annotations

from functools import cache

# Each puts its families into FAMILIES.
from evidence.families import (  # noqa: F401
    answers,
    channels,
    elements,
    faults,
    intervals,
    outcomes,
    program,
    speed,
)
from evidence.registry import of_family
from evidence.status import state_of
from evidence.texts import FAMILIES, Figure


@cache
def figures() -> dict[str, Figure]:
    """All of them by name, FAMILY.FIGURE; those of a family that is not measured in full are not there."""
    found = {}
    for family, made in FAMILIES.items():
        if all(state_of(piece).kind in ("fresh", "stale") for piece in of_family(family)):
            found |= {f"{family}.{name}": figure for name, figure in made()}
    return found
