"""What the pages of a watch and of a dataset show, as JSON, and the decisions that are taken on them."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from bayestissue.base.errors import InputError, printable
from bayestissue.base.words import PLAIN, Words
from bayestissue.inference.points.notes import PHANTOM
from bayestissue.inference.single.impact_estimates import estimate
from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.impact_table import required_columns
from bayestissue.recordings.dataset.left_out import FILE, reasons, write_left_out
from bayestissue.studies.bench.growing_study import level
from bayestissue.studies.bench.verdict import verdict
from bayestissue.studies.bench.watching import Watch, numbers_of
from bayestissue.studies.one_impact import Impact, impact_of

# Of a trace: more points than a page has pixels.
_POINTS = 600
_NUMBERS = ("K", "C", "outcomes")
_EDITABLE = (*required_columns()[1:], "side")


# Of each file of the page, the files that it is put together of.
_FILES = {"page.css": ["page.css"], "page.js": ["server.js", "page.js"]}


def page_file(name: str) -> str:
    """A file of the folder `page`."""
    return files(__package__).joinpath("page", name).read_text(encoding="utf-8")


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


class DropsView(ABC):
    """A page of drops with verdicts, numbers and traces; see `bayestissue.studies.bench.server.View`."""

    has_figures = False

    def read(self, name: str, query: Mapping[str, Sequence[str]]) -> Any:
        """The page, its files, its state since a version, or one drop.

        Raises:
            KeyError: there is nothing of that name.
        """
        match name:
            case "state":
                since = query.get("since", ["0"])[0][:15]
                return self.state(int(since) if since.isascii() and since.isdecimal() else 0)
            case "drop":
                return self.drop(query["impact"][0])
            case "index.html":
                return self.nouns.page(page_file(name))
            case _:
                return "\n".join(map(page_file, _FILES[name]))

    @property
    def nouns(self) -> Words:
        """What people, conditions and impacts are called here."""
        return PLAIN

    def _nouns(self) -> dict[str, str]:
        """What the page's script says of people."""
        return {"person": self.nouns("person"), "its": self.nouns("its person so far")}

    @abstractmethod
    def state(self, since: int) -> dict[str, Any]:
        """All that is general, and the drops and lines that changed after a version."""

    @abstractmethod
    def drop(self, impact: str) -> dict[str, Any]:
        """One drop with its trace. Raises KeyError where there is none."""


class WatchView(DropsView):
    """A watch as a page has it."""

    def __init__(self, watch: Watch) -> None:
        self.watch = watch

    @property
    def nouns(self) -> Words:
        """The campaign's."""
        return self.watch.nouns

    @property
    def version(self) -> int:
        """Of the drops and all that is said."""
        return self.watch.drops.version

    def state(self, since: int) -> dict[str, Any]:
        """All that is general, and the drops and lines that changed after a version."""
        watch = self.watch
        name, said = watch.last
        version, used, left = self.version, watch.drops.used, watch.left()
        hit = [drop for drop in used if not drop.of_phantom]
        last = {level(drop.cells): drop for drop in hit}
        count = {key: sum(level(drop.cells) == key for drop in hit) for key in last}
        people = []
        for key, drop in last.items():
            study = watch.study.estimates(drop)
            person = {"person": " ".join(key), "drops": count[key], "mass_kg": drop.cells["mass_kg"]}
            people.append(person | ({"K": study.person["K"], "width": study.width} if study else {}))
        return {
            "version": version,
            "back": "Take the last drop back",
            "name": watch.campaign.settings.name,
            "watching": printable(str(watch.recordings)),
            "dataset": printable(str(watch.drops.folder)),
            "used": len(used),
            "wanted": watch.campaign.wanted.relative_width,
            "people": people,
            "nouns": self._nouns(),
            "last": {
                **{"name": name, "kind": said.kind},
                **{"words": self.nouns(said.words), "advice": self.nouns(said.advice)},
            },
            "study": watch.study.drops,
            "planned": bool(watch.order.rows),
            "left": len(left),
            "next": left[0] if left else {},
            "chosen": {name: watch.drops.chosen.get(name, "") for name in _EDITABLE},
            "drops": [
                {
                    **{name: getattr(drop, name) for name in ("impact", "kind", "left_out", *_NUMBERS)},
                    **{
                        "reason": self.nouns(drop.reason or (PHANTOM if drop.of_phantom else "")),
                        "taken": drop.taken,
                        "cells": drop.cells,
                    },
                }
                for drop in watch.drops
                if drop.changed > since or not since
            ],
            "lines": [line.text for line in list(watch.lines) if line.version > since],
        }

    def drop(self, impact: str) -> dict[str, Any]:
        """One drop with its trace, its fit and what the study so far says of it."""
        drop = self.watch.drops.named(impact)
        estimates = self.watch.study.estimates(drop)
        study = {} if estimates is None else estimates._asdict()
        return {"impact": impact, "study": study, "trace": trace(self.watch.impact(impact))}

    def act(self, action: str, content: dict[str, Any]) -> None:
        """Take the last drop back, leave one out or use it again, or set facts of the next ones."""
        match action:
            case "take-back":
                self.watch.take_back()
            case "decide":
                self.watch.decide(str(content["impact"]), one_line(content["reason"]))
            case "choose":
                self.watch.choose({name: one_line(content.get(name, "")) for name in _EDITABLE})
            case _:
                raise KeyError(action)


