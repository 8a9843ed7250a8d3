"""Forty drops as a recorder writes them, the process of `watch` killed in their middle and begun again."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from written_drops import by_init, drop, plan_of_drops, write

import bayestissue as bt
from bayestissue.recordings.dataset.left_out import reasons
from bayestissue.studies.checking import check

pytestmark = pytest.mark.long
NAMES = plan_of_drops(40)
PATIENCE_S = 300


class Process:
    """A running `bayestissue watch --plain`, and what it said."""

    def __init__(self, recorded: Path, log: Path) -> None:
        campaign, self.out = recorded.parent / "campaign.toml", recorded.parent / "set"
        command = [sys.executable, "-u", "-m", "bayestissue", "watch", recorded, "--campaign", campaign]
        self.log = log
        self.file = log.open("w")
        self.begun = subprocess.Popen(  # noqa: S603 - this program
            [*map(str, command), "--out", str(self.out), "--plain", "--poll-s", "0.1"],
            stdout=self.file,
            stderr=subprocess.STDOUT,
        )

    def wait(self, condition: Callable[[list[str]], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition(said := self.log.read_text(encoding="utf-8").splitlines()):
            assert time.monotonic() < end, said
            assert self.begun.poll() is None, said
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


def test_forty_drops_and_a_kill_in_their_middle(recorded: Path, tmp_path: Path) -> None:
    late, last = NAMES[7], NAMES[-1]
    with watching(recorded, "first.log") as first:
        for name in NAMES[:25]:
            data = drop(name, late_s=0.013 * (name == late))
            # In two pieces, of which the first is no recording.
            write(recorded, name, data[: len(data) // 3])
            time.sleep(0.05)
            write(recorded, name, data)
        # Killed while drops are waiting, as like as not in the middle of one.
        first.wait(lambda said: sum(": good" in line or ": again" in line for line in said) > 10)
    with watching(recorded, "second.log") as second:
        for name in NAMES[25:]:
            write(recorded, name, drop(name))
        second.wait(lambda said: any(line.startswith(f"{last.removesuffix('.csv')}: ") for line in said))
    data = bt.read_dataset(second.out)
    taken = [*data.impacts["impact"], *(problem.impact for problem in data.left_out)]
    assert sorted(taken) == sorted(name.removesuffix(".csv") for name in NAMES)
    assert reasons(second.out) == {late.removesuffix(".csv"): data.left_out[0].value}
    assert check(data).verdict.startswith("fine")
    by_hand = bt.read_dataset(by_init(recorded, tmp_path / "by-init"))
    theirs = dict(zip(by_hand.impacts["impact"], by_hand.traces, strict=True))
    for name, trace in zip(data.impacts["impact"], data.traces, strict=True):
        np.testing.assert_array_equal(trace.value, theirs[name].value)
