"""The command line in this process: what a command prints and the status that it leaves with."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO, TextIOBase
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from bayestissue import cli, runtime


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
        patch.setattr(runtime, "configure", lambda **_: None)
        try:
            cli.main()
        except SystemExit as stop:
            status = int(stop.code or 0)
    return Outcome(status, out.getvalue(), err.getvalue())


@contextmanager
def undrawn_figures() -> Iterator[None]:
    """Figures are made but not drawn, which is most of a page's cost."""

    def nothing(_: Figure, file: Any, **__: Any) -> None:
        file.write('<svg viewBox="0 0 1 1"></svg>' if isinstance(file, TextIOBase) else b"")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", nothing)
        yield
