"""Words that are declared once: in TOML beside the code that they are of, or in a docstring."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any


def declared(package: str, file: str) -> dict[str, Any]:
    """The content of a TOML file of a package, such as ``declared(__package__, "kinds.toml")``."""
    return tomllib.loads(files(package).joinpath(file).read_text(encoding="utf-8"))


def sentences(package: str) -> Callable[..., str]:
    """What writes the sentences of a package's ``sentences.toml``.

    ``said("sources.window", share=0.1)`` is the sentence ``window`` of ``[sources]`` with 0.1 in its braces.
    """
    texts = declared(package, "sentences.toml")

    def said(name: str, /, **values: object) -> str:
        group, _, which = name.partition(".")
        return str(texts[group][which]).format(**values)

    return said


def described(doc: str | None, heading: str) -> tuple[str, dict[str, str]]:
    """A docstring up to a ``heading`` such as "Args", and by name what stands under it of each."""
    words, _, listed = inspect.cleandoc(doc or "").partition(f"\n\n{heading}:\n")
    entries = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", listed, re.MULTILINE)
    return words, {name: " ".join(text.split()) for name, text in entries}
