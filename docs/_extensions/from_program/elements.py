"""The elements that there are, by the models that come with the program."""

from __future__ import annotations

from collections.abc import Iterator

from bayestissue.base.outcome_table import DECLARED
from bayestissue.base.resources import model_content, shared
from bayestissue.mechanics.elements import Element, element
from from_program.markdown import code, escaped, table


def models() -> str:
    """Each model of an element, and what the tissue is by it."""
    return table(
        ["name", "the tissue is taken as"], ((code(name), escaped(met.title)) for name, met in _models())
    )


def laws() -> str:
    """The model of each force: a law that exists is found by it."""
    return table(["force", "model"], ((f"${met.law}$", code(name)) for name, met in _models()))


def _models() -> Iterator[tuple[str, Element]]:
    contents = (model_content(path) for path in shared("models").glob("*.toml"))
    # Those of the default first, then by name.
    found = [
        (each["name"], element(each["element"])) for each in contents if each.get("likelihood") == "impact"
    ]
    yield from sorted(found, key=lambda one: (one[0] != "impact", one[0]))


def outcomes() -> str:
    """What an impact comes to: each outcome with its column, unit, formula and source."""
    rows = (
        (
            code(name),
            code(one.column),
            one.shown[1] if one.shown[2] == 1 else one.unit,
            one.formula,
            one.source,
        )
        for name, one in DECLARED.items()
    )
    return table(["variable", "column of `predict`", "unit", "formula", "source"], rows)
