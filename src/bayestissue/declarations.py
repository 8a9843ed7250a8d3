"""Tables of words and settings that lie beside the code that they are of, in TOML."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any


def declared(package: str, file: str) -> dict[str, Any]:
    """The content of a TOML file of a package, such as ``declared(__package__, "kinds.toml")``."""
    return tomllib.loads(files(package).joinpath(file).read_text(encoding="utf-8"))
