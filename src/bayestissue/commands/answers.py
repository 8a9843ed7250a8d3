"""What commands that ask a finished run have in common: a table, printed or as a file and a page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from bayestissue import results, runtime

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.finished import Fit


def answer(
    run: Path,
    table_of: Callable[[Fit], pd.DataFrame],
    show: Callable[[pd.DataFrame], None],
    *,
    command: str,
    name: str,
    inputs: tuple[Path, ...],
    out: Path | None,
    excel: results.Excel | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Make a table of a finished run, print it, and write it into the folder ``out`` if there is one.

    Args:
        run: the run's folder.
        table_of: makes the table.
        show: prints it.
        command: what the folder says wrote it.
        name: of the table: that of its file, of its page in `bayestissue.report.answers_page`, and its key in
            JSON.
        inputs: files and folders that are read and must not be overwritten.
        out: where to write; nowhere unless given.
        excel: how the table is written; see `results.write_table`.
        overwrite: whether an older result there may be replaced.
        quiet: print nothing.
        as_json: print JSON instead.

    Raises:
        InputError: ``run`` is no finished fit, ``table_of`` finds something wrong, or ``out`` is not free.
    """
    with results.claim_if(out, overwrite=overwrite, command=command, inputs=inputs) as target:
        runtime.configure()
        from bayestissue.commands.console import echo
        from bayestissue.finished import read_run

        finished = read_run(run)
        table = table_of(finished)
        if target is not None:
            with target.folder() as folder:
                from bayestissue.report import answers_page

                results.write_table(table, folder / f"{name}.csv", excel)
                page = getattr(answers_page, f"{name}_page")(table, finished.about)
                (folder / "report.html").write_text(page, encoding="utf-8")
        if as_json:
            echo(json.dumps({name: json.loads(table.to_json(orient="records"))}, ensure_ascii=False))
        elif not quiet:
            show(table)
            if target is not None:
                echo(f"wrote {target.path / f'{name}.csv'} and {target.path / 'report.html'}")
