"""Sixty drops as a recorder writes them, the process of `watch` killed in their middle and begun again."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pytest
from written_drops import by_init, drop, plan_of_drops, write

import bayestissue as bt
from bayestissue.recordings.dataset.left_out import reasons
from bayestissue.studies.checking import check

pytestmark = pytest.mark.long
NAMES = plan_of_drops(60)
PATIENCE_S = 120


class Process:
    """A running `bayestissue watch --plain`, and what it said."""

    def __init__(self, recorded: Path, log: Path) -> None:
        campaign, out = recorded.parent / "campaign.toml", recorded.parent / "set"
        command = [sys.executable, "-u", "-m", "bayestissue", "watch", recorded, "--campaign", campaign]
        self.log, self.out = log, out
        self.file = log.open("w")
        self.begun = subprocess.Popen(  # noqa: S603 - this program
            [*map(str, command), "--out", str(out), "--plain", "--poll-s", "0.1"],
            stdout=self.file,
            stderr=subprocess.STDOUT,
        )

    def said(self) -> list[str]:
        return self.log.read_text(encoding="utf-8").splitlines()

    def wait(self, condition: Callable[[list[str]], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition(self.said()):
            assert time.monotonic() < end, self.said()
            assert self.begun.poll() is None, self.said()
            time.sleep(0.05)


@contextmanager
def watching(recorded: Path, name: str) -> Iterator[Process]:
    process = Process(recorded, recorded.parent / name)
    try:
        process.wait(lambda said: any(line.startswith("ready") for line in said))
        yield process
    finally:
        process.begun.kill()
        process.begun.wait()
        process.file.close()


def in_pieces(folder: Path, name: str, data: bytes) -> None:
    for part in range(1, 4):
        write(folder, name, data[: part * len(data) // 3])
        time.sleep(0.05)


def test_sixty_drops_and_a_kill_in_their_middle(recorded: Path, tmp_path: Path) -> None:
    late, cut, unlike, gone = NAMES[7], NAMES[13], "s03_left_0.5kg_8.csv", NAMES[20]
    with watching(recorded, "first.log") as first:
        for number, name in enumerate(NAMES[:30]):
            data = drop(name, late_s=0.013 * (name == late))[: 900 if name == cut else None]
            (in_pieces if number % 3 == 0 else write)(recorded, name, data)
            if number % 5:
                time.sleep(0.15)
        write(recorded, NAMES[59], b"")
        # Killed while drops of the thirty are waiting, as like as not in the middle of one.
        first.wait(lambda said: sum(": good" in line or ": again" in line for line in said) > 12)
    (recorded / gone).unlink(missing_ok=True)
    write(recorded, NAMES[2], drop(NAMES[2], stiffer=1.01))
    with watching(recorded, "second.log") as second:
        for one, two in zip(NAMES[30:59:2], NAMES[31:60:2], strict=True):
            write(recorded, one, drop(one))
            if two != NAMES[59]:
                write(recorded, two, drop(two))
            time.sleep(0.1)
        write(recorded, unlike, drop(unlike, stiffer=1.9))
        second.wait(lambda said: f"{NAMES[59]}: empty so far" in said)
        write(recorded, NAMES[59], drop(NAMES[59]))
        stems = {name.removesuffix(".csv") for name in (*NAMES, unlike)}
        last = NAMES[59].removesuffix(".csv")
        second.wait(lambda said: any(line.startswith(f"{last}: ") for line in said))
        second.wait(lambda said: any(line.startswith(unlike.removesuffix(".csv")) for line in said))
    data = bt.read_dataset(second.out)
    said = [*first.said(), *second.said()]
    taken = {*data.impacts["impact"], *(p.impact for p in data.left_out)}
    # One that was deleted between the two processes may or may not have been taken by the first.
    assert taken | {gone.removesuffix(".csv")} == stems - {cut.removesuffix(".csv")}
    assert data.impacts["impact"].is_unique
    assert reasons(second.out) == {late.removesuffix(".csv"): data.left_out[0].value}
    assert check(data).verdict.startswith("fine")
    assert any(line.startswith(f"{cut}: again: found") for line in said)
    assert any(line.startswith(f"overwritten, taken anew: {NAMES[2].removesuffix('.csv')}") for line in said)
    assert any(line.startswith(unlike.removesuffix(".csv")) and "higher than" in line for line in said)
    (recorded / cut).unlink()
    by_hand = by_init(recorded, tmp_path / "by-init")
    ours, theirs = (bt.estimate(each).set_index("impact").sort_index() for each in (data, by_hand))
    both = sorted(set(ours.index) & set(theirs.index))
    assert len(both) >= 57
    pd.testing.assert_frame_equal(ours.loc[both], theirs.loc[both])
