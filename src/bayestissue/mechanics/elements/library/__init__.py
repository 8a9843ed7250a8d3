"""The elements that there are: one module each, with its ``ELEMENT``; see `elements.element.Element`.

A new one is found here by itself.
"""

from __future__ import annotations

import pkgutil
from functools import lru_cache
from importlib import import_module

from bayestissue.mechanics.elements.element import Element


@lru_cache
def _elements() -> dict[str, Element]:
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    elements = [import_module(f"{__name__}.{name}").ELEMENT for name in names]
    return {element.name: element for element in elements}


def element_names() -> tuple[str, ...]:
    """The names of all elements."""
    return tuple(_elements())


def element(name: str | Element) -> Element:
    """The element of that name.

    Raises:
        KeyError: there is none; the message lists those that there are.
    """
    if isinstance(name, Element):
        return name
    try:
        return _elements()[name]
    except KeyError:
        raise KeyError(f"no element {name!r}; there are {', '.join(element_names())}") from None
