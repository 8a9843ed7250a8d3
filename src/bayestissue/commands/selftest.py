"""`bayestissue selftest`: whether the installed program tells the truth on this machine."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from bayestissue import runtime
from bayestissue.commands.options import FAILED_DIAGNOSTICS, Overwrite, Quiet
from bayestissue.results import claim


def run(
    out: Annotated[Path, typer.Option("--out")] = Path("selftest"),
    thorough: bool = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Test the installed program on this machine: two minutes, no data of yours, one line of verdict.

    Numbers that others published, campaigns with a known truth, a file of each recorder format, and a fit
    that is killed and goes on. What it finds stands in selftest.md, which you can attach to a paper.

    Args:
        out: Folder for what was found; the files of the test are made beside it, in the place where your
            results are to lie, and removed.
        thorough: More models recovered, and a calibration of six hundred impacts: ten minutes.
    """
    start = runtime.Start()
    with claim(out, overwrite=overwrite, command="selftest") as target:
        runtime.configure()
        from bayestissue.commands.console import Stages, echo, show, table
        from bayestissue.results import write_json, write_table
        from bayestissue.selftest.checks import as_markdown, machine, verdict
        from bayestissue.selftest.plan import self_test

        with target.folder() as folder:
            work = folder / "work"
            work.mkdir()
            try:
                with Stages(quiet=quiet) as say:
                    findings = self_test(work, thorough=thorough, say=say)
            finally:
                shutil.rmtree(work)
            passed, words = verdict(findings)
            record = start.record(
                "selftest",
                "selftest",
                thorough=thorough,
                machine=machine(),
                verdict={"passed": passed, "words": words},
            )
            write_table(findings, folder / "selftest.csv")
            (folder / "selftest.md").write_text(as_markdown(findings, record), encoding="utf-8")
            write_json(record, folder / "run.json")
        failed = findings[findings["passed"] == 0]
        if len(failed):
            columns = ["check", "what", "expected", "found"]
            show(table("what failed", columns, failed[columns].itertuples(index=False)))
        echo(words)
        if not quiet:
            echo(f"wrote {target.path / 'selftest.md'}")
    if not passed:
        raise typer.Exit(FAILED_DIAGNOSTICS)
