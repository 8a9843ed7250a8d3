"""Who is told how much is done."""

from __future__ import annotations

from collections.abc import Callable

# Told how many of how many parts are done.
Progress = Callable[[int, int], None]


def silent(done: int, total: int) -> None:
    """A `Progress` that says nothing."""
