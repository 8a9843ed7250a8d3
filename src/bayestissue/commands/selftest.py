"""`bayestissue selftest`: whether the installed program tells the truth on this machine."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayestissue import runtime
from bayestissue.commands.delivery import Call, delivers
from bayestissue.result import Result

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.commands.console import Shown


@dataclass(frozen=True, eq=False, repr=False)
class SelfTest(Result):
    """What the program found of itself.

    Attributes:
        about: the content of ``run.json``.
        findings: a row a check: ``selftest.csv``.
    """

    files = ("selftest.md",)
    about: dict[str, Any]
    findings: pd.DataFrame

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The findings."""
        return {"selftest": self.findings}

    @property
    def passed(self) -> bool:
        """Whether all checks did."""
        return bool(self.about["verdict"]["passed"])

    def write(self, folder: Path) -> None:
        """Write every file."""
        from bayestissue.selftest.checks import as_markdown

        super().write(folder)
        (folder / "selftest.md").write_text(as_markdown(self.findings, self.about), encoding="utf-8")


def _verdict(test: SelfTest) -> Iterator[Shown]:
    from bayestissue.commands.console import Grid

    failed = test.findings[test.findings["passed"] == 0]
    columns = ["check", "what", "expected", "found"]
    if len(failed):
        yield Grid("what failed", columns, failed[columns].itertuples(index=False))
    yield test.about["verdict"]["words"]


@delivers(out=Path("selftest"), verdict=_verdict)
def selftest(
    thorough: bool = False,
    *,
    call: Call,
) -> SelfTest:
    """Test the installed program on this machine: two minutes, no data of yours, one line of verdict.

    Numbers that others published, campaigns with a known truth, a file of each recorder format, and a fit
    that is killed and goes on. What it finds stands in selftest.md, which you can attach to a paper.

    Args:
        out: Folder for what was found; the files of the test are made beside it, in the place where your
            results are to lie, and removed.
        thorough: More models recovered, and a calibration of six hundred impacts: ten minutes.
    """
    from bayestissue.selftest.checks import machine, verdict
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
    return SelfTest(about, findings)
