"""Impacts of a dataset that are left out or accepted on a page, each decision to be undone."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.left_out import FILE, reasons, write_left_out


class Decisions:
    """What `left_out.csv` of a dataset says, and is made to say; safe to be called from several threads.

    Attributes:
        folder: of the dataset.
        version: counts changes, from 1.
        changed: of each impact the change that last concerned it.
    """

    def __init__(self, folder: Path, impacts: Iterable[str]) -> None:
        self.folder, self.version = folder, 1
        self.changed = dict.fromkeys(impacts, 1)
        # Of each decision, the impact and the reason before it.
        self._before: list[tuple[str, str]] = []
        self._lock = threading.Lock()

    @property
    def reasons(self) -> dict[str, str]:
        """Why each impact is left out, by those that are."""
        return reasons(self.folder)

    def act(self, action: str, content: dict[str, Any]) -> None:
        """Leave an impact out ("decide" with a reason), accept it ("decide" without one), or "take-back".

        Raises:
            KeyError: no such action or impact, or nothing to take back.
            InputError: no impact would be left.
        """
        with self._lock:
            if action == "decide":
                impact, reason = str(content["impact"]), one_line(content["reason"])
                before = impact, self.reasons.get(impact, "")
                self._write(impact, reason)
                self._before.append(before)
            elif action == "take-back" and self._before:
                self._write(*self._before[-1])
                self._before.pop()
            else:
                raise KeyError(action)

    def _write(self, impact: str, reason: str) -> None:
        if impact not in self.changed:
            raise KeyError(impact)
        left_out = {k: v for k, v in (self.reasons | {impact: reason}).items() if v}
        if set(self.changed) <= set(left_out):
            raise InputError.stated("none-left", FILE, value="none left", impact=impact)
        write_left_out(self.folder, left_out)
        # In this order: who reads the new version finds the change.
        self.changed[impact] = self.version + 1
        self.version += 1


def one_line(text: Any) -> str:
    """A text of a page as a cell of a table can have it."""
    return " ".join("".join(c if c.isprintable() else " " for c in str(text)[:200]).split())
