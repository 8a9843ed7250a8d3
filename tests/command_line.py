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
