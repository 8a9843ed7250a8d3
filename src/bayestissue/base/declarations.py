"""Words that are declared once: in TOML beside the code that they are of, or in a docstring."""

from __future__ import annotations

import inspect
import re
import string
import textwrap
import tomllib
from collections.abc import Callable, Mapping
from functools import wraps
from importlib.resources import files
from numbers import Real
from typing import Any

# From here on a number that has no more digits than are shown is written with an exponent.
_LARGE = 1e6


class _Sentences(string.Formatter):
    """Python's own, but that a ``g`` writes no exponent below a million: 120, and not 1.2e+02."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """``value`` as its place in the sentence has it."""
        text = format(value, format_spec)
        is_general = "e+" in text and format_spec.endswith("g") and isinstance(value, Real)
        if is_general and abs(float(value)) < _LARGE:
            return f"{float(text):.0f}"
        return text


_SENTENCES = _Sentences()


def filled(sentence: str, /, *cells: object, **values: object) -> str:
    """A sentence with values in its braces, numbers to significant digits without an exponent there."""
    return _SENTENCES.vformat(sentence, cells, values)


def general(value: float, digits: int = 4) -> str:
    """A number to so many significant digits, without an exponent below a million: 50000, and not 5e+04."""
    return _SENTENCES.format_field(value, f".{digits}g")


def declared(package: str, file: str) -> dict[str, Any]:
    """The content of a TOML file of a package, such as ``declared(__package__, "remedies.toml")``."""
    return tomllib.loads(files(package).joinpath(file).read_text(encoding="utf-8"))


def sentences(package: str) -> Callable[..., str]:
    """What writes the sentences of a package's ``sentences.toml``.

    ``said("sources.window", share=0.1)`` is the sentence ``window`` of ``[sources]`` with 0.1 in its braces.
    """
    texts = declared(package, "sentences.toml")

    def said(name: str, /, **values: object) -> str:
        group, _, which = name.partition(".")
        return filled(str(texts[group][which]), **values)

    return said


def described(doc: str | None, heading: str) -> tuple[str, dict[str, str]]:
    """A docstring up to a ``heading`` such as "Args", and by name what stands under it of each."""
    words, _, listed = inspect.cleandoc(doc or "").partition(f"\n\n{heading}:\n")
    entries = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", listed, re.MULTILINE)
    return words, {name: " ".join(text.split()) for name, text in entries}


def taking[**P, R](
    arguments: Mapping[str, tuple[inspect.Parameter, str]],
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """What gives a function that ends in ``**stated`` these arguments, each with what it means.

    They stand in its signature and, in the place of ``**stated:``, in its docstring. Another argument is a
    TypeError.
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function, eval_str=True)
        *before, _ = signature.parameters.values()
        parameters = [*before, *(one.replace(name=name) for name, (one, _) in arguments.items())]

        @wraps(function)
        def called(*args: P.args, **kwargs: P.kwargs) -> R:
            checked.bind(*args, **kwargs)
            return function(*args, **kwargs)

        checked = signature.replace(parameters=sorted(parameters, key=lambda parameter: parameter.kind))
        meanings = (
            textwrap.fill(f"{name}: {meaning}", 106, initial_indent=" " * 4, subsequent_indent=" " * 8)
            for name, (_, meaning) in arguments.items()
        )
        words, _, stated = inspect.cleandoc(function.__doc__ or "").partition("\n    **stated:")
        _, gap, after = stated.partition("\n\n")
        called.__doc__ = "\n".join([words, *meanings]) + gap + after
        called.__signature__ = checked  # type: ignore[attr-defined]
        return called

    return decorated
