from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from bayestissue import cli
from bayestissue.recordings.dataset import write_dataset
from dataset_bench import SETTINGS, Lab, Outcome, tables


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    impacts, traces = tables()
    folder = tmp_path / "bench"
    write_dataset(folder, settings=SETTINGS, impacts=impacts, traces=traces, trace_file="traces.csv")
    return Lab(folder)


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """Run the command line in this process."""

    def run(*arguments: str | Path) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["bayestissue", *map(str, arguments)])
        capsys.readouterr()
        status = 0
        try:
            cli.main()
        except SystemExit as stop:
            status = int(stop.code or 0)
        written = capsys.readouterr()
        return Outcome(status, written.out, written.err)

    return run
