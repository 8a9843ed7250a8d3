"""One look after the other at the recorder's folder: what is whole is taken, judged, and told."""

from __future__ import annotations

import hashlib
import shutil
import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from time import sleep
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.bench.campaign import Campaign
from bayestissue.bench.drops import Drop, Drops, dataset_of, several
from bayestissue.bench.following import Follower, listing
from bayestissue.bench.order import Order
from bayestissue.bench.study import Study
from bayestissue.bench.verdict import Verdict, verdict
from bayestissue.dataset import read_dataset
from bayestissue.dataset.recorders import suffix_of
from bayestissue.errors import InputError, Problem, printable
from bayestissue.figures.impacts import end
from bayestissue.inference.results.meanings import COLUMNS, UNITS
from bayestissue.intake.build import RECORDINGS
from bayestissue.intake.facts import Cells
from bayestissue.intake.names import columns
from bayestissue.one_impact import Impact, impact_of
from bayestissue.one_impact import impact as one_impact
from bayestissue.signal.quality.inspection import KINDS, inspect

# Traces that pages can be shown at once; of others they are read anew. And lines that pages can catch up on.
_TRACES, _LINES = 30, 200
_INCOMING = f"{RECORDINGS}/.incoming"
TAKEN_BACK = "taken back"


class Line(NamedTuple):
    """A line that is said, with the number of the change that it came with."""

    version: int
    text: str


