"""Random sequences of what happens at a bench: each used drop has the mass that it fell with, or is refused.

An operator drops by an order: the next drop is of the first row that no good drop has filled, as far as was
said. A recording holds which drop it is of, so that the mass of every row of `impacts.csv` can be held to the
truth, by the bytes of its copy.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from written_drops import TOWER, NoStudy, no_numbers

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.left_out import reasons
from bayestissue.studies.bench import watching
from bayestissue.studies.bench.campaign_file import read_campaign
from bayestissue.studies.bench.drops import LIST, Drops
from bayestissue.studies.bench.order import order_of
from bayestissue.studies.bench.watching import Watch

ORDERS = (
    [0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4],
    [0.5, 0.6, 0.6, 0.7, 0.5, 0.8, 0.9, 0.9, 0.6, 1.0],
)
# How a drop turns out: "cut" can't be read, "spoilt" is left out, "odd" is repeated and stays.
KINDS = st.sampled_from(("good", "good", "good", "cut", "spoilt", "odd"))


class KilledError(BaseException):
    """The process ends at once."""


def read_drop(folder: Path, _: Any, row: Any) -> SimpleNamespace:
    """A recording as a dataset of its drop, where it can be read."""
    path = folder / str(row["trace"])
    kind = str(json.loads(path.read_text())["kind"])
    if kind == "cut" or "mass_kg" not in row:
        raise InputError.stated("no-times", path.name, value="no times")
    return SimpleNamespace(row=None, flags=(), dataset=SimpleNamespace(warnings=(), kind=kind), kind=kind)


FAKES: dict[str, Any] = {
    "GrowingStudy": lambda _: NoStudy(),
    "dataset_of": read_drop,
    "impact_of": lambda data: data,
    "several": lambda data: 1 + (data.kind == "spoilt"),
    "numbers_of": no_numbers,
}


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def rows_in(folder: Path) -> list[dict[str, str]]:
    """The rows of `impacts.csv`."""
    path = folder / "impacts.csv"
    return [*csv.DictReader(path.read_text().splitlines())] if path.exists() else []


@dataclass
class Fallen:
    """A drop as the operator knows it.

    Attributes:
        row: of the order, by which it fell.
        mass: in kg.
        kind: how it turned out.
        seen: whether that was said.
        out: whether it was left out by hand.
    """

    row: int
    mass: float
    kind: str
    seen: bool = False
    out: bool = False

    @property
    def fills(self) -> bool:
        """Whether the operator takes its row for done."""
        return not self.seen or (self.kind == "good" and not self.out)


class AtTheBench(RuleBasedStateMachine):
    """An operator, a recorder's folder and a watch of it."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.recorded, self.out = self.folder / "recorded", self.folder / "set"
        self.recorded.mkdir()
        (self.folder / "campaign.toml").write_text(TOWER)
        self.order: list[float] = []
        # Of the recorder's files the drop that each holds, of deleted ones the last that it held; all drops.
        self.files: dict[str, int] = {}
        self.deleted: dict[str, int] = {}
        self.fallen: dict[int, Fallen] = {}
        self.count, self.clock = 0, 1_700_000_000
        self.watch: Watch | None = None
        self.refusal, self.ambiguous = "", False
        # Drops whose file got another name of which the watch has not heard yet.
        self.moved: set[int] = set()
        # Drops under a name that no drop had before.
        self.fresh: set[int] = set()
        # What of the files that are not seen yet is not in the order of their drops: their times or names.
        self.astray = ""

    def teardown(self) -> None:
        shutil.rmtree(self.folder)

    # What the operator knows.

    @property
    def held(self) -> dict[int, Fallen]:
        """The drops that the dataset has, or will have."""
        return {key: self.fallen[key] for key in {*self.files.values(), *self.deleted.values()}}

    @property
    def open(self) -> list[int]:
        """The rows of the order that are still to come."""
        filled = {drop.row for drop in self.held.values() if drop.fills}
        return [row for row in range(len(self.order)) if row not in filled]

    def unseen(self) -> bool:
        """Whether recordings lie there of which nothing was said yet."""
        return any(not self.fallen[key].seen for key in self.files.values())

    def strays(self, what: str) -> bool:
        """Whether times or names of unseen files may go astray, the other telling of their order."""
        self.astray = self.astray if self.unseen() else ""
        if self.astray not in ("", what):
            return False
        self.astray = what
        return True

    def may_go_on(self) -> bool:
        return not self.refusal and bool(self.order)

    # What happens.

    @precondition(lambda self: not self.order)
    @rule(order=st.sampled_from(ORDERS))
    def begin(self, order: list[float]) -> None:
        self.order = order
        (self.folder / "order.csv").write_text("\n".join(["mass_kg", *map(str, order), ""]))
        self.start()

    def write(self, name: str, row: int, mass: float, kind: str) -> None:
        self.count += 1
        self.clock += 1
        self.fallen[self.count] = Fallen(row, mass, kind)
        self.files[name] = self.count
        self.deleted.pop(name, None)
        path = self.recorded / name
        path.write_text(json.dumps({"drop": self.count, "kind": kind}))
        os.utime(path, (self.clock, self.clock))

    @precondition(lambda self: self.may_go_on() and self.open)
    @rule(kind=KINDS)
    def new(self, kind: str) -> None:
        self.write(f"d{self.count + 1}.csv", self.open[0], self.order[self.open[0]], kind)
        self.fresh.add(self.count)

    @precondition(lambda self: self.may_go_on() and self.open)
    @rule(kinds=st.lists(KINDS, min_size=1, max_size=4), watched=st.booleans())
    def drops(self, kinds: list[str], *, watched: bool) -> None:
        """Some, one after the other; each is seen if there is a watch and somebody waits for it."""
        for kind in kinds:
            if self.may_go_on() and self.open:
                self.new(kind)
                if watched and self.watch:
                    self.catch_up()

    def to_overwrite(self) -> list[str]:
        """Names that the watch knows, or that are as they were at first."""
        return sorted(name for name, key in {**self.deleted, **self.files}.items() if key not in self.moved)

    @precondition(lambda self: self.may_go_on() and self.to_overwrite())
    @rule(data=st.data(), kind=KINDS)
    def overwrite(self, data: st.DataObject, kind: str) -> None:
        """The same drop once more, or all of its recording, under its name; also where that was deleted."""
        name = data.draw(st.sampled_from(self.to_overwrite()))
        before = self.files.get(name) or self.deleted[name]
        drop = self.fallen[before]
        # A drop that is to be repeated is overwritten in its turn, which the times of the others tell.
        if (not drop.seen and not self.strays("times")) or (not drop.fills and not self.strays("names")):
            return
        others = [other for key, other in self.held.items() if key != before]
        # Another drop has filled the row since; or one that is not seen yet fell before this one.
        self.ambiguous |= any(other.row == drop.row and other.fills for other in others)
        self.ambiguous |= not drop.seen and any(not other.seen for other in others)
        # A name without a place among those of new files.
        self.ambiguous |= name.startswith("r") and not drop.fills
        self.write(name, drop.row, drop.mass, kind)

    @precondition(lambda self: self.may_go_on() and self.open and self.of_filled_rows())
    @rule(data=st.data(), kind=KINDS)
    def reuse(self, data: st.DataObject, kind: str) -> None:
        """The name of a drop whose repeat was good is given to the next one."""
        name = data.draw(st.sampled_from(self.of_filled_rows()))
        self.ambiguous = True
        self.write(name, self.open[0], self.order[self.open[0]], kind)

    def of_filled_rows(self) -> list[str]:
        filled = {drop.row for drop in self.held.values() if drop.fills and drop.seen}
        fallen = {name: self.fallen[key] for name, key in self.files.items()}
        names = [name for name, drop in fallen.items() if not drop.fills and drop.row in filled]
        return sorted({*names} & {*self.to_overwrite()})

    @precondition(lambda self: self.may_go_on() and self.seen_files())
    @rule(data=st.data())
    def delete(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(self.seen_files()))
        (self.recorded / name).unlink()
        self.deleted[name] = self.files.pop(name)

    def seen_files(self) -> list[str]:
        return sorted(name for name, key in self.files.items() if self.fallen[key].seen)

    def to_rename(self) -> list[str]:
        """Files that are as the watch knows them, or of which it never heard."""
        return sorted(n for n, key in self.files.items() if self.fallen[key].seen or key in self.fresh)

    @precondition(lambda self: self.may_go_on() and self.to_rename())
    @rule(data=st.data())
    def rename(self, data: st.DataObject) -> None:
        """Another name; what is overwritten too between two looks is another drop for anybody."""
        name = data.draw(st.sampled_from(self.to_rename()))
        seen = self.fallen[self.files[name]].seen
        if not seen and not self.strays("names"):
            return
        self.ambiguous |= not seen
        self.count += 1
        self.move({name: f"r{self.count}.csv"})

    @precondition(lambda self: self.may_go_on() and len(self.seen_files()) > 1)
    @rule(data=st.data())
    def swap(self, data: st.DataObject) -> None:
        one, two = (
            data.draw(st.sampled_from(self.seen_files())),
            data.draw(st.sampled_from(self.seen_files())),
        )
        if one != two:
            # A name that has a row of the order already.
            self.ambiguous = True
            self.move({one: two, two: one})

    def move(self, names: dict[str, str]) -> None:
        held = {new: (self.files.pop(old), old) for old, new in names.items()}
        for new, (_, old) in held.items():
            (self.recorded / old).rename(self.recorded / f"{new}-moving")
        for new, (key, _) in held.items():
            (self.recorded / f"{new}-moving").rename(self.recorded / new)
            self.files[new] = key
            self.moved.add(key)
            self.deleted.pop(new, None)

    def table(self) -> dict[int, dict[str, str]]:
        """The rows of `impacts.csv`, by the drops whose recordings they have."""
        of_drop: dict[int, dict[str, str]] = {}
        for row in rows_in(self.out):
            if (self.out / row["trace"]).exists():
                key = json.loads((self.out / row["trace"]).read_text())["drop"]
                assert key not in of_drop, "two rows of one drop"
                of_drop[key] = row
        return of_drop

    def choose(self, data: st.DataObject) -> tuple[int, str] | None:
        """A drop in the dataset and the name that it has there."""
        names = sorted((key, row["impact"]) for key, row in self.table().items() if key in self.held)
        return data.draw(st.sampled_from(names)) if names else None

    @precondition(lambda self: self.may_go_on() and not self.unseen())
    @rule(data=st.data(), on_page=st.booleans())
    def leave_out(self, data: st.DataObject, *, on_page: bool) -> None:
        chosen = self.choose(data)
        if chosen is None:
            return
        drop, impact, stated = self.fallen[chosen[0]], chosen[1], reasons(self.out)
        if drop.out == (impact in stated):
            drop.out = not drop.out
            others = [other for key, other in self.held.items() if key != chosen[0]]
            self.ambiguous |= not drop.out and any(other.row == drop.row and other.fills for other in others)
            stated = (
                stated | {impact: "by hand"} if drop.out else {k: v for k, v in stated.items() if k != impact}
            )
            if on_page and self.watch:
                expected = suppress(InputError) if self.ambiguous else nullcontext()
                with expected:
                    self.watch.decide(impact, "by hand" if drop.out else "")
                drop.out = impact in reasons(self.out)
            else:
                rows = [f'{name},"{reason}"' for name, reason in stated.items()]
                (self.out / "left_out.csv").write_text("\n".join(["impact,reason", *rows, ""]))

    @precondition(lambda self: self.may_go_on() and not self.unseen())
    @rule(data=st.data())
    def correct(self, data: st.DataObject) -> None:
        """The mass of a drop was another."""
        if (chosen := self.choose(data)) is None:
            return
        self.fallen[chosen[0]].mass = 2.5
        table = pd.read_csv(self.out / "impacts.csv", dtype=str, keep_default_na=False)
        table.loc[table["impact"] == chosen[1], "mass_kg"] = "2.5"
        table.to_csv(self.out / "impacts.csv", index=False)

    @precondition(lambda self: self.may_go_on() and self.watch is None)
    @rule()
    def start(self) -> None:
        campaign = read_campaign(self.folder / "campaign.toml")
        drops = Drops(self.out, campaign)
        self.watch = Watch(self.recorded, campaign, drops, order_of(campaign, None), lambda _: None)

    @precondition(lambda self: self.may_go_on() and self.watch)
    @rule()
    def stop(self) -> None:
        self.watch = None

    @precondition(lambda self: self.may_go_on() and self.watch)
    @rule(steps=st.integers(0, 9))
    def kill(self, steps: int) -> None:
        """The process ends at once, after so many files took their names."""
        assert self.watch is not None
        real = Path.replace
        left = [steps]

        def replaced(path: Path, target: Path) -> Path:
            left[0] -= 1
            if left[0] < 0:
                raise KilledError
            return real(path, target)

        with pytest.MonkeyPatch.context() as patch, suppress(KilledError):
            patch.setattr(Path, "replace", replaced)
            self.look()
            self.look()
        # Begun again before anybody writes into a table that lacks what the list has.
        self.start()
        self.hear()

    @precondition(lambda self: self.may_go_on() and self.watch)
    @rule()
    def look(self) -> None:
        self.looked(1)

    @precondition(lambda self: self.may_go_on() and self.watch)
    @rule()
    def catch_up(self) -> None:
        self.looked(20)

    def looked(self, times: int) -> None:
        watch = self.watch
        assert watch is not None
        for _ in range(times):
            if not watch.look() and times > 1 and not watch.look():
                break
        assert watch._trouble is None, watch._trouble
        if watch._waiting is not None:
            assert self.ambiguous, f"refused, and nothing was ambiguous: {watch._waiting}"
            self.refusal = str(watch._waiting).replace(str(self.folder), "")
        self.hold_to_the_truth()
        if not self.refusal:
            self.hear()
            if times > 1:
                to_come = [row["mass_kg"] for row in watch.left()]
                assert to_come == [self.order[row] for row in self.open], "what is still to come"

    @precondition(lambda self: self.refusal)
    @rule()
    def rest(self) -> None:
        """Nothing happens."""

    def hear(self) -> None:
        """The verdicts are known, of files as they are now."""
        if not (self.out / LIST).exists():
            return
        memory = json.loads((self.out / LIST).read_text())
        judged = {drop["file"]: {drop["sha256"]} for drop in memory["drops"]}
        for name, sha256 in memory["refused"].items():
            judged.setdefault(name, set()).add(sha256)
        for name, key in self.files.items():
            if digest(self.recorded / name) in judged.get(name, ()):
                self.fallen[key].seen = True
                self.moved.discard(key)

    def hold_to_the_truth(self) -> None:
        """Each used drop has its mass, or the refusal names it."""
        out = reasons(self.out)
        excused = {*out, *re.findall(r"\w+(?=\.csv)", self.refusal)}
        table, filled = self.table(), Counter[int]()
        for key, row in table.items():
            if row["impact"] not in excused:
                drop = self.fallen[key]
                assert float(row["mass_kg"]) == drop.mass, f"{row['impact']}, drop {key}"
                filled[drop.row] += drop.kind == "good" and drop.mass == self.order[drop.row]
        assert self.refusal or max(filled.values(), default=0) < 2, "two used drops of one row"


SHRINK = bool(os.environ.get("SHRINK"))


@pytest.fixture
def fakes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name, fake in FAKES.items():
            patch.setattr(watching, name, fake)
        patch.setattr(Watch, "_another_velocity", lambda *_: "")
        # Nothing here loses its power.
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.mark.usefixtures("fakes")
@pytest.mark.parametrize("sequences", [40, pytest.param(2000, marks=pytest.mark.long)])
def test_no_sequence_gives_a_drop_another_mass(sequences: int) -> None:
    run_state_machine_as_test(
        AtTheBench,
        settings=settings(
            max_examples=sequences,
            stateful_step_count=30,
            deadline=None,
            derandomize=True,
            database=None,
            suppress_health_check=list(HealthCheck),
            phases=(Phase.generate, *[Phase.shrink] * SHRINK),
        ),
    )
