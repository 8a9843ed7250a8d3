"""Tables, sentences and single figures, made of the result files."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module

import pandas as pd

from evidence import families
from evidence.registry import content, of_family
from evidence.status import state_of
from evidence.texts import Figure, Named, raw, sentence, table

_MODULES = [
    import_module(f"evidence.families.{module.name}") for module in pkgutil.iter_modules(families.__path__)
]
# By the name of a family of pieces the function of that name that makes its figures of its raw results.
FAMILIES: dict[str, Callable[[pd.DataFrame], Named]] = {
    name: getattr(module, name)
    for name in content()["pieces"]
    for module in _MODULES
    if hasattr(module, name)
}


@cache
def figures() -> dict[str, Figure]:
    """All of them by name, FAMILY.FIGURE; those of a family that is not measured in full are not there."""
    return {
        f"{family}.{name}": figure
        for family in FAMILIES
        if all(state_of(piece).kind in ("fresh", "stale") for piece in of_family(family))
        for name, figure in figures_of(family)
    }


def figures_of(family: str) -> Iterator[tuple[str, Figure]]:
    """The figures of a family by name."""
    for name, made in FAMILIES[family](raw(family)):
        if isinstance(made, pd.DataFrame):
            yield name, Figure(table(made), block=True)
        elif isinstance(made, Figure):
            yield name, made
        else:
            yield name, Figure(made if isinstance(made, str) else sentence(family, name, made))