class Watch:
    """A campaign that is being watched; its methods may be called from several threads.

    Attributes:
        drops: what was taken.
        study: what the drops together tell.
        chosen: facts of the next drops, as they were set on the page.
        lines: the last ones that were said.
        last: the drop or file that was judged last, and how.
    """

    def __init__(
        self, recordings: Path, campaign: Campaign, drops: Drops, order: Order, say: Callable[[str], None]
    ) -> None:
        self.recordings, self.campaign, self.drops, self.order = recordings, campaign, drops, order
        self.study = Study(campaign)
        self.chosen: dict[str, str] = {}
        self.lines: deque[Line] = deque(maxlen=_LINES)
        self.last = ("", Verdict("look", "no drop yet"))
        self._say, self._lock = say, threading.RLock()
        self._follower = Follower({drop.file: drop.stamp for drop in drops})
        self._impacts: OrderedDict[tuple[str, str], Impact] = OrderedDict()
        self._away = False
        shutil.rmtree(drops.folder / _INCOMING, ignore_errors=True)

    def warm_up(self) -> None:
        """Compile what drops will need: by the last drop, by one of the dataset that is like, or made up."""
        last = next(iter(reversed(self.drops.all)), None)
        if last is not None:
            impact = self.impact(last.impact)
        elif self.campaign.like is not None:
            data = read_dataset(self.campaign.like, skip_bad=True)
            impact = impact_of(replace(data, impacts=data.impacts.iloc[:1], traces=data.traces[:1]))
        else:
            time = np.arange(400) / 1e4 - 0.005
            value = np.where(time > 0, 100 * np.sin(80 * time) * np.exp(-10 * time), 0.0)
            noise = np.random.default_rng(0).normal(0, 0.3, len(time))
            impact = one_impact(time, np.maximum(value, 0) + noise, mass_kg=1.0, velocity_m_s=1.5)
        self.study.site(impact)
        self.study.update(self.drops.used, wait=True)

    def catch_up(self, poll_s: float) -> None:
        """Look until nothing is new twice over."""
        quiet = 0
        while quiet < 2:
            quiet = 0 if self.look() else quiet + 1
            sleep(poll_s)

    def look(self) -> bool:
        """Look at the folder once, and take what is whole; whether there was anything new."""
        try:
            listed = listing(self.recordings, self.campaign.suffixes)
        except OSError as error:
            if not self._away:
                self.say(f"{self.recordings} can't be read: {error.strerror}; waiting for it")
            self._away = True
            return False
        self._away = False
        ready, empty, gone = self._follower.changes(listed)
        for name in empty:
            self.say(f"{name}: empty so far")
        for name in gone:
            if self.drops.of_file(name):
                self.say(f"{name}: deleted from the recorder's folder; the dataset keeps it")
        for name in ready:
            self._follower.settled[name] = listed[name]
            with self._lock:
                self._take(name)
        return bool(ready)

    def _take(self, name: str) -> None:
        source, incoming = self.recordings / name, self.drops.folder / _INCOMING / name
        incoming.parent.mkdir(parents=True, exist_ok=True)
        try:
            shutil.copyfile(source, incoming)
            with incoming.open("rb") as file:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            self._take_whole(name, incoming, sha256)
        except OSError as error:
            # It may be there, or free, at the next look.
            del self._follower.settled[name]
            self.say(f"{name}: can't be read: {error.strerror}; trying again")
        except InputError as error:
            said = Verdict("again", " ".join(dict.fromkeys(map(_in_short, error.problems))))
            self.last = name, said
            self.say(f"{name}: {said.words}")
        finally:
            incoming.unlink(missing_ok=True)

    def _take_whole(self, name: str, incoming: Path, sha256: str) -> None:
        stamp, earlier = self._follower.settled[name], self.drops.of_file(name)
        same = next((drop for drop in self.drops if drop.sha256 == sha256), None)
        if same is not None and same.file == name:
            same.stamp = stamp
            return
        if same is not None:
            self.say(f"{name}: the same recording as {same.file}; not taken twice")
            return
        row = self.drops.row(name, self.cells(name))
        destination = self.drops.folder / str(row["trace"])
        impact = impact_of(
            dataset_of(self.drops.folder, self.campaign, {**row, "trace": f"{_INCOMING}/{name}"})
        )
        drop = self._judged(name, row, impact, sha256)
        destination.parent.mkdir(parents=True, exist_ok=True)
        incoming.replace(destination)
        self.drops.taken(drop)
        self.last = drop.impact, Verdict(drop.kind, drop.reason, drop.code)
        self._impacts[drop.impact, sha256] = impact
        while len(self._impacts) > _TRACES:
            self._impacts.popitem(last=False)
        self.study.update(self.drops.used)
        self.say(
            f"{'overwritten, taken anew: ' if earlier else ''}{self.line(self.drops.named(drop.impact))}"
        )

    def _another_velocity(self, impact: Impact) -> str:
        """What the recordings that are at hand say together of this one's velocity; empty if nothing."""
        names = {drop.impact for drop in self.drops.used}
        here = str(impact.dataset.impacts["impact"].iloc[0])
        others = [known.dataset for (name, _), known in self._impacts.items() if name in names - {here}]
        together = [*others, impact.dataset]
        joined = replace(
            impact.dataset,
            impacts=pd.concat([data.impacts for data in together], ignore_index=True),
            traces=[trace for data in together for trace in data.traces],
        )
        said = [f for f in inspect(joined) if f.kind is KINDS["velocity-contradicted"] and f.said[-1]]
        return f"{said[0].kind.flag}: {said[0].said[-1]}" if said else ""

    def _judged(self, name: str, row: Cells, impact: Impact, sha256: str) -> Drop:
        numbers = numbers_of(impact.row)
        flags = [*impact.flags, *(w.code for w in impact.dataset.warnings if w.impact)]
        if another := self._another_velocity(impact):
            flags.append(another)
        if (count := several(impact.dataset)) > 1:
            flags.insert(0, f"the recording seems to hold several impacts ({count})")
        wanted = self.campaign.wanted
        site = self.study.site(impact)
        velocity = float(row.get("velocity_m_s", np.nan)), wanted.velocity_m_s, wanted.velocity_within
        others = [drop for drop in self.drops.used if drop.file != name]
        said = verdict(flags, velocity=velocity, unlike=self.study.unlike(row, site, others))
        return Drop(
            file=name,
            stamp=self._follower.settled[name],
            sha256=sha256,
            cells=row,
            kind=said.kind,
            reason=said.reason,
            code=said.code,
            left_out=said.reason if said.spoilt else "",
            K=numbers["K"],
            C=numbers["C"],
            **site,
            taken=f"{datetime.now().astimezone():%Y-%m-%d %H:%M:%S}",
        )

    def cells(self, name: str) -> Cells:
        """The cells of a file's row that are known: by its name, the page, the order, the campaign."""
        left = self.left()
        following = {k: str(v) for k, v in left[0].items()} if left else {}
        return self.campaign.cells(name, suffix_of(Path(name)), following, self.chosen)

    def left(self) -> list[Cells]:
        """The drops that the order or the plan still has."""
        return self.order.left(drop.cells for drop in self.drops.used)

    def take_back(self) -> Drop | None:
        """Leave the last drop out that is in use; None where there is none."""
        with self._lock:
            used = self.drops.used
            return self.decide(used[-1].impact, TAKEN_BACK) if used else None

    def decide(self, impact: str, reason: str) -> Drop:
        """Leave a drop out, or use it again where the reason is empty.

        Raises:
            KeyError: there is no such drop.
        """
        with self._lock:
            drop = self.drops.decide(impact, reason)
            self.study.update(self.drops.used)
        self.say(f"{impact}: left out: {reason}" if reason else f"{impact}: used again")
        return drop

    def choose(self, facts: dict[str, str]) -> None:
        """Set facts of the next drops; an empty one is what name, order or campaign say.

        Raises:
            InputError: one is no number, as it should be.
        """
        chosen = {name: text for name, text in facts.items() if text}
        columns(chosen, "page")
        with self._lock:
            self.chosen = chosen
            self.drops.version += 1

    def impact(self, name: str) -> Impact:
        """One drop with its trace and its fit.

        Raises:
            KeyError: there is no such drop.
        """
        with self._lock:
            drop = self.drops.named(name)
            known = self._impacts.get((name, drop.sha256))
            return known or impact_of(dataset_of(self.drops.folder, self.campaign, drop.cells))

    def line(self, drop: Drop) -> str:
        """A drop in one line: its verdict, K and C by themselves and in the study so far, what is left."""
        words = [f"{drop.impact}: {Verdict(drop.kind, drop.reason).words}"]
        words += [f"{q} {_interval(getattr(drop, q))} {unit}" for q, unit in UNITS.items()]
        words += self.study.words(drop)
        if self.order.rows:
            left = self.left()
            words.append(f"{len(left)} drops left{f', next {facts_words(left[0])}' if left else ''}")
        return "; ".join(words)

    def say(self, text: str) -> None:
        """Say a line on the terminal and on pages."""
        self.drops.version += 1
        self.lines.append(Line(self.drops.version, text))
        self._say(text)


def numbers_of(row: pd.Series) -> dict[str, list[float | None]]:
    """K and C of a row of `estimates.csv`: medians and ends of intervals, None where there is no number."""
    names = {q: (column, end(q, "low"), end(q, "high")) for q, column in COLUMNS.items()}
    return {q: [_number(row[name]) for name in columns] for q, columns in names.items()}


def facts_words(cells: Cells) -> str:
    """The facts of a drop in words."""
    return ", ".join(f"{name} {v:g}" if isinstance(v, float) else f"{name} {v}" for name, v in cells.items())


def _in_short(problem: Problem) -> str:
    """What is wrong with a file that can't be used, whose name is said anyway."""
    return printable(f"found {problem.value}; expected {problem.expected}. {problem.remedy}")


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _interval(numbers: list[float | None]) -> str:
    middle, low, high = (None if value is None else f"{value:.4g}" for value in numbers)
    return f"{middle or 'no number'} ({low} to {high})" if low and high else middle or "no number"
