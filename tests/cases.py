"""Tables of cases, one a row, in the TOML file beside a test: what is given, and what is said or found."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest


def cases(test: str, table: str = "") -> list[Any]:
    """The rows of a table for ``parametrize``: each a table under its name, or a list of values."""
    content = tomllib.loads(Path(test).with_suffix(".toml").read_text(encoding="utf-8"))
    rows = content[table] if table else content
    if isinstance(rows, list):
        return [tuple(row) for row in rows]
    return [pytest.param(row, id=name.replace(" ", "-")) for name, row in rows.items()]
