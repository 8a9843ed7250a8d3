"""The drops of a campaign and the dataset that they make: what was taken is listed after it was taken.

`watch.json` in the dataset's folder lists the drops. It is written, whole, once a recording lies in the
folder; the tables follow from it. A watch that is killed between any two of these steps therefore finds, when
it begins again, either a recorder's file that it has not taken, or a drop whose row it writes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath

import pandas as pd

from bayestissue.bench.campaign import Campaign
from bayestissue.bench.following import Stamp
from bayestissue.bench.verdict import Kind
from bayestissue.dataset import Dataset
from bayestissue.dataset.arrays import plain_text
from bayestissue.dataset.cells import FILE as IMPACTS
from bayestissue.dataset.cells import cells_of
from bayestissue.dataset.impacts import impact_table, wanted
from bayestissue.dataset.left_out import reasons, write_left_out
from bayestissue.dataset.read import checked_dataset
from bayestissue.dataset.recorders import suffix_of
from bayestissue.dataset.settings import FILE as SETTINGS
from bayestissue.dataset.traces import read_files
from bayestissue.dataset.write import settings_text
from bayestissue.errors import InputError
from bayestissue.intake.build import FIRST, RECORDINGS, cut
from bayestissue.intake.facts import Cells
from bayestissue.results import whole_file

LIST = "watch.json"


@dataclass
class Drop:
    """One drop that was taken.

    Attributes:
        file: the recorder's, by its path relative to the folder that is followed.
        stamp: of that file as it was taken.
        sha256: of its bytes.
        cells: its row of `impacts.csv`.
        kind, reason, code: of its verdict.
        left_out: why it is left out of the dataset; empty where it is not.
        K, C: median and the ends of the 90 % interval, by itself; None where there is no number.
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
    centre: list[float] | None = None
    precision: list[list[float]] | None = None
    taken: str = ""
    changed: int = 0

    @property
    def impact(self) -> str:
        """Its name."""
        return str(self.cells["impact"])


class Drops:
    """The drops of a campaign in its dataset's folder.

    Attributes:
        folder: of the dataset.
        all: the drops, in the order in which they were taken.
        version: counts changes of any kind.
    """

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        """Go on from what an earlier watch took.

        Raises:
            InputError: the folder holds something else, or was written with other settings.
        """
        self.folder, self.campaign, self.version = folder, campaign, 0
        self.all: list[Drop] = []
        if folder.exists() and any(folder.iterdir()):
            if not (folder / LIST).exists():
                raise InputError.stated("no-campaign.taken", str(folder), value="a folder with other files")
            content = json.loads((folder / LIST).read_text(encoding="utf-8"))
            if content["settings"] != settings_text(campaign.content):
                raise InputError.stated(
                    "no-campaign.taken", str(folder), value="other settings in dataset.toml"
                )
            self.all = [Drop(**{**drop, "stamp": Stamp(*drop["stamp"])}) for drop in content["drops"]]
            self._as_decided()
        (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
        self._write()

    def _as_decided(self) -> None:
        """What was left out or accepted meanwhile; of a drop whose row was not written yet, its verdict."""
        try:
            rows = set(pd.read_csv(self.folder / IMPACTS, dtype=str, keep_default_na=False)["impact"])
        except (OSError, ValueError, KeyError):
            return
        by_hand = reasons(self.folder)
        for drop in self.all:
            if drop.impact in rows:
                drop.left_out = by_hand.get(drop.impact, "")

    def __iter__(self) -> Iterator[Drop]:
        return iter(self.all)

    @property
    def used(self) -> list[Drop]:
        """Those that are not left out."""
        return [drop for drop in self.all if not drop.left_out]

    def named(self, impact: str) -> Drop:
        """The drop of this name.

        Raises:
            KeyError: there is none.
        """
        for drop in self.all:
            if drop.impact == impact:
                return drop
        raise KeyError(impact)

    def of_file(self, file: str) -> Drop | None:
        """The drop that was taken from a recorder's file."""
        return next((drop for drop in self.all if drop.file == file), None)

    def row(self, file: str, cells: Cells) -> Cells:
        """The row of `impacts.csv` of a recording: its shortest name that no other has, and its place."""
        path = PurePosixPath(file)
        bare = file[: -len(suffix_of(Path(file)))]
        others = {drop.impact for drop in self.all if drop.file != file}
        name = next(name for name in (cells.get("impact"), PurePosixPath(bare).name, bare, file) if name)
        if name in others:
            name = next((longer for longer in (bare, file) if longer not in others), file)
        return {
            "impact": name,
            "trace": f"{RECORDINGS}/{path}",
            **{k: v for k, v in cells.items() if k != "impact"},
        }

    def taken(self, drop: Drop) -> None:
        """List a drop whose recording lies in the folder, in the place of an earlier one of the same file."""
        self.version += 1
        drop.changed = self.version
        earlier = self.of_file(drop.file)
        self.all = [drop if known is earlier else known for known in self.all] + [drop] * (earlier is None)
        self._write()

    def decide(self, impact: str, reason: str) -> Drop:
        """Leave a drop out for this reason, or use it again where the reason is empty.

        Raises:
            KeyError: there is no such drop.
        """
        drop = self.named(impact)
        self.version += 1
        drop.left_out, drop.changed = reason, self.version
        self._write()
        return drop

    def _write(self) -> None:
        settings = settings_text(self.campaign.content)
        content = {"settings": settings, "drops": [asdict(drop) for drop in self.all]}
        with whole_file(self.folder / LIST) as staging:
            staging.write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
        if not (self.folder / SETTINGS).exists():
            with whole_file(self.folder / SETTINGS) as staging:
                staging.write_text(settings, encoding="utf-8")
        if not self.used and not (self.folder / IMPACTS).exists():
            # Without an impact there is no dataset.
            return
        table = pd.DataFrame([drop.cells for drop in self.all])
        order = dict.fromkeys([*(name for name in FIRST if name in table), *table.columns])
        # In this order, so that what is left out is never in use for a moment.
        write_left_out(self.folder, {drop.impact: drop.left_out for drop in self.all if drop.left_out})
        with whole_file(self.folder / IMPACTS) as staging:
            table[list(order)].to_csv(staging, index=False, lineterminator="\n")


def dataset_of(folder: Path, campaign: Campaign, row: Cells) -> Dataset:
    """One drop as a dataset, by every check that a folder of it gets.

    Raises:
        InputError: what is wrong with its row or its recording.
    """
    settings = campaign.settings
    body = [[plain_text(value) for value in row.values()]]
    cells, rows = cells_of(list(row), body, [2], wanted(needs_velocity=True))
    table = impact_table(cells, rows, needs_velocity=True)
    reading = read_files(folder, table.table, table.row, settings.signal)
    reading.problems[:0] = table.problems
    return checked_dataset(settings, table, reading, skip_bad=False, folder=folder, input_hash="")


def several(data: Dataset) -> int:
    """How many impacts the recording of a dataset of one seems to hold."""
    (trace,) = data.traces
    sign = -1.0 if data.quantity == "acceleration" else 1.0
    return len(cut(type(trace)(trace.time_s, sign * trace.value)))
