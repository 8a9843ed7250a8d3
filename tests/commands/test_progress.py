"""What long work tells of how far it is."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bayestissue.commands import console
from bayestissue.commands.console import Stages

Told = Callable[..., list[str]]


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Told:
    """The lines that stages say, one after the other by this clock."""

    def by(clock: list[float], stages: list[tuple[str, int, int]], patience_s: float = 0.0) -> list[str]:
        ticks = iter(clock)
        monkeypatch.setattr(console.time, "monotonic", lambda: next(ticks))
        say = Stages(quiet=False, patience_s=patience_s)
        for stage in stages:
            say(*stage)
        return capsys.readouterr().err.splitlines()

    return by


def test_the_time_left_is_told_from_what_follows_compilation(told: Told) -> None:
    stages = [("sampling the population", done, 1000) for done in (0, 100, 200, 300)]
    said = told([0.0, 0.0, 300.0, 320.0, 340.0], stages)
    assert said[:2] == ["sampling the population: 0 of 1000", "sampling the population: 100 of 1000"]
    assert said[2:] == [
        "sampling the population: 200 of 1000, about 160 s left",
        "sampling the population: 300 of 1000, about 140 s left",
    ]


def test_a_stage_whose_words_go_on_keeps_its_time(told: Told) -> None:
    """A chain says after each look how many effective draws it has."""
    stages = [("sampling" + ", 250 of 400 effective draws" * (done > 1), done, 5) for done in range(4)]
    said = told([0.0, 0.0, 10.0, 20.0, 30.0], stages)
    assert said[-1] == "sampling, 250 of 400 effective draws: 2 of 5, about 30 s left"
