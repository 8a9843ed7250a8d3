"""The command line in this process: what a command prints and the status that it leaves with."""

from __future__ import annotations

import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import pytest

from bayestissue import cli
from bayestissue.base import runtime


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str


def options(**given: object) -> list[str]:
    """Options by their names: a dictionary gives one for each entry, True an option alone, None nothing."""
    words = []
    for name, value in given.items():
        flag = f"--{name.replace('_', '-')}"
        if isinstance(value, dict):
            words += [word for key, one in value.items() for word in (flag, f"{key}={_word(one)}")]
        elif value is not None:
            words += [flag, *([] if value is True else [_word(value)])]
    return words


def _word(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def init(recorded: Path, out: Path, *more: str | Path, **given: object) -> Outcome:
    """Run ``bayestissue init`` on recordings of a deceleration, unless another quantity is given."""
    said = options(**{"quantity": "deceleration"} | given)
    return bayestissue("init", recorded, "--out", out, *said, *more)


def bayestissue(*arguments: str | Path) -> Outcome:
    """Run ``bayestissue ARGUMENTS``. This process keeps its cores and its settings."""
    out, err, status = StringIO(), StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["bayestissue", *map(str, arguments)])
        patch.setattr(runtime, "keep_compiled", lambda: None)
        patch.setattr(runtime, "quieten_libraries", lambda: None)
        patch.setattr(runtime, "configure", lambda **_: None)
        try:
            cli.main()
        except SystemExit as stop:
            status = int(stop.code or 0)
    return Outcome(status, out.getvalue(), err.getvalue())
