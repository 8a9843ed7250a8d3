"""The README's commands for a finished run, run."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from command_line import bayestissue
from make_fit_run import make_fit_run

README = Path(__file__).parents[2] / "README.md"
COMMANDS = [
    line.strip()
    for line in README.read_text(encoding="utf-8").splitlines()
    if line.startswith("    bayestissue ask RUN") and "QUESTION" not in line
]


@pytest.mark.parametrize("command", COMMANDS)
def test_an_example_of_the_readme_runs(command: str, tmp_path: Path) -> None:
    run = make_fit_run(tmp_path / "run")
    arguments = [str(run) if word == "RUN" else word for word in shlex.split(command, comments=True)[1:]]
    told = bayestissue(*arguments)
    assert (told.status, told.err) == (0, "")


def test_there_are_such_examples() -> None:
    assert COMMANDS
