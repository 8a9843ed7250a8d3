"""The folders of the program, by the docstrings of its packages."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Iterator
from importlib import import_module

import bayestissue
from from_program.markdown import code, escaped, table


def folders() -> str:
    """A row for each folder and its first sentence, nested ones below the folder that holds them."""
    return table(["folder", "what is in it"], _rows(bayestissue))


def _rows(package: object) -> Iterator[tuple[str, str]]:
    for found in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        if found.ispkg:
            inner = import_module(found.name)
            told = (inspect.getdoc(inner) or "").split("\n\n")[0].replace("\n", " ")
            yield code(found.name.partition(".")[2].replace(".", "/")), escaped(told)
            yield from _rows(inner)
