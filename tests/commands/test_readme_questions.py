"""The README's commands for a finished run, run."""

from __future__ import annotations

import re
import shlex
import textwrap
from pathlib import Path

import pytest

from command_line import bayestissue
from make_fit_run import make_fit_run

README = Path(__file__).parents[2] / "README.md"
COMMANDS = [
    line.strip()
    for line in README.read_text(encoding="utf-8").splitlines()
    if line.startswith(("    bayestissue ask RUN", "    bayestissue predict RUN"))
    and "QUESTION" not in line
    and "TABLE" not in line
]
NEW = re.search(r"(?:    subject,mass_kg.*\n)(?:    .*\n)+", README.read_text(encoding="utf-8"))


@pytest.mark.parametrize("command", COMMANDS)
def test_an_example_of_the_readme_runs(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert NEW is not None
    Path("new.csv").write_text(textwrap.dedent(NEW[0]), encoding="utf-8")
    run = make_fit_run(tmp_path / "run")
    arguments = [str(run) if word == "RUN" else word for word in shlex.split(command, comments=True)[1:]]
    told = bayestissue(*arguments)
    assert (told.status, told.err) == (0, "")


def test_there_are_such_examples() -> None:
    assert len(COMMANDS) == 2
