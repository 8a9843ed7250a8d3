"""Whether data and model fit together: the measuring chain, the model's form, straight lines.

What the checks say is declared in ``verdicts.toml``.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from bayestissue.declarations import declared, filled


def sentence(key: str, **numbers: object) -> str:
    """A sentence of ``verdicts.toml`` by its table and key, such as "chain.undecided", with its numbers."""
    table, _, name = key.partition(".")
    return filled(str(_sentences()[table][name]), **numbers)


@cache
def _sentences() -> dict[str, Any]:
    return declared(__name__, "verdicts.toml")
