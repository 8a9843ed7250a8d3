"""One look after the other at the recorder's folder: what is whole is taken, judged, and told."""

from __future__ import annotations

import math
import re
import shutil
import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from time import sleep
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded, InputError, Problem, printable
from bayestissue.base.results.files import file_sha256, put
from bayestissue.base.results.manifest import discard, mark_unfinished, require_left_over
from bayestissue.base.words import Words
from bayestissue.inference.answers.predictions import QUANTITIES
from bayestissue.inference.results.meanings import COLUMNS, UNITS
from bayestissue.inference.single.impact_estimates import outcomes_in
from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.impact_table import required_columns
from bayestissue.recordings.dataset.ragged_traces import Traces
from bayestissue.recordings.intake.build import RECORDINGS
from bayestissue.recordings.intake.facts import Cells
from bayestissue.recordings.intake.folder import natural
from bayestissue.recordings.intake.names import columns
from bayestissue.recordings.signal.quality.inspection import inspect
from bayestissue.reports.figures.impacts import end
from bayestissue.reports.pages.wording import PREDICTED, estimated
from bayestissue.studies.bench.campaign_file import WatchedCampaign
from bayestissue.studies.bench.drops import UNREADABLE, Drop, Drops, dataset_of, several
from bayestissue.studies.bench.following import Follower, Stamp, listing
from bayestissue.studies.bench.growing_study import GrowingStudy
from bayestissue.studies.bench.order import Order
from bayestissue.studies.bench.verdict import DropVerdict, verdict
from bayestissue.studies.one_impact import Impact, impact_of
from bayestissue.studies.one_impact import impact as one_impact

# Bytes of a file's name that are no UTF-8, so that no table can have it.
_NO_TEXT = re.compile("[\ud800-\udfff]")
# Traces that pages can be shown at once; of others they are read anew. And lines that pages can catch up on.
_TRACES, _LINES = 30, 200
# Recordings of its condition that a new one is asked with: they tell another velocity, and more would wait.
_TOGETHER = 11
# How often a look that fails is repeated where nobody waits.
_TRIES = 5
_INCOMING = f"{RECORDINGS}/.incoming"
# What a lab asks of a drop, and how much of it a line has room for.
AT_A_GLANCE = ("peak_force", "peak_depth", "peak_deceleration", "energy_absorbed")
_SAID = 2
TAKEN_BACK = "taken back"


class Announcement(NamedTuple):
    """A line that is said, with the number of the change that it came with."""

    version: int
    text: str


class _RowOpenError(InputError):
    """Which row of the order is whose is open, or one would have two drops: a person has to look."""


