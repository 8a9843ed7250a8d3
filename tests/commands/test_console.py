"""No name of any origin steers the terminal, and none is read as markup."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from bayestissue import cli
from bayestissue.base import runtime
from bayestissue.base.errors import InputError, Problem, has_control_characters, printable
from bayestissue.commands import datasets, finished_runs
from bayestissue.commands.console import echo, show
from bayestissue.studies.estimates import Estimates

BAD = "[/red]a\x1b]0;title\x07b\x9b2Jc\u202ed\x00"
SHOWN = "[/red]a\\u001b]0;title\\u0007b\\u009b2Jc\\u202ed\\u0000"
COMMANDS = Path(cli.__file__).parent / "commands"


def tame(text: str) -> bool:
    return not has_control_characters(text.replace("\n", ""))


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "400")


def test_control_characters_are_shown_as_json_has_them() -> None:
    assert printable(BAD) == SHOWN
    assert printable("a\tb\n\u00b5é漢") == "a\\u0009b\\u000a\u00b5é漢"
    assert printable("a\tb\n", lines=True) == "a\tb\n"
    told = {"name": BAD, "other": "µ"}
    assert json.loads(printable(json.dumps(told, ensure_ascii=False))) == told


def test_a_problem_shows_every_part_of_it(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    problem = Problem(BAD, BAD, BAD, row=2, column=BAD, value=BAD, impact=BAD, code="no-file")
    assert str(problem).count(SHOWN) == 6
    assert tame(str(InputError([problem, problem])))
    for argv in (["bayestissue"], ["bayestissue", "--json"]):
        monkeypatch.setattr(sys, "argv", argv)
        with pytest.raises(SystemExit):
            cli._leave(2, cli._problems(InputError(problem)), BAD)
        assert tame(capsys.readouterr().err)


def test_the_tables_of_all_commands_are_tame(capsys: pytest.CaptureFixture[str]) -> None:
    names = pd.DataFrame(
        {
            "scheme": [BAD], "data": [BAD], "model": [BAD], "elpd": 1.0, "elpd_difference": 0.0,
            "se_difference": 0.0, "weight": 1.0, "warning": [BAD],
        }
    )  # fmt: skip
    people = pd.DataFrame(
        {"variable": ["K"], "label": [BAD], "of": "impact", "unit": ["N/m"], "run": [BAD], "median": 1.0}
    )
    people = people.assign(eti90_low=1.0, eti90_high=1.0)
    both = pd.concat([names, names.assign(data="x")])
    said = finished_runs._of_comparison(SimpleNamespace(comparison=both, posteriors=people, asked=()))
    table = Estimates({"K_N_per_m": [1.0], "C_N_s_per_m": 1.0, "zeta": 1.0, "flags": BAD, "notes": BAD})
    problems = (Problem(BAD, BAD, BAD, impact=BAD, code="no-file"),)
    table.dataset = SimpleNamespace(name=BAD, left_out=problems)
    for words in (*said, *datasets._of_estimates(table)):
        show(words)
    echo(table.wrote(Path(BAD.replace("\0", ""))))
    written = capsys.readouterr().out
    assert tame(written)
    assert written.count(SHOWN[:40]) >= 10


def test_no_command_prints_by_another_way() -> None:
    """What is printed with a name in it goes through `echo` or `plain`; a constant text may not."""
    for path in COMMANDS.glob("*.py"):
        if path.name == "console.py":
            continue
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"typer\.echo\((?!\s*\")|[^a-z]Text\(|[^.\w]print\(", text), path.name


def test_the_command_line_shows_no_library_s_warning(monkeypatch):
    for name in ("PYTHONWARNINGS", "TF_CPP_MIN_LOG_LEVEL"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setattr(sys, "warnoptions", [])
    with warnings.catch_warnings(record=True) as caught:
        runtime.quieten_libraries()
        warnings.warn("divide by zero encountered", RuntimeWarning, stacklevel=1)
    assert not caught
    shown = "import warnings; warnings.warn('divide by zero', RuntimeWarning)"
    # A worker process has the environment.
    worker = subprocess.run(  # noqa: S603 - this Python
        [sys.executable, "-c", shown], capture_output=True, text=True, check=True
    )
    assert worker.stderr == ""
