"""What the page of a watch shows, as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayestissue.bench.study import level
from bayestissue.bench.watching import Watch
from bayestissue.dataset.impacts import wanted
from bayestissue.one_impact import Impact

# Of a trace: more points than a page has pixels.
_POINTS = 600
_EDITABLE = (*wanted(needs_velocity=True)[1:], "side")


class WatchView:
    """A watch as a page has it; see `bayestissue.bench.server.View`."""

    def __init__(self, watch: Watch) -> None:
        self.watch = watch

    @property
    def version(self) -> int:
        """Of the drops and all that is said."""
        return self.watch.drops.version

    def state(self, since: int) -> dict[str, Any]:
        """All that is general, and the drops and lines that changed after a version."""
        watch = self.watch
        name, said = watch.last
        version, used, left = self.version, watch.drops.used, watch.left()
        last = {level(drop.cells): drop for drop in used}
        count = {key: sum(level(drop.cells) == key for drop in used) for key in last}
        people = []
        for key, drop in last.items():
            told = watch.study.told(drop)
            person = {"person": " ".join(key), "drops": count[key], "mass_kg": drop.cells["mass_kg"]}
            people.append(person | ({"K": told.person["K"], "width": told.width} if told else {}))
        return {
            "version": version,
            "name": watch.campaign.settings.name,
            "watching": str(watch.recordings),
            "dataset": str(watch.drops.folder),
            "used": len(used),
            "wanted": watch.campaign.wanted.relative_width,
            "people": people,
            "last": {"name": name, "kind": said.kind, "words": said.words, "advice": said.advice},
            "study": watch.study.drops,
            "planned": bool(watch.order.rows),
            "left": len(left),
            "next": left[0] if left else {},
            "chosen": {name: watch.chosen.get(name, "") for name in _EDITABLE},
            "drops": [
                {
                    **{
                        name: getattr(drop, name)
                        for name in ("impact", "kind", "reason", "left_out", "K", "C")
                    },
                    **{"taken": drop.taken, "cells": drop.cells},
                }
                for drop in watch.drops
                if drop.changed > since or not since
            ],
            "lines": [line.text for line in list(watch.lines) if line.version > since],
        }

    def drop(self, impact: str) -> dict[str, Any]:
        """One drop with its trace, its fit and what the study so far says of it."""
        drop = self.watch.drops.named(impact)
        told = self.watch.study.told(drop)
        study = {} if told is None else told._asdict()
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


def one_line(text: Any) -> str:
    """A text of a page as a cell of a table can have it."""
    return " ".join("".join(c if c.isprintable() else " " for c in str(text)[:200]).split())


def trace(impact: Impact) -> dict[str, list[float | None]]:
    """Times in ms, the recorded and the fitted deceleration."""
    every = -(-len(impact.time_s) // _POINTS)
    columns = {"time_ms": impact.time_s * 1e3, "recorded": impact.deceleration, "fitted": impact.fitted}
    return {
        name: [float(f"{v:.5g}") if np.isfinite(v) else None for v in values[::every]]
        for name, values in columns.items()
    }
