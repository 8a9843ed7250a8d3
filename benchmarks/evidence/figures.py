"""Tables, sentences and single figures, made of the result files."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

from evidence import families
from evidence.registry import of_family
from evidence.status import state_of
from evidence.texts import FAMILIES, Figure, figures_of

# Each puts its families into FAMILIES.
for _module in pkgutil.iter_modules(families.__path__):
    import_module(f"evidence.families.{_module.name}")


@cache
def figures() -> dict[str, Figure]:
    """All of them by name, FAMILY.FIGURE; those of a family that is not measured in full are not there."""
    return {
        f"{family}.{name}": figure
        for family in FAMILIES
        if all(state_of(piece).kind in ("fresh", "stale") for piece in of_family(family))
        for name, figure in figures_of(family)
    }
