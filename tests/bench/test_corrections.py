"""Which row of the order a file takes, and what a person writes into the dataset of a watch: both hold."""

from __future__ import annotations

import errno
import json
import os
import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from written_drops import TOWER, NoStudy, no_numbers

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.dataset.left_out import reasons
from bayestissue.studies.bench import drops as drops_module
from bayestissue.studies.bench import watching
from bayestissue.studies.bench.campaign_file import read_campaign
from bayestissue.studies.bench.drops import LIST, Drops
from bayestissue.studies.bench.order import order_of
from bayestissue.studies.bench.watching import TAKEN_BACK, Watch

MASSES = [round(0.5 + 0.1 * n, 1) for n in range(12)]
NAMES = [f"d{number}" for number in range(1, 13)]
# No recording yet.
BEGUN = "time_s,value\n0.0,1\n"
UNORDERED = TOWER.replace('order = "order.csv"\n', "")


class Bench:
    """A folder of recordings and a watch of it; every recording is sound unless it is in ``spoilt``."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.recorded, self.out = folder, folder / "recorded", folder / "set"
        self.recorded.mkdir()
        self.spoilt: set[str] = set()
        self.campaign(TOWER)
        self.order(MASSES)
        self._watch: Watch | None = None

    def campaign(self, text: str) -> None:
        (self.folder / "campaign.toml").write_text(text)

    def order(self, masses: list[float], files: list[str] | None = None) -> None:
        table = pd.DataFrame({"mass_kg": masses})
        (table if files is None else table.assign(file=files)).to_csv(self.folder / "order.csv", index=False)

    def file(self, name: str) -> Path:
        return self.recorded / f"{name}.csv"

    def record(self, *names: str, value: float | None = None, at_s: float | None = None) -> None:
        """Recordings, another for each name unless ``value`` says which, written at a time."""
        for name in names:
            of_name = float((sum(f"{name}.csv".encode()) + 31 * len(name) + 124) % 400)
            height = 600 + (of_name if value is None else value)
            rows = [f"{t / 1e4:.4f},{height * np.sin(t / 60):.3f}" for t in range(60)]
            self.write(name, "\n".join(["time_s,value", *rows, ""]), at_s)

    def write(self, name: str, text: str = BEGUN, at_s: float | None = None) -> None:
        self.file(name).write_text(text)
        if at_s is not None:
            os.utime(self.file(name), (at_s, at_s))

    def rename(self, *names: tuple[str, str]) -> None:
        for old, new in names:
            self.file(old).rename(self.file(new))

    def begin(self, plan: Path | None = None) -> Watch:
        """A watch, which is the one that goes on from here."""
        campaign = read_campaign(self.folder / "campaign.toml")
        drops, order = Drops(self.out, campaign), order_of(campaign, plan)
        self._watch = Watch(self.recorded, campaign, drops, order, lambda _: None)
        return self._watch

    @property
    def watch(self) -> Watch:
        return self._watch or self.begin()

    def catch_up(self) -> None:
        self.watch.catch_up(0)

    def take(self, *names: str, value: float | None = None) -> None:
        """Record them, each seen before the next."""
        for name in names:
            self.record(name, value=value)
            self.catch_up()

    def refuses(self, words: str) -> None:
        with pytest.raises(InputError, match=words):
            self.catch_up()

    def leave_out(self, *rows: str) -> None:
        (self.out / "left_out.csv").write_text("\n".join(["impact,reason", *rows, ""]))

    @property
    def said(self) -> str:
        return "\n".join(line.text for line in self.watch.lines)

    @property
    def masses(self) -> dict[str, float]:
        table = pd.read_csv(self.out / "impacts.csv")
        return dict(zip(table["impact"], table["mass_kg"], strict=True))

    def took(self, *names: str) -> None:
        """These drops took the rows of the order one after the other."""
        assert self.masses == dict(zip(names, MASSES, strict=False))


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    made = Bench(tmp_path)

    def judged(data: Any) -> SimpleNamespace:
        return SimpleNamespace(row=None, flags=(), dataset=data, kind="")

    monkeypatch.setattr(watching, "GrowingStudy", lambda _: NoStudy())
    monkeypatch.setattr(watching, "impact_of", judged)
    monkeypatch.setattr(watching, "numbers_of", no_numbers)
    monkeypatch.setattr(watching, "inspect", lambda _: {})
    monkeypatch.setattr(watching, "dataset_of", checked_row)
    monkeypatch.setattr(watching, "several", lambda data: 1 + (data.impacts["impact"].item() in made.spoilt))
    return made


def checked_row(*args: Any) -> Dataset:
    """The drop as a dataset, by the checks of the program, but for what they warn of."""
    return replace(drops_module.dataset_of(*args), warnings=())


@pytest.mark.slow
def test_where_times_and_names_disagree_a_person_says_which_hold(bench: Bench) -> None:
    for number, name in enumerate(NAMES):
        bench.record(name, at_s=1e9 - number)
    bench.refuses(r"(?s)(?=.*d12\.csv, d11\.csv).*d1\.csv, d2\.csv")
    assert not bench.watch.drops.drops
    bench.campaign('files_by = "times"\n' + TOWER)
    bench.begin()
    bench.catch_up()
    bench.took(*reversed(NAMES))
    # Or the order says it of each.
    bench.campaign(TOWER)
    bench.out = bench.folder / "other"
    bench.order(MASSES, [*NAMES[6:], *NAMES[:6]])
    bench.begin()
    bench.catch_up()
    bench.took(*NAMES[6:], *NAMES[:6])


def test_more_files_than_rows_and_one_that_comes_late_are_refused(bench: Bench) -> None:
    bench.order(MASSES[:2])
    bench.record("d1", "d2", "d3", at_s=1e9)
    bench.refuses("a row of the order for each")
    bench.file("d1").unlink()
    bench.begin()
    bench.file("d3").unlink()
    bench.catch_up()
    bench.record("d1", at_s=1e9)
    bench.refuses(r"d1\.csv after d2\.csv")


def test_rows_of_drops_that_were_taken_stay_as_they_were(bench: Bench) -> None:
    bench.take("d1")
    bench.order([0.7, *MASSES[1:]])
    with pytest.raises(InputError, match=r"0\.7.*0\.5"):
        bench.begin()
    bench.order([*MASSES, 3.0])
    # Among the recordings it is none of them.
    shutil.copy(bench.folder / "order.csv", bench.recorded)
    bench.campaign(TOWER.replace("order.csv", "recorded/order.csv"))
    bench.begin()
    bench.catch_up()
    assert "order.csv" not in bench.said


def test_files_that_are_renamed_take_the_facts_of_their_new_names(bench: Bench) -> None:
    bench.campaign(TOWER.replace('order = "order.csv"', 'pattern = "{n}_{mass_kg}kg"'))
    for name, value in (("1_0.5kg", 50.0), ("2_1.2kg", 60.0), ("3_0.9kg", 70.0)):
        bench.record(name, value=value, at_s=1e9)
    bench.catch_up()
    bench.watch.decide("2_1.2kg", "hit the frame")
    before = {drop.impact: drop.sha256 for drop in bench.watch.drops}
    bench.rename(("1_0.5kg", "spare"), ("2_1.2kg", "1_0.5kg"), ("spare", "2_1.2kg"), ("3_0.9kg", "3_2kg"))
    bench.catch_up()
    now = {drop.impact: drop.sha256 for drop in bench.watch.drops}
    renamed = {"1_0.5kg": "2_1.2kg", "2_1.2kg": "1_0.5kg", "3_2kg": "3_0.9kg"}
    assert now == {name: before[old] for name, old in renamed.items()}
    assert bench.masses == {"1_0.5kg": 0.5, "2_1.2kg": 1.2, "3_2kg": 2.0}
    assert reasons(bench.out) == {"1_0.5kg": "hit the frame"}
    assert {p.name for p in (bench.out / "recordings").glob("*.csv")} == {f"{name}.csv" for name in now}
    bench.take("copy_1kg", value=50.0)
    assert "copy_1kg.csv: the same recording as 2_1.2kg.csv; not taken twice" in bench.said


def test_two_drops_in_use_share_no_row_by_a_decision(bench: Bench) -> None:
    bench.take("d1", "d2")
    bench.watch.decide("d2", "hit the frame")
    bench.take("d3")
    assert bench.masses == {"d1": 0.5, "d2": 0.6, "d3": 0.6}
    with pytest.raises(InputError, match=r"d2\.csv.*the row of d3\.csv"):
        bench.watch.decide("d2", "")
    bench.leave_out()
    bench.record("d4")
    bench.refuses("d2 and d3")
    bench.watch.decide("d3", "a second one")
    bench.catch_up()
    assert bench.masses == {"d1": 0.5, "d2": 0.6, "d3": 0.6, "d4": 0.7}


def test_a_drop_that_is_overwritten_by_what_cannot_be_read_is_left_out_until_it_is_back(bench: Bench) -> None:
    bench.take("d1")
    whole = bench.file("d1").read_text()
    bench.write("d1")
    bench.catch_up()
    assert reasons(bench.out) == {"d1": drops_module.UNREADABLE}
    assert bench.watch.left()[0] == {"mass_kg": 0.5}
    bench.begin()
    bench.write("d1", whole)
    bench.catch_up()
    assert (reasons(bench.out), bench.watch.left()[0]) == ({}, {"mass_kg": 0.6})


def test_names_that_were_swapped_within_an_order_are_looked_at(bench: Bench) -> None:
    bench.take("d1", "d2")
    swap = (("d1", "spare"), ("d2", "d1"), ("spare", "d2"))
    bench.rename(*swap)
    bench.refuses(r"d[12]\.csv.*d[12]\.csv")
    bench.rename(*swap)
    bench.catch_up()
    bench.took("d1", "d2")
    # Nor is what has the former name of a renamed drop another drop for sure.
    bench.rename(("d2", "d7"))
    bench.record("d2", value=33.0)
    bench.refuses(r"d2\.csv.*d7\.csv")


def test_a_name_unlike_the_others_takes_no_row_that_another_may_have(bench: Bench) -> None:
    for number, name in enumerate(("a note", "d1", "d2", "d3")):
        bench.record(name, at_s=1e9 + number)
    bench.refuses(r"a note\.csv.*alike but for their numbers")
    bench.file("a note").unlink()
    bench.begin()
    bench.catch_up()
    bench.took("d1", "d2", "d3")


def test_a_file_that_is_renamed_before_it_was_judged_is_looked_at(bench: Bench) -> None:
    bench.write("d1")
    bench.write("d2", "")
    bench.catch_up()
    bench.file("d2").unlink()
    bench.record("d3")
    bench.refuses(r"d3\.csv.*d2\.csv, which had a row")
    whole = bench.file("d3").read_text()
    bench.file("d3").unlink()
    bench.catch_up()
    bench.write("d3", whole)
    bench.catch_up()
    bench.took("d3")


def test_a_file_that_is_gone_is_in_nobodys_way_where_the_order_names_files(bench: Bench) -> None:
    bench.order(MASSES[:3], ["d1", "d2", "d3"])
    bench.write("d1", "")
    bench.catch_up()
    bench.file("d1").unlink()
    bench.take("d3")
    assert bench.masses == {"d3": 0.7}


def test_a_decision_on_the_page_follows_what_was_written_by_hand_before(bench: Bench) -> None:
    bench.take("d1")
    bench.leave_out("d1,hit the frame")
    bench.watch.decide("d1", "")
    bench.catch_up()
    assert reasons(bench.out) == {}


@pytest.mark.slow
@pytest.mark.parametrize("running", [True, False])
def test_what_a_person_writes_into_the_tables_is_kept(bench: Bench, running: bool) -> None:
    bench.take(*NAMES[:4])
    table = pd.read_csv(bench.out / "impacts.csv", dtype=str).assign(cover="foam")
    table.loc[1, "mass_kg"], table.loc[2, "impact"] = "2.5", "third"
    table = pd.concat(
        [table.drop(index=3), table.iloc[:1].assign(impact="by hand", trace="recordings/d1.csv")]
    )
    # As a spreadsheet of another country has it.
    table.to_csv(bench.out / "impacts.csv", index=False, sep=";", decimal=",")
    bench.leave_out("d1,slipped", "nobody,not there yet")
    if not running:
        bench.begin()
    bench.take("d5")
    bench.take("d2", value=99.0)
    said = bench.said
    bench.begin()
    after = pd.read_csv(bench.out / "impacts.csv", dtype=str, keep_default_na=False).set_index("impact")
    assert list(after.index) == ["d1", "d2", "third", "d4", "d5", "by hand"]
    assert list(after["mass_kg"].astype(float)) == [0.5, 2.5, 0.7, 0.8, 0.5, 0.5]
    assert list(after["cover"]) == ["foam", "foam", "foam", "", "", "foam"]
    assert reasons(bench.out) == {"d1": "slipped", "d4": drops_module.BY_HAND, "nobody": "not there yet"}
    assert "d2: impacts.csv says mass_kg 2.5 (0.6 before)" in said
    assert "left_out.csv: nobody is no impact; its row stays" in said
    # And taken back by hand.
    bench.leave_out()
    assert len(bench.begin().drops.used) == 5


def test_a_table_that_cannot_be_used_waits_and_is_not_overwritten(bench: Bench) -> None:
    bench.take("d1")
    watch, good = bench.watch, (bench.out / "impacts.csv").read_text()
    for name, text in (
        ("impacts.csv", good.replace("0.5", "half")),
        ("left_out.csv", "impact,reason\nd1,\n"),
    ):
        (bench.out / name).write_text(text)
        bench.record(f"d{name}")
        for begun in (lambda: watch.catch_up(0), bench.begin):
            with pytest.raises(InputError):
                begun()
        assert (bench.out / name).read_text() == text
        (bench.out / name).write_text(good) if name == "impacts.csv" else (bench.out / name).unlink()
        watch.catch_up(0)
        assert f"d{name}" in bench.masses


def test_facts_of_the_page_and_names_with_a_space_survive(bench: Bench) -> None:
    bench.campaign(UNORDERED)
    bench.watch.choose({"mass_kg": "0.9"})
    bench.spoilt.add("d1")
    bench.take(" d1")
    bench.watch.decide("d1", TAKEN_BACK)
    assert [drop.left_out for drop in bench.begin().drops] == [TAKEN_BACK]
    bench.take("d2")
    assert bench.masses == {"d1": 0.9, "d2": 0.9}
    bench.watch.choose({"mass_kg": "1.4"})
    bench.take("d2", value=3.0)
    assert bench.masses["d2"] == 0.9
    assert "d2: keeps mass_kg 0.9 of its row; the page says mass_kg 1.4 of new files" in bench.said


def test_settings_that_were_written_by_hand_are_refused_with_both_values(bench: Bench) -> None:
    bench.take("d1")
    with (bench.out / "dataset.toml").open("a") as file:
        file.write("[uncertainty]\nvelocity_sd_m_s = 0.02\n")
    with pytest.raises(InputError) as error:
        bench.begin()
    (problem,) = error.value.problems
    assert (problem.column, problem.value) == ("uncertainty.velocity_sd_m_s", 0.02)
    assert "nothing, as the campaign file says" in problem.expected


@pytest.mark.slow
def test_a_measured_velocity_counts_more_than_a_planned_one(bench: Bench) -> None:
    plan = {"candidates": {"people": [2], "masses_kg": [[0.5, 1.2]], "velocities_m_s": [2.0]}}
    plan |= {"questions": {"q": "mass_exponent_K < 1"}}
    (bench.folder / "plan.json").write_text(json.dumps({"plan": {"name": "p", **plan}, "chosen": 1}))
    bench.campaign(UNORDERED)
    watch = bench.begin(bench.folder)
    bench.take("d1")
    assert watch.drops.drops[0].cells["velocity_m_s"] == 1.5
    assert watch.drops.drops[0].cells["mass_kg"] == 0.5
    assert [row["mass_kg"] for row in watch.left()] == [1.2, 0.5, 1.2]
    bench.campaign(UNORDERED + "mass_kg = 0.6\n")
    with pytest.raises(InputError, match=r"0\.6.*0\.5"):
        bench.begin(bench.folder)


@pytest.mark.slow
def test_a_full_disk_ends_after_some_tries_and_nothing_is_lost(bench, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    bench.take("d1")
    bench.record("d2")
    bench.spoilt.add("d2")
    with monkeypatch.context() as patch:
        patch.setattr(drops_module, "write_left_out", full)
        with pytest.raises(OSError, match="No space left"):
            bench.catch_up()
        assert bench.said.count("trying again") == 1
    for begun in (lambda: bench.watch, bench.begin):
        begun().catch_up(0)
        bench.took("d1", "d2")
        assert list(reasons(bench.out)) == ["d2"]


@pytest.mark.slow
def test_a_list_that_is_damaged_is_made_anew_from_the_tables(bench: Bench) -> None:
    bench.take("d1", "d2", "d3")
    bench.watch.decide("d2", "hit the frame")
    whole = (bench.out / LIST).read_bytes()
    tables = {name: (bench.out / name).read_bytes() for name in ("impacts.csv", "left_out.csv")}
    half = whole[: len(whole) // 2]
    for damaged in (b"", half, b"[]", b'{"drops": 3}', b'{"drops": [{}]}', b"\xff", b"[" * 9900):
        (bench.out / LIST).write_bytes(damaged)
        bench.begin()
        bench.catch_up()
        assert "watch.json was damaged" in bench.said
        assert {name: (bench.out / name).read_bytes() for name in tables} == tables
        assert [drop.file for drop in bench.watch.drops] == ["d1.csv", "d2.csv", "d3.csv"]
    # The row of d2 is still to be filled; it holds it if it changes.
    bench.record("d2", value=44.0, at_s=1e9)
    bench.take("d4")
    bench.took(*NAMES[:4])


def test_campaigns_and_orders_that_are_cut_short_are_refused_or_read(bench: Bench) -> None:
    for name in ("campaign.toml", "order.csv"):
        whole = (bench.folder / name).read_bytes()
        for end in range(0, len(whole), 5):
            (bench.folder / name).write_bytes(whole[:end])
            with suppress(InputError):
                order_of(read_campaign(bench.folder / "campaign.toml"), None)
        (bench.folder / name).write_bytes(whole)


def test_a_name_that_is_no_text_is_refused_and_the_others_are_taken(bench: Bench) -> None:
    bench.record("d1")
    try:
        (Path(os.fsdecode(os.fsencode(bench.recorded) + b"/d\xff2.csv"))).write_text("x")
    except OSError:
        pytest.skip("this file system has no such names")
    bench.catch_up()
    assert "d\\udcff2.csv: again: found d\\udcff2.csv; expected a file name in UTF-8" in bench.said
    bench.took("d1")
