"""`bayestissue selftest`: whether the installed program tells the truth on this machine."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bayestissue import runtime
from bayestissue.commands.delivery import Call, delivers
from bayestissue.result import Made

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.commands.console import Shown


def _verdict(findings: pd.DataFrame, words: str) -> Iterator[Shown]:
    from bayestissue.commands.console import Grid

    failed = findings[findings["passed"] == 0]
    columns = ["check", "what", "expected", "found"]
    if len(failed):
        yield Grid("what failed", columns, failed[columns].itertuples(index=False))
    yield words


@delivers(out=Path("selftest"))
def selftest(
    thorough: bool = False,
    *,
    call: Call,
) -> Made:
    """Test the installed program on this machine: two minutes, no data of yours, one line of verdict.

    Numbers that others published, campaigns with a known truth, a file of each recorder format, and a fit
    that is killed and goes on. What it finds stands in selftest.md, which you can attach to a paper.

    Args:
        out: Folder for what was found; the files of the test are made beside it, in the place where your
            results are to lie, and removed.
        thorough: More models recovered, and a calibration of six hundred impacts: ten minutes.
    """
    from bayestissue.selftest.checks import as_markdown, machine, verdict
    from bayestissue.selftest.plan import self_test

    start, work = runtime.Start(), call.parts("selftest")
    # Nothing of a test that was ended counts.
    shutil.rmtree(work)
    work.mkdir()
    try:
        findings = self_test(work, thorough=thorough, say=call.say)
    finally:
        shutil.rmtree(work)
    passed, words = verdict(findings)
    about = start.record(
        "selftest",
        "selftest",
        thorough=thorough,
        machine=machine(),
        verdict={"passed": passed, "words": words},
    )

    def write(folder: Path) -> None:
        (folder / "selftest.md").write_text(as_markdown(findings, about), encoding="utf-8")

    tables, words_printed = {"selftest": findings}, _verdict(findings, words)
    return Made(about, tables, write, passed=passed, files=("selftest.md",), always=words_printed)
