"""What long work tells of how far it is."""

from __future__ import annotations

import pytest

from bayestissue.commands import console
from bayestissue.commands.console import Stages


def test_the_time_left_is_told_from_what_follows_compilation(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, 0.0, 300.0, 320.0, 340.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(clock))
    stages = Stages(quiet=False)
    for done in (0, 100, 200, 300):
        stages("sampling the population", done, 1000)
    told = capsys.readouterr().err.splitlines()
    assert told[:2] == ["sampling the population: 0 of 1000", "sampling the population: 100 of 1000"]
    assert told[2:] == [
        "sampling the population: 200 of 1000, about 160 s left",
        "sampling the population: 300 of 1000, about 140 s left",
    ]


def test_what_is_soon_over_says_nothing_in_a_log(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, 0.0, 29.0, 40.0, 41.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(clock))
    stages = Stages(quiet=False, patience_s=30.0)
    for done in range(4):
        stages("each impact's posterior", done, 4)
    told = capsys.readouterr().err.splitlines()
    assert told == ["each impact's posterior: 2 of 4, about 22 s left"]


def test_a_stage_whose_words_go_on_keeps_its_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chain says after each look how many effective draws it has."""
    clock = iter([0.0, 0.0, 10.0, 20.0, 30.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(clock))
    stages = Stages(quiet=False)
    for done in range(4):
        stages("sampling" + ", 250 of 400 effective draws" * (done > 1), done, 5)
    told = capsys.readouterr().err.splitlines()
    assert told[-1] == "sampling, 250 of 400 effective draws: 2 of 5, about 30 s left"
