"""The drops of a campaign and the dataset that they make: what was taken is listed after it was taken.

The dataset's tables are the state: what a person writes into `impacts.csv` or `left_out.csv` holds from then
on. `watch.json` beside them keeps what can't stand there: the verdict on each drop, the row of the order that
each recorder's file took, what was set on the page, and digests of the tables as they were last written, by
which a person's hand is told from that of the program. It is written, whole, once a recording lies in the
folder; the tables follow. A watch that is killed between any two of these steps therefore finds, when it
begins again, either a recorder's file that it has not taken, or a drop whose row it writes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import pandas as pd
from pydantic import TypeAdapter, ValidationError

from bayestissue.base.errors import InputError, Problem, refuse
from bayestissue.base.results.files import whole_file
from bayestissue.base.results.tables import csv_text
from bayestissue.base.settings import parse_toml, read_text
from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.dataset.cells import FILE as IMPACTS
from bayestissue.recordings.dataset.cells import Records, read_cells
from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
from bayestissue.recordings.dataset.impact_table import REFERENCE, RESERVED, impact_table, required_columns
from bayestissue.recordings.dataset.left_out import FILE as LEFT_OUT
from bayestissue.recordings.dataset.left_out import left_out_text, reasons, write_left_out
from bayestissue.recordings.dataset.read import checked_dataset
from bayestissue.recordings.dataset.recorders import read_files
from bayestissue.recordings.dataset.source_files import Source, plain_text, suffix_of
from bayestissue.recordings.dataset.write import settings_text
from bayestissue.recordings.intake.build import FIRST, RECORDINGS, cut
from bayestissue.recordings.intake.facts import Cells
from bayestissue.recordings.intake.names import NUMBERS
from bayestissue.studies.bench.campaign_file import WatchedCampaign
from bayestissue.studies.bench.following import Stamp
from bayestissue.studies.bench.verdict import DropVerdict, Kind

LIST = "watch.json"
BY_HAND = "its row was taken out of impacts.csv"
UNREADABLE = "its file was overwritten by a recording that can't be used"
# Of a dataset, what may be said of it without another campaign being meant.
_DESCRIPTION = ("description", "licence", "source")


@dataclass
class Drop:
    """One drop that was taken.

    Attributes:
        file: the recorder's, by its path relative to the folder that is followed.
        stamp: of that file as it was taken.
        sha256: of its bytes.
        cells: its row of `impacts.csv`, the facts that the program knows of.
        further: what a person added to the row, in columns of their own.
        kind, reason, code: of its verdict.
        left_out: why it is left out of the dataset; empty where it is not.
        K, C: median and the ends of the 90 % interval, by itself; None where there is no number.
        outcomes: the same of what it came to, by names with units.
        centre, precision: of its Gaussian site, of log K and log C; None where it tells nothing.
        taken: when, as text.
        changed: of the list's changes, the last one that concerned this drop.
    """

    file: str
    stamp: Stamp
    sha256: str
    cells: Cells
    kind: Kind
    reason: str = ""
    code: str = ""
    left_out: str = ""
    K: list[float | None] = field(default_factory=list)
    C: list[float | None] = field(default_factory=list)
    outcomes: dict[str, list[float | None]] = field(default_factory=dict)
    centre: list[float] | None = None
    precision: list[list[float]] | None = None
    taken: str = ""
    changed: int = 0
    further: dict[str, str] = field(default_factory=dict)

    @property
    def impact(self) -> str:
        """Its name."""
        return str(self.cells["impact"])

    @property
    def good(self) -> bool:
        """Whether it is in use and need not be repeated, so that it fills a row of the order."""
        return not self.left_out and self.kind != "again"

    @property
    def of_phantom(self) -> bool:
        """Whether a spring or phantom of known stiffness was hit, and no person."""
        return bool({**self.further, **self.cells}.get(REFERENCE[0]))

    @property
    def decided(self) -> bool:
        """Whether a person, not the verdict, left it out or uses it."""
        return self.left_out not in (UNREADABLE, self.reason if self.verdict.spoilt else "")

    @property
    def verdict(self) -> DropVerdict:
        """What to do about it."""
        return DropVerdict(self.kind, self.reason, self.code)


@dataclass(eq=False)
class DropList:
    """What `watch.json` holds.

    Attributes:
        drops: in the order in which they were taken.
        rows: of each recorder's file that was judged, by its name, the number of its row of the order.
        order: the rows of the order as they were when the list was last written.
        chosen: facts of the next drops, as they were set on the page.
        tables: the digests that each table has where no person wrote it: before the program did, and after.
        refused: of files that were no drop as they were, the SHA-256 that they then had.
        others: the rows of `impacts.csv` that a person wrote and that belong to no drop.
        strange: those of `left_out.csv`.
    """

    drops: list[Drop]
    rows: dict[str, int] = field(default_factory=dict)
    order: list[Cells] = field(default_factory=list)
    chosen: dict[str, str] = field(default_factory=dict)
    tables: dict[str, tuple[str, str]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    others: list[Cells] = field(default_factory=list)
    strange: dict[str, str] = field(default_factory=dict)


class Drops(DropList):
    """The drops of a campaign in its dataset's folder, with the list of them.

    Attributes:
        folder: of the dataset.
        version: counts changes of any kind.
        notes: what is to be said of the tables as they were found.
        pending: whether a table lacks what the list has.
        corrected: drops whose facts a person changed, and which are to be judged anew.
    """

    def __init__(self, folder: Path, campaign: WatchedCampaign) -> None:
        """Go on from what an earlier watch took.

        Raises:
            InputError: the folder holds something else, was written with other settings, or a table in it
                can't be used.
        """
        super().__init__([])
        self.folder, self.campaign, self.version = folder, campaign, 0
        self.notes: list[str] = []
        self.pending = False
        self.corrected: list[Drop] = []
        if folder.exists() and any(folder.iterdir()):
            if not (folder / LIST).exists():
                raise InputError.stated("no-campaign.taken", str(folder), value="a folder with other files")
            self._require_settings()
            self._remember()
            self.by_hand()
        (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
        self.write()

    def _require_settings(self) -> None:
        """Refuse a dataset.toml that says something else than the campaign."""
        path = self.folder / SETTINGS
        if not path.exists():
            return
        ours = _flat(parse_toml(settings_text(self.campaign.content), str(path)))
        theirs = _flat(parse_toml(read_text(path, str(path)), str(path)))
        pairs = {key: (ours.get(key, "nothing"), theirs.get(key, "nothing")) for key in {**ours, **theirs}}
        refuse(
            Problem.stated("no-campaign.differs", str(path), None, key, actual, other=expected)
            for key, (expected, actual) in pairs.items()
            if expected != actual and key not in _DESCRIPTION
        )

    def _remember(self) -> None:
        """Read the list; where it is damaged, make it anew from the tables."""
        try:
            known = TypeAdapter(DropList).validate_json((self.folder / LIST).read_bytes())
            names = [drop.impact for drop in known.drops]
        except (ValidationError, KeyError, RecursionError):
            self.notes.append(f"{LIST} was damaged; it is made anew from {IMPACTS} and {LEFT_OUT}")
            if (self.folder / IMPACTS).exists():
                self.drops = [self._recovered(row) for row in self._table() if _file_of(row)]
            self.corrected = list(self.drops)
            return
        if len(set(names)) < len(names):
            raise InputError.stated("no-campaign.taken", str(self.folder / LIST), value="a drop twice")
        vars(self).update(vars(known))

    def _recovered(self, row: Cells) -> Drop:
        recording = self.folder / str(row["trace"])
        sha256 = _digest(recording)
        cells, further = self._parted(row, {})
        return Drop(_file_of(row), Stamp(0, 0), sha256, cells, "look", "", further=further)

    def by_hand(self) -> None:
        """Take what a person wrote into the tables since they were last written or read.

        Drops whose facts changed are added to ``corrected``.

        Raises:
            InputError: a table can't be used; it stays as it is, and the drops as they were.
        """
        digests = {name: _digest(self.folder / name) for name in (IMPACTS, LEFT_OUT)}
        changed = [name for name, digest in digests.items() if digest not in self._known(name)]
        if not changed:
            return
        table = self._table() if IMPACTS in changed and digests[IMPACTS] else None
        stated = reasons(self.folder)
        # Each drop that has a row, with its name before.
        named = [(drop.impact, drop) for drop in self.drops]
        if table is not None:
            rows = self._rows_of(table)
            for name, drop in named:
                self._correct(drop, rows.get(name))
            named = [(name, drop) for name, drop in named if name in rows]
        if LEFT_OUT in changed or any(drop.impact != name for name, drop in named):
            for name, drop in named:
                reason = stated.get(drop.impact) or stated.get(name, "")
                if reason != drop.left_out:
                    words = f"left out: {reason}" if reason else "used again"
                    self._note(drop, f"{drop.impact}: {words}, as {LEFT_OUT} says")
                    drop.left_out = reason
            known = {*(drop.impact for drop in self.drops), *(name for name, _ in named)}
            others = {*self.strange, *(str(row["impact"]) for row in self.others)}
            self.strange = {name: reason for name, reason in stated.items() if name not in known}
            new = [name for name in self.strange if name not in others]
            self.notes += [f"{LEFT_OUT}: {name} is no impact; its row stays" for name in new]
        self.tables |= {name: (digests[name], digests[name]) for name in changed}
        self.pending = True

    def _known(self, name: str) -> tuple[str, str]:
        """The digests that a table has where no person wrote it."""
        return self.tables.get(name, ("", ""))

    def _table(self) -> list[Cells]:
        """The rows of `impacts.csv`, as text."""
        cells, rows = read_cells(Source(self.folder / IMPACTS, IMPACTS), required_columns())
        refuse(impact_table(cells, rows, needs_velocity=True).problems)
        return [{str(k): v for k, v in row.items() if v} for row in cells.to_dict("records")]

    def _parted(self, row: Cells, known: Cells) -> tuple[Cells, dict[str, str]]:
        """The facts of a row that the program knows of, and what a person added."""
        ours = {k: v for k, v in row.items() if k in NUMBERS or k in RESERVED or k in known}
        cells: Cells = {k: float(v) if k in NUMBERS else v for k, v in ours.items()}
        return cells, {k: str(v) for k, v in row.items() if k not in ours}

    def _rows_of(self, table: list[Cells]) -> dict[str, Cells]:
        """The rows of drops, by the names of these: the row of that name, else that of its recording.

        Those of no drop are ``others`` from now on.
        """
        of_trace = {str(drop.cells["trace"]): drop.impact for drop in self.drops}
        names = {drop.impact for drop in self.drops}
        rows = {name: row for row in table if (name := str(row["impact"])) in names}
        self.others = []
        for row in table:
            if str(row["impact"]) in names:
                continue
            name = of_trace.get(str(row.get("trace", "")), "")
            if not name or name in rows:
                self.others.append(row)
            else:
                rows[name] = row
        return rows

    def _correct(self, drop: Drop, row: Cells | None) -> None:
        """Take the row of a drop as a person left it; a drop without any is left out."""
        name, before = drop.impact, drop.cells
        if row is None:
            drop.left_out = drop.left_out or BY_HAND
            self._note(drop, f"{name}: left out: {BY_HAND}")
            return
        drop.cells, drop.further = self._parted(row, before)
        changes = [
            f"{k} {now or 'nothing'} ({was or 'nothing'} before)"
            for k in {**before, **drop.cells}
            if (now := plain_text(drop.cells.get(k))) != (was := plain_text(before.get(k)))
        ]
        if changes:
            self._note(drop, f"{name}: {IMPACTS} says {', '.join(changes)}")
            self.corrected.append(drop)

    def _note(self, drop: Drop, words: str) -> None:
        self.version += 1
        drop.changed = self.version
        self.notes.append(words)

    def __iter__(self) -> Iterator[Drop]:
        return iter(self.drops)

    @property
    def used(self) -> list[Drop]:
        """Those that are not left out."""
        return [drop for drop in self.drops if not drop.left_out]

    def named(self, impact: str) -> Drop:
        """The drop of this name.

        Raises:
            KeyError: there is none.
        """
        return {drop.impact: drop for drop in self.drops}[impact]

    def of_file(self, file: str) -> Drop | None:
        """The drop that was taken from a recorder's file."""
        return next((drop for drop in self.drops if drop.file == file), None)

    def row(self, file: str, cells: Cells, earlier: str = "") -> Cells:
        """The row of `impacts.csv` of a recording: its shortest name that no other has, and its place.

        Args:
            file: the recorder's.
            cells: the facts.
            earlier: the name that the file had before.
        """
        bare = file[: -len(suffix_of(Path(file)))]
        others = {drop.impact for drop in self.drops if drop.file not in (file, earlier)}
        others |= {str(row["impact"]) for row in self.others}
        # As tables are read.
        names = [
            str(name).strip() for name in (cells.get("impact"), PurePosixPath(bare).name, bare, file) if name
        ]
        name = next(filter(None, names))
        if name in others:
            name = next((longer for longer in map(str.strip, (bare, file)) if longer not in others), file)
        return {
            "impact": name,
            "trace": f"{RECORDINGS}/{PurePosixPath(file)}",
            **{k: v for k, v in cells.items() if k not in ("impact", "trace")},
        }

    def taken(self, drop: Drop, earlier: str = "") -> None:
        """List a drop whose recording lies in the folder, in the place of an earlier one of the same file.

        Args:
            drop: it.
            earlier: the name that the file had, where it was renamed.

        Raises:
            OSError: the list can't be written; it then is as it was.
        """
        before = self.drops, self.rows, self.refused
        drop.changed = self.version = self.version + 1
        known = self.of_file(earlier or drop.file)
        self.drops = [drop if listed is known else listed for listed in self.drops] + [drop] * (known is None)
        self.refused = {name: sha256 for name, sha256 in self.refused.items() if name != drop.file}
        if earlier in self.rows:
            # A row goes with its recording.
            self.rows = {drop.file if name == earlier else name: at for name, at in self.rows.items()}

        def undo() -> None:
            self.drops, self.rows, self.refused = before

        self.write(undo)

    def refuse(self, file: str, sha256: str) -> None:
        """Keep that a file was no drop as it was; the drop that it held before is left out.

        Raises:
            OSError: that can't be written.
        """
        drop = self.of_file(file)
        if drop is not None and not drop.left_out:
            drop.left_out = UNREADABLE
            self._note(drop, f"{drop.impact}: left out: {UNREADABLE}")
        elif self.refused.get(file) == sha256:
            return
        self.refused[file] = sha256
        self.write()

    def decide(self, impact: str, reason: str) -> Drop:
        """Leave a drop out for this reason, or use it again where the reason is empty.

        Raises:
            KeyError: there is no such drop.
            OSError: that can't be written; it then is as it was.
        """
        drop = self.named(impact)
        before = drop.left_out
        drop.changed = self.version = self.version + 1
        drop.left_out = reason
        self.write(lambda: setattr(drop, "left_out", before))
        return drop

    def choose(self, facts: dict[str, str]) -> None:
        """Keep facts of the next drops.

        Raises:
            OSError: they can't be written; they then are as they were.
        """
        before, self.chosen = self.chosen, facts
        self.version += 1
        self.write(lambda: setattr(self, "chosen", before))

    def _left_out(self) -> dict[str, str]:
        """The reasons of `left_out.csv`, by the names of impacts."""
        return {drop.impact: drop.left_out for drop in self.drops if drop.left_out} | self.strange

    def _texts(self) -> dict[str, str]:
        """The tables as they should be; of `impacts.csv` nothing where there is no impact."""
        texts = {LEFT_OUT: left_out_text(self._left_out()), IMPACTS: ""}
        if self.used or (self.folder / IMPACTS).exists():
            table = pd.DataFrame([{**drop.cells, **drop.further} for drop in self.drops] + self.others)
            order = dict.fromkeys([*(name for name in FIRST if name in table), *table.columns])
            texts[IMPACTS] = csv_text(table[list(order)])
        return texts

    def write(self, undo: Callable[[], None] = lambda: None) -> None:
        """Write the list, and the tables that follow from it; ``undo`` what is new if the list can't be.

        Raises:
            OSError: one of them can't be written.
        """
        self.pending, texts = True, self._texts()
        after = {name: _digest_of(text.encode()) for name, text in texts.items()}
        tables = {}
        for name in texts:
            digest, known = _digest(self.folder / name), self._known(name)
            tables[name] = digest if digest in known else known[1], after[name]
        content = asdict(self) | {"tables": tables}
        try:
            with whole_file(self.folder / LIST) as staging:
                staging.write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
        except OSError:
            undo()
            raise
        if not (self.folder / SETTINGS).exists():
            with whole_file(self.folder / SETTINGS) as staging:
                staging.write_text(settings_text(self.campaign.content), encoding="utf-8")
        if any(_digest(self.folder / name) not in self._known(name) for name in texts):
            # Somebody wrote one meanwhile: what stands there is taken first.
            return
        # In this order, so that what is left out is never in use for a moment.
        write_left_out(self.folder, self._left_out())
        self.tables[LEFT_OUT] = after[LEFT_OUT], after[LEFT_OUT]
        if texts[IMPACTS]:
            with whole_file(self.folder / IMPACTS) as staging:
                staging.write_bytes(texts[IMPACTS].encode())
            self.tables[IMPACTS] = after[IMPACTS], after[IMPACTS]
        self.pending = False