class Watch:
    """A campaign that is being watched; its methods may be called from several threads.

    Attributes:
        drops: what was taken.
        study: what the drops together tell.
        lines: the last ones that were said.
        last: the drop or file that was judged last, and how.
        nouns: the campaign's own for people, conditions and impacts, in what is said.
    """

    def __init__(
        self,
        recordings: Path,
        campaign: WatchedCampaign,
        drops: Drops,
        order: Order,
        say: Callable[[str], None],
    ) -> None:
        self.recordings, self.campaign, self.drops, self.order = recordings, campaign, drops, order
        self.study, self.nouns = GrowingStudy(campaign), Words(campaign.settings.words.values())
        self.lines: deque[Announcement] = deque(maxlen=_LINES)
        self.last = ("", DropVerdict("look", "no drop yet"))
        self._say, self._lock = say, threading.RLock()
        self._follower = Follower({drop.file: drop.stamp for drop in drops})
        self._impacts: OrderedDict[tuple[str, str], Impact] = OrderedDict()
        # What can't be done for the moment, what is said of that, and why files wait; each is said once.
        self._trouble: OSError | None = None
        self._waiting: InputError | None = None
        self._said: set[str] = set()
        # Of recordings that lost their place in the list to another, why they were left out.
        self._decided: dict[str, str] = {}
        # Files that were judged and are others now: each holds its row until it is judged anew.
        self._changed: set[str] = set()
        order.require_same(drops.order, drops.rows)
        for drop in [drop for drop in drops if order.rows and drop.file not in drops.rows]:
            # Where the list was lost: each has the first row that is open after those before it.
            left = self._left([earlier for earlier in drops if earlier.file in drops.rows])
            at = next((at for at, row in left.items() if row.items() <= drop.cells.items()), None)
            drops.rows |= {} if at is None else {drop.file: at}
        drops.order = list(order.rows) or drops.order
        self._incoming = drops.folder / _INCOMING
        require_left_over(self._incoming)
        discard(self._incoming)
        if self.drops.chosen:
            self.drops.notes.append(f"set on the page: {facts_words(dict(self.drops.chosen))}")

    def warm_up(self) -> None:
        """Compile what drops will need."""
        self.study.site(self._example())
        self.study.update(self.drops.used, wait=True)

    def _example(self) -> Impact:
        """The last drop, or one of the dataset that is like, or one that is made up."""
        if self.drops.drops:
            with suppress(InputError):
                return self.impact(self.drops.drops[-1].impact)
        if self.campaign.like is not None:
            data = read_dataset(self.campaign.like, skip_bad=True)
            return impact_of(data.select(slice(1)))
        time = np.arange(400) / 1e4 - 0.005
        value = np.where(time > 0, 100 * np.sin(80 * time) * np.exp(-10 * time), 0.0)
        noise = np.random.default_rng(0).normal(0, 0.3, len(time))
        return one_impact(time, np.maximum(value, 0) + noise, mass_kg=1.0, velocity_m_s=1.5)

    def catch_up(self, poll_s: float) -> None:
        """Look until nothing is new twice over.

        Raises:
            OSError: files can't be read, or the dataset can't be written, however often that is tried.
            InputError: files are left that can't be taken before a person has said more.
        """
        quiet = tries = 0
        while quiet < 2 and tries < _TRIES:
            new = self.look()
            tries = tries + 1 if self._trouble else 0
            quiet = 0 if new or self._trouble else quiet + 1
            sleep(poll_s)
        if self._trouble:
            raise self._trouble
        if self._waiting:
            raise self._waiting

    def look(self) -> bool:
        """Look at the folder once, and take what is whole; whether anything was taken or refused."""
        try:
            new = self._look()
        except OSError as error:
            self._trouble = error
            self._once(f"{error.filename or self.drops.folder}: {error.strerror}; trying again")
            return False
        self._trouble = None
        if not self._waiting:
            self._said.clear()
        return new

    def _once(self, text: str) -> None:
        """Say what holds for a while, once."""
        if text not in self._said:
            self.say(text)
        self._said.add(text)

    def _look(self) -> bool:
        self._waiting = None
        with self._lock:
            self._take_corrections()
        listed = listing(self.recordings, self.campaign.suffixes)
        if self.campaign.order_file is not None:
            with suppress(ValueError):
                order = self.campaign.order_file.resolve().relative_to(self.recordings.resolve())
                listed.pop(order.as_posix(), None)
        for name in filter(_NO_TEXT.search, listed):
            if self._follower.settled.get(name) != listed[name]:
                self._follower.settled[name] = listed[name]
                said = printable(name)
                self._refuse(said, InputError.stated("no-campaign.name", said, value=said))
        ready, empty, gone = self._follower.changes(listed)
        for name in empty:
            self.say(f"{name}: empty so far")
        for name in gone:
            if self.drops.of_file(name):
                self.say(f"{name}: deleted from the recorder's folder; the dataset keeps it")
        trouble = None
        try:
            with self._lock:
                self._give_rows(listed)
            for name in ready:
                try:
                    with self._lock:
                        self._take(name, listed[name])
                except OSError as error:
                    trouble = error
        except _RowOpenError as error:
            self._waiting, ready = error, ()
            (problem,) = error.problems
            self.last = str(problem.file), DropVerdict("look", _in_short(problem))
            self._once(f"{problem.file}: look: {_in_short(problem)}")
        if trouble:
            raise trouble
        return bool(ready)

    def _take_corrections(self) -> None:
        """Take what a person wrote into the dataset, and judge drops anew whose facts were corrected."""
        try:
            self.drops.by_hand()
        except InputError as error:
            self._waiting = error
            self._once(f"{error.problems[0]} Its tables wait for that")
        notes, self.drops.notes = self.drops.notes, []
        corrected, self.drops.corrected = self.drops.corrected, []
        for note in notes:
            self.say(note)
        for drop in corrected:
            try:
                impact = impact_of(dataset_of(self.drops.folder, self.campaign, drop.cells))
            except InputError as error:
                self.say(f"{drop.impact}: {self.nouns(_in_short(error.problems[0]))}")
                continue
            fresh = self._judged(drop.file, drop.cells, impact, drop.sha256)
            self.drops.version += 1
            keeps = drop.decided or not drop.taken or drop.left_out == UNREADABLE
            judged = replace(
                fresh,
                stamp=drop.stamp,
                taken=drop.taken or fresh.taken,
                further=drop.further,
                changed=self.drops.version,
                left_out=drop.left_out if keeps else fresh.left_out,
            )
            self.drops.drops = [judged if earlier is drop else earlier for earlier in self.drops]
            self._impacts[drop.impact, drop.sha256] = impact
            self.say(self.line(judged))
        if corrected or notes:
            self.study.update(self.drops.used)
        if self.drops.pending and not self._waiting:
            self.drops.write()

    def _give_rows(self, listed: Mapping[str, Stamp]) -> None:
        """Give files that nobody has judged their rows of the order.

        Raises:
            _RowOpenError: which row is whose is open. Verdicts wait too: they would open rows that new files
                then seem to have.
        """
        if not self.order.rows:
            return
        drops = self.drops
        new, reused = self._unseen(listed)
        known = {*listed, *self._judged_files()}
        gone = {name: at for name, at in drops.rows.items() if name not in known}
        for name in drops.rows.keys() - {*listed, *(drop.file for drop in drops)}:
            del drops.rows[name]
        try:
            self._require_distinct_rows()
            for name, now in reused.items():
                raise _row_held(name, f"the name that {now} had")
            row_of = self._rows_in_order(new, gone, listed)
        except _RowOpenError:
            drops.rows.update(gone)
            raise
        first = row_of.keys() - drops.rows.keys()
        self._changed |= row_of.keys() - first
        if first:
            drops.rows.update(row_of)
            drops.write()

    def _judged_files(self) -> set[str]:
        """The files of which what they hold now was taken or refused."""
        return {*self.drops.refused, *(drop.file for drop in self.drops)} - self._changed

    def _rows_in_order(
        self, new: Sequence[str], gone: Mapping[str, int], listed: Mapping[str, Stamp]
    ) -> dict[str, int]:
        """The rows that files take in the order of their recording.

        Raises:
            _RowOpenError: something leaves that open.
        """
        rows, unclear = self.drops.rows, partial(_RowOpenError.stated, file=str(self.recordings))
        by_name = sorted(new, key=natural)
        by_time = sorted(by_name, key=lambda name: listed[name].modified_ns)
        in_order = by_name if self.campaign.files_by == "names" else by_time
        row_of, facts = self._rows_of(in_order)
        first = {name: at for name, at in row_of.items() if name not in rows}
        # One that is gone may have got a new name, by which a row can be its own.
        named = {name: self.campaign.named(name) for name in first}
        all_rows = self.order.named(self._people())
        lost = [
            at
            for at in sorted(gone.values())
            if any(self.order.row_for(name, {at: all_rows[at]}, cells) == at for name, cells in named.items())
        ]
        if [*first.values()][: len(lost)] != lost:
            raise unclear("no-campaign.gone", value=_in_a_row([*first]), names=_in_a_row([*gone]))
        # A name that is unlike all others, but for its numbers, may be no drop's.
        shapes = Counter(_shape(name) for name in new)
        alone = [name for name in by_name if shapes[_shape(name)] == 1 < max(shapes.values())]
        if facts != self._rows_of(sorted(in_order, key=lambda name: name in alone))[1]:
            raise unclear("no-campaign.alone", value=_in_a_row(alone))
        if self.campaign.files_by is None and facts != self._rows_of(by_name)[1]:
            raise unclear("no-campaign.sequence", value=_in_a_row(by_time), names=_in_a_row(by_name))
        if len(new) > 1 and any(lacking for lacking, _ in facts.values()) and row_of:
            raise unclear("no-campaign.more-files", value=_in_a_row(by_time))
        for name in [name for name in new if name in rows and name not in row_of]:
            others = [file for file, at in rows.items() if at == rows[name] and file != name]
            raise _row_held(name, f"the row of {_in_a_row(others)}")
        # A file that comes behind another with an earlier row, though neither time nor name says so.
        for name, at in first.items() if not any(self.order.files) else ():
            for drop in self.drops:
                earlier = natural(name) < natural(drop.file)
                earlier &= listed[name].modified_ns <= drop.stamp.modified_ns
                before = rows.get(drop.file, at)
                if earlier and before < at and self.order.rows[before] != self.order.rows[at]:
                    raise unclear("no-campaign.late", value=f"{name} after {drop.file}")
        return row_of

    def _unseen(self, listed: Mapping[str, Stamp]) -> tuple[list[str], dict[str, str]]:
        """Files that hold a recording of their own which has no row yet: new ones, and changed ones.

        A drop in use keeps its row while its file changes. A recording that was only renamed or copied is no
        other one. Second come names that have another recording, by the names that their own got.
        """
        drops = self.drops
        of_file = {drop.file: drop for drop in drops}
        unsettled = {name for name, stamp in listed.items() if self._follower.settled.get(name) != stamp}
        self._changed &= unsettled
        judged = {*drops.refused, *of_file} - {drop.file for drop in drops if drop.good}
        new = unsettled - {*drops.rows, *of_file} | (unsettled & judged) - self._changed
        sizes = Counter([listed[name].size for name in new] + [drop.stamp.size for drop in drops])
        known = {sha256: name for name, sha256 in drops.refused.items()}
        known |= {drop.sha256: drop.file for drop in drops}
        unseen: list[str] = []
        reused: dict[str, str] = {}
        for name in sorted(new, key=lambda name: (listed[name].modified_ns, natural(name))):
            size, sha256 = listed[name].size, ""
            if name in judged or (size and (drops.refused or sizes[size] > 1)):
                sha256 = file_sha256(self.recordings / name)
            former = known.get(sha256)
            if former is None:
                unseen.append(name)
                known |= {sha256: name} if sha256 else {}
            elif former in drops.refused and former not in {*listed, *of_file}:
                drops.refused[name] = drops.refused.pop(former)
                if former in drops.rows:
                    drops.rows[name] = drops.rows.pop(former)
            elif former != name and former in unsettled & {*of_file}:
                reused |= {former: name} if file_sha256(self.recordings / former) not in known else {}
        return unseen, reused

    def _require_distinct_rows(self) -> None:
        """Refuse two drops in use that fill one row, as a person's decision may leave them.

        A drop whose facts were corrected fills none.

        Raises:
            _RowOpenError: there are two; both are named.
        """
        rows = self.order.named(self._people())
        filled: dict[int, str] = {}
        for drop in self.drops:
            at = self.drops.rows.get(drop.file)
            if at is not None and drop.good and rows[at].items() <= drop.cells.items():
                if at in filled:
                    value = f"{filled[at]} and {drop.impact}"
                    raise _RowOpenError.stated("no-campaign.row-twice", str(self.drops.folder), value=value)
                filled[at] = drop.impact

    def _require_row(self, drop: Drop) -> None:
        """Refuse a drop whose row another one in use fills.

        Raises:
            _RowOpenError: it does; both are named.
        """
        at = self.drops.rows.get(drop.file)
        for first in self.drops:
            same_row = first.file != drop.file and at is not None and self.drops.rows.get(first.file) == at
            if drop.good and first.good and same_row:
                raise _row_held(drop.file, f"the row of {first.file}")

    def _rows_of(self, names: Sequence[str]) -> tuple[dict[str, int], dict[str, tuple[bool, Any]]]:
        """The rows that files take one after the other, and whether facts of each lack, and which it has."""
        people = list(self._people())
        left = self._left()
        row_of: dict[str, int] = {}
        facts: dict[str, tuple[bool, Any]] = {}
        for name in names:
            named = self.campaign.named(name)
            if "subject" in named and str(named["subject"]) not in people:
                people.append(str(named["subject"]))
            now = self.order.named(people)
            free = {at: now[at] for at in left if at not in row_of.values()}
            kept_row = self.drops.rows.get(name)
            if kept_row is None:
                at = self.order.row_for(name, free, named, columns(self.drops.chosen, "page"))
            else:
                at = kept_row if kept_row in free else None
            if at is not None:
                row_of[name] = at
            try:
                row = {} if at is None else now[at]
                cells = self.campaign.cells(name, row, self.drops.chosen)
            except InputError:
                facts[name] = False, None
            else:
                lacking = kept_row is None and not cells.keys() >= {*required_columns()[1:]}
                facts[name] = lacking, cells
        return row_of, facts

    def _take(self, name: str, stamp: Stamp) -> None:
        source, incoming = self.recordings / name, self._incoming / name
        self._follower.settled[name] = stamp
        try:
            if not self._incoming.exists():
                self._incoming.mkdir(mode=0o700)
                mark_unfinished(self._incoming)
            incoming.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, incoming)
            sha256 = file_sha256(incoming)
            try:
                self._take_whole(name, incoming, sha256)
            except _RowOpenError:
                raise
            except InputError as error:
                self.drops.refuse(name, sha256)
                self.study.update(self.drops.used)
                self._refuse(name, error)
            self._changed.discard(name)
        except (OSError, _RowOpenError):
            # It may be there, or free, at the next look.
            del self._follower.settled[name]
            raise
        finally:
            with suppress(OSError):
                incoming.unlink(missing_ok=True)

    def _refuse(self, name: str, error: InputError) -> None:
        said = DropVerdict("again", " ".join(dict.fromkeys(map(_in_short, error.problems))))
        self.last = name, said
        self.say(f"{name}: {self.nouns(said.words)}")

    def _take_whole(self, name: str, incoming: Path, sha256: str) -> None:
        stamp, earlier = self._follower.settled[name], self.drops.of_file(name)
        same = next((drop for drop in self.drops if drop.sha256 == sha256), None)
        if earlier is not None and earlier.sha256 == sha256:
            earlier.stamp = stamp
            if earlier.left_out == UNREADABLE:
                self.drops.refused.pop(name, None)
                self.decide(earlier.impact, "")
            return
        if same is not None and _holds(self.recordings / same.file, sha256):
            self.say(f"{name}: the same recording as {same.file}; not taken twice")
            return
        if self.order.rows and (earlier is not None or self.drops.refused.get(name, sha256) != sha256):
            # What was judged under this name is not known to be gone: which row is whose, names do not say.
            judged = [(drop.file, drop.sha256) for drop in self.drops] + [*self.drops.refused.items()]
            if others := [file for file, known in judged if known == sha256 and file != name]:
                raise _row_held(name, f"the recording of {others[0]}")
        moved = same if earlier is None else None
        row = self.drops.row(name, self.cells(name, moved), moved.file if moved else "")
        destination = self.drops.folder / str(row["trace"])
        impact = impact_of(
            dataset_of(self.drops.folder, self.campaign, {**row, "trace": f"{_INCOMING}/{name}"})
        )
        drop = self._judged(name, row, impact, sha256)
        known = earlier or moved
        drop.further = known.further if known else {}
        if earlier is not None:
            self._decided[earlier.sha256] = earlier.left_out if earlier.decided else ""
        drop.left_out = (
            same.left_out if same and same.decided else self._decided.get(sha256)
        ) or drop.left_out
        if moved is None:
            self._require_row(drop)
        elif drop.good and not moved.good:
            self._require_row(replace(drop, file=moved.file))
        destination.parent.mkdir(parents=True, exist_ok=True)
        put(incoming, destination)
        self.drops.taken(drop, moved.file if moved else "")
        if moved is not None:
            self._forget(moved)
        self.last = drop.impact, drop.verdict
        self._impacts[drop.impact, sha256] = impact
        while len(self._impacts) > _TRACES:
            self._impacts.popitem(last=False)
        self.study.update(self.drops.used)
        words = f"renamed from {moved.file}: " if moved else "overwritten, taken anew: " if earlier else ""
        self.say(f"{words}{self.line(self.drops.named(drop.impact))}")
        if earlier is not None:
            self._say_other_facts(drop)

    def _forget(self, moved: Drop) -> None:
        """The copy of a recording under the name that it had before."""
        self._follower.settled.pop(moved.file, None)
        copy = self.drops.folder / str(moved.cells["trace"])
        if copy.resolve().is_relative_to((self.drops.folder / RECORDINGS).resolve()):
            with suppress(OSError):
                copy.unlink(missing_ok=True)

    def _say_other_facts(self, drop: Drop) -> None:
        """Facts of a drop that was taken anew and keeps its row, where the page says others of next drops."""
        named = self.campaign.named(drop.file)
        for name, value in columns(self.drops.chosen, "page").items():
            if name not in named and drop.cells.get(name) != value:
                words = f"keeps {facts_words({name: drop.cells.get(name, 'nothing')})} of its row"
                self.say(f"{drop.impact}: {words}; the page says {facts_words({name: value})} of new files")

    def _another_velocity(self, impact: Impact) -> str:
        """What the last recordings of its condition say together of this one's velocity; empty if nothing."""
        (here,), (trial,) = (impact.dataset.impacts[name] for name in ("impact", "trial"))
        names = {drop.impact for drop in self.drops.used} - {here}
        others = [known.dataset for (name, _), known in self._impacts.items() if name in names]
        together = [data for data in others if data.impacts["trial"].item() == trial][-_TOGETHER:]
        together.append(impact.dataset)
        joined = replace(
            impact.dataset,
            impacts=pd.concat([data.impacts for data in together], ignore_index=True),
            traces=Traces.of([trace for data in together for trace in data.traces]),
        )
        said = inspect(joined).get("velocity-contradicted", [""])[-1]
        return f"{Coded.stated('velocity-contradicted')}: {said}" if said else ""

    def _judged(self, name: str, row: Cells, impact: Impact, sha256: str) -> Drop:
        flags = [*impact.flags, *(w.code for w in impact.dataset.warnings if w.impact)]
        if another := self._another_velocity(impact):
            flags.append(another)
        if (count := several(impact.dataset)) > 1:
            flags.insert(0, Coded.stated("several-impacts", count=count))
        wanted = self.campaign.wanted
        site = self.study.site(impact)
        velocity = float(row.get("velocity_m_s", np.nan)), wanted.velocity_m_s, wanted.velocity_within
        others = [drop for drop in self.drops.used if drop.file != name and drop.sha256 != sha256]
        said = verdict(flags, velocity=velocity, unlike=self.study.unlike(row, site, others))
        return Drop(
            file=name,
            stamp=self._follower.settled.get(name, Stamp(0, 0)),
            sha256=sha256,
            cells=row,
            **said._asdict(),
            left_out=said.reason if said.spoilt else "",
            **numbers_of(impact.row),
            **site,
            taken=f"{datetime.now().astimezone():%Y-%m-%d %H:%M:%S}",
        )

    def cells(self, name: str, moved: Drop | None = None) -> Cells:
        """The facts of a file: those of its row of the dataset, else by its name, page, order and campaign.

        Args:
            name: of the file.
            moved: the drop of its recording, which had another name; what that said does not hold any more.
        """
        if known := self.drops.of_file(name):
            return known.cells
        if moved is not None:
            said = self.campaign.named(moved.file)
            cells = {k: v for k, v in moved.cells.items() if k not in said and k not in ("impact", "trace")}
            return cells | columns(self.campaign.read(name), name)
        at = self.drops.rows.get(name)
        people = self._people()
        if "subject" in (named := self.campaign.named(name)):
            people[str(named["subject"])] = None
        following = {} if at is None else self.order.named(people).get(at, {})
        return self.campaign.cells(name, following, self.drops.chosen)

    def left(self) -> list[Cells]:
        """The drops that the order or the plan still has."""
        return list(self._left().values())

    def _left(self, drops: Sequence[Drop] | None = None) -> dict[int, Cells]:
        """The rows that are open, as these drops leave them; all drops unless given."""
        rows = self.drops.rows
        # A plan is of people alone; an order may have rows of phantoms too.
        named = self.order.people_named
        known = self.drops if drops is None else drops
        good = [drop for drop in known if drop.good and (named or not drop.of_phantom)]
        held = [rows[drop.file] for drop in good if drop.file in rows]
        # Of files that nobody has judged yet, since they are empty, still grow, or wait for their turn.
        judged = self._judged_files()
        held += [at for name, at in rows.items() if name not in judged]
        unknown = [drop.cells for drop in good if drop.file not in rows]
        return self.order.left(unknown, held, self._people())

    def _people(self) -> dict[str, None]:
        """Who was hit, in this order."""
        return dict.fromkeys(str(drop.cells["subject"]) for drop in self.drops if not drop.of_phantom)

    def take_back(self) -> Drop | None:
        """Leave the last drop out that is in use; None where there is none."""
        with self._lock:
            used = self.drops.used
            return self.decide(used[-1].impact, TAKEN_BACK) if used else None

    def decide(self, impact: str, reason: str) -> Drop:
        """Leave a drop out, or use it again where the reason is empty.

        Raises:
            KeyError: there is no such drop.
            InputError: another drop has filled its row of the order since.
        """
        with self._lock:
            # What was written by hand meanwhile came first.
            self._take_corrections()
            if not reason:
                self._require_row(replace(self.drops.named(impact), left_out=""))
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
            self.drops.choose(chosen)

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
        """A drop in one line: its verdict, K, C, force and depth by itself, K in the study, what is left."""
        words = [f"{drop.impact}: {self.nouns(drop.verdict.words)}"]
        words += [f"{q} {_interval(getattr(drop, q))} {unit}" for q, unit in UNITS.items()]
        words += [f"{name} {_interval(drop.outcomes[name])}" for name in [*drop.outcomes][:_SAID]]
        words += map(self.nouns, self.study.words(drop))
        if self.order.rows:
            left = self.left()
            words.append(f"{len(left)} drops left{f', next {facts_words(left[0])}' if left else ''}")
        return "; ".join(words)

    def say(self, text: str) -> None:
        """Say a line on the terminal and on pages."""
        self.drops.version += 1
        self.lines.append(Announcement(self.drops.version, text))
        self._say(text)


