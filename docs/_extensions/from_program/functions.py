"""Every public name of the Python package: its signature and its docstring."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterator
from functools import cached_property
from typing import Any

from sphinx.ext.napoleon import Config, GoogleDocstring

import bayestissue as bt

_DOCSTRINGS = Config(napoleon_use_ivar=True, napoleon_use_rtype=False, napoleon_use_admonition_for_notes=True)


def functions() -> str:
    """A section for each public name: functions first, then what they return."""
    names = sorted(bt.__all__, key=lambda name: (inspect.isclass(getattr(bt, name)), name.lower()))
    return "\n\n".join(f"## {name}\n\n```{{eval-rst}}\n{_public(name)}\n```" for name in names)


def _public(name: str) -> str:
    # A package that can be called has its function beneath.
    value = inspect.unwrap(getattr(bt, name))
    head = ".. py:currentmodule:: bayestissue\n\n"
    if not inspect.isclass(value):
        return head + _directive("function", name + _signature(value), _text(value))
    return head + _directive("class", name, _text(value) + "".join(f"\n\n{each}" for each in _members(value)))


def _members(of: type) -> Iterator[str]:
    for name, value in vars(of).items():
        if name.startswith("_"):
            continue
        if isinstance(value, property | cached_property):
            yield _directive("property", name, _text(value))
        elif inspect.isfunction(value):
            yield _directive("method", name + _signature(value), _text(value))


def _signature(function: Any) -> str:
    """Names and defaults; shapes and units stand in the docstring."""
    signature = inspect.signature(function)
    plain = [each.replace(annotation=each.empty) for each in signature.parameters.values()]
    plain = [each for each in plain if each.name != "self"]
    return str(signature.replace(parameters=plain, return_annotation=signature.empty))


def _text(value: Any) -> str:
    return "\n".join(GoogleDocstring(inspect.getdoc(value) or "", _DOCSTRINGS).lines())


def _directive(kind: str, name: str, text: str) -> str:
    return f".. py:{kind}:: {name}\n\n{textwrap.indent(text, '   ')}"