class DatasetView(DropsView):
    """A dataset as a page has it: its impacts, each of which is left out or used again."""

    def __init__(self, folder: Path, why_not: str = "") -> None:
        """Estimate every impact by itself, those that are left out too.

        Args:
            folder: of the dataset.
            why_not: why it can only be looked at; empty where it can be changed.

        Raises:
            InputError: it is no dataset that can be used.
        """
        self.why_not = why_not
        self.data = read_dataset(folder, skip_bad=True, whole=True)
        self._rows = estimate(self.data).set_index("impact", drop=False)
        self._decisions = Decisions(folder, self._rows.index)
        # What one impact needs is compiled before a page asks for it.
        self.drop(self._rows.index[0])

    @property
    def nouns(self) -> Words:
        """The dataset's."""
        return Words(self.data.words, {self.data.name, *map(str, self._rows.index)})

    @property
    def version(self) -> int:
        """Of the decisions."""
        return self._decisions.version

    def state(self, since: int) -> dict[str, Any]:
        """All that is general, and the impacts that changed after a version."""
        version, out = self.version, self._decisions.reasons
        wrong = [*filter(None, [self.why_not]), *(self.nouns(f"{p}") for p in self.data.left_out)]
        return {
            "version": version,
            "back": "Undo the last decision",
            "name": self.data.name,
            "dataset": printable(str(self._decisions.folder)),
            "used": len(set(self._rows.index) - set(out)),
            "people": [],
            "nouns": self._nouns(),
            "drops": [
                self._drop(impact, out.get(impact, ""))
                for impact in reversed(self._rows.index)
                if self._decisions.changed[impact] > since
            ],
            "lines": wrong if not since else [],
        }

    def _drop(self, impact: str, left_out: str) -> dict[str, Any]:
        row = self._rows.loc[[impact]].iloc[0]
        said = verdict(flag for flag in row["flags"].split("; ") if flag)
        reason = self.nouns(said.reason or (PHANTOM if PHANTOM in row["notes"].split("; ") else ""))
        shown = {"impact": impact, "kind": said.kind, "reason": reason, "left_out": left_out}
        return shown | numbers_of(row)

    def drop(self, impact: str) -> dict[str, Any]:
        """One impact with its trace and its fit."""
        position = {name: at for at, name in enumerate(self._rows.index)}
        one = self.data.select([position[impact]])
        return {"impact": impact, "study": {}, "trace": trace(impact_of(one))}

    def act(self, action: str, content: dict[str, Any]) -> None:
        """Leave an impact out, use it again, or undo the last of these decisions."""
        if self.why_not:
            raise InputError.stated("no-dataset.read-only", str(self._decisions.folder), value=self.why_not)
        self._decisions.act(action, content)


def trace(impact: Impact) -> dict[str, list[float | None]]:
    """Times in ms, the recorded and the fitted deceleration."""
    stride = -(-len(impact.time_s) // _POINTS)
    columns = {"time_ms": impact.time_s * 1e3, "recorded": impact.deceleration, "fitted": impact.fitted}
    return {
        name: [float(f"{v:.5g}") if np.isfinite(v) else None for v in values[::stride]]
        for name, values in columns.items()
    }