def _row_held(file: str, value: str) -> _RowOpenError:
    """A file would have what is another's."""
    return _RowOpenError.stated("no-campaign.row-held", file, value=value)


def numbers_of(row: pd.Series) -> dict[str, Any]:
    """K, C and ``outcomes`` of a row of `estimates.csv`, these by their names with units.

    Of each the median and the ends of its interval, None where there is no number.
    """
    names = {q: (column, end(q, "low"), end(q, "high")) for q, column in COLUMNS.items()}
    numbers: dict[str, Any] = {q: [_number(row[name]) for name in columns] for q, columns in names.items()}
    came_to, numbers["outcomes"] = outcomes_in(row), {}
    for name in AT_A_GLANCE:
        words, unit, factor = PREDICTED[QUANTITIES[name]]
        values = factor * came_to.loc[name, ["median", "low", "high"]]
        numbers["outcomes"][f"{words} ({unit})"] = [_number(value) for value in values]
    return numbers


def facts_words(cells: Cells) -> str:
    """The facts of a drop in words."""
    return ", ".join(f"{name} {v:g}" if isinstance(v, float) else f"{name} {v}" for name, v in cells.items())


def _in_short(problem: Problem) -> str:
    """What is wrong with a file that can't be used, whose name is said anyway."""
    return printable(f"found {problem.value}; expected {problem.expected}. {problem.remedy}")


def _in_a_row(names: Sequence[str]) -> str:
    """Names one after the other, cut short where there are many."""
    return ", ".join([*names[:6], *(["…"] if len(names) > 6 else [])])


def _shape(name: str) -> str:
    """A name but for its numbers."""
    return re.sub(r"\d+", "0", name)


def _holds(path: Path, sha256: str) -> bool:
    """Whether a file is there with these bytes."""
    return path.exists() and file_sha256(path) == sha256


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _interval(numbers: list[float | None]) -> str:
    known = (math.nan if value is None else value for value in numbers)
    middle, low, high = (None if text == "nan" else text for text in estimated(*known))
    return f"{middle or 'no number'} ({low} to {high})" if low and high else middle or "no number"