def _file_of(row: Cells) -> str:
    """The recorder's file of a row, by the place of its copy; nothing where that is another."""
    return str(row.get("trace", "")).removeprefix(f"{RECORDINGS}/")


def _digest(path: Path) -> str:
    """Of the bytes of a file; nothing of one that is not there, as of an empty one."""
    return _digest_of(path.read_bytes()) if path.exists() else ""


def _digest_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest() if data else ""


def _flat(content: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of settings, those of tables with the table's name before them."""
    return {
        f"{name}.{key}".removesuffix("."): value
        for name, entry in content.items()
        for key, value in (entry if isinstance(entry, dict) else {"": entry}).items()
    }


def dataset_of(folder: Path, campaign: WatchedCampaign, row: Cells) -> Dataset:
    """One drop as a dataset, by every check that a folder of it gets.

    Raises:
        InputError: what is wrong with its row or its recording.
    """
    settings = campaign.settings
    body = [[plain_text(value) for value in row.values()]]
    cells, rows = Records(list(row), body, [2]).cells(required_columns())
    table = impact_table(cells, rows, needs_velocity=True)
    return replace(checked_dataset(table, [read_files(folder, table, settings)]), folder=folder)


def several(data: Dataset) -> int:
    """How many impacts the recording of a dataset of one seems to hold."""
    (trace,) = data.traces.slowing(data.quantity)
    return len(cut(trace))
