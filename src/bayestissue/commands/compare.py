"""`bayestissue compare`: finished fits of the same recordings beside each other."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayestissue import results, runtime
from bayestissue.commands.options import Json, Overwrite, Quiet
from bayestissue.errors import InputError, Problem, all_of, refuse

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.inference.comparing import FinishedRun

_AGAIN = "Give folders of finished runs of `bayestissue fit`."
_GROUPS: dict[str, tuple[str, ...]] = {
    "posterior": (),
    "log_likelihood": ("trace",),
    "log_likelihood_of_groups": ("traces_of_subject", "traces_of_trial"),
    "constant_data": ("impact_subject", "mass_kg", "velocity_m_s"),
}
_unfit = partial(Problem, code="runs-to-compare")
_DIGITS = {"elpd": 1, "elpd_difference": 1, "se_difference": 1, "weight": 2}
_HEADINGS = {"elpd_difference": "off the best", "se_difference": "its se"}
_OF_IMPACTS = ("K", "C", "K_secant", "C_equivalent")


def run(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR")],
    ask: Annotated[list[str] | None, typer.Option(metavar="QUESTION")] = None,
    out: Path | None = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Which finished fit predicts best what it has not seen, and whether the fits agree on K and C.

    Args:
        runs: Folders of two or more finished fits of one dataset.
        ask: Answered by each run, such as "peak_force[mass_kg=5, velocity_m_s=2] < 300"; may be given
            several times.
        out: Also write the tables and a page with figures.
    """
    start = runtime.Start()
    _require_distinct(runs)
    with results.claim_if(out, overwrite=overwrite, command="compare", inputs=runs) as target:
        runtime.configure()
        from bayestissue.commands.console import echo, echo_tables
        from bayestissue.inference.answers.questions import ask_what_can_be, numbered, require_parsed
        from bayestissue.inference.comparing import compare_runs, posteriors_by_run, same_questions
        from bayestissue.report import draw_page
        from bayestissue.report.comparison import page_of

        questions = numbered(ask or [])
        require_parsed(questions)
        abouts = _abouts(runs)
        finished = _finished(runs, abouts)
        comparison, posteriors = compare_runs(finished), posteriors_by_run(finished)
        answered = {
            run.name: results.read_tables(path, (), ("contrasts", "questions"))
            | {"asked": ask_what_can_be(run.finished, questions)}
            for run, path in zip(finished, runs, strict=True)
        }
        tables = {
            "comparison": comparison,
            "posteriors": posteriors,
            "answers": same_questions(answered),
        }
        if target is not None:
            with target.folder() as folder:
                for name, table in tables.items():
                    results.write_table(table, folder / f"{name}.csv")
                of_runs = zip(finished, runs, abouts, strict=True)
                record = start.record(
                    "compare",
                    "comparison",
                    dataset=abouts[0].get("dataset", ""),
                    words=abouts[0].get("words", {}),
                    input_hash=abouts[0]["input_hash"],
                    runs=[_run_record(run, path, record) for run, path, record in of_runs],
                )
                results.write_json(record, folder / "run.json")
            draw_page(target.path, partial(page_of, tables, record))
        if as_json:
            echo_tables(**tables)
        elif not quiet:
            print_comparison(comparison, posteriors)
            if questions:
                print_answers(tables["answers"], [question.text for question in questions])
            if target is not None:
                echo(f"wrote {target.path / 'report.html'}")


def _run_record(run: FinishedRun, path: Path, record: dict[str, Any]) -> dict[str, Any]:
    posterior_hash = runtime.content_hash([path / "posterior.nc"])
    shared = {key: record.get(key) for key in ("model", "seed", "started", "verdict")}
    return {"name": run.name, "folder": str(path), "posterior_hash": posterior_hash, **shared}


def _require_distinct(runs: list[Path]) -> None:
    if len(runs) < 2:
        named = ", ".join(map(str, runs)) or "none"
        raise InputError(_unfit("compare", "at least two folders", _AGAIN, value=named))
    first: dict[Path, Path] = {}
    problems = []
    for path in runs:
        earlier = first.setdefault(path.resolve(), path)
        if earlier is not path:
            another = f"another run than {earlier}"
            problems.append(_unfit(str(path), another, "Name each run once.", value="the same run"))
    refuse(problems)


def _abouts(runs: list[Path]) -> list[dict[str, Any]]:
    """What each run says of itself; all that is wrong is told at once."""
    from bayestissue.report.run_folder import not_a_fit, read_about, require_files
    from bayestissue.results.tables import wrong_in

    def read(path: Path) -> dict[str, Any]:
        record = read_about(path)
        if record["kind"] != "fit":
            raise InputError(not_a_fit(path, record, _AGAIN))
        if lacking := [key for key in ("input_hash", "model") if not record.get(key)]:
            expected = "what every fit writes"
            raise InputError(wrong_in(path / "run.json", expected, _AGAIN, column=lacking[0]))
        require_files(path, ["posterior.nc"])
        return record

    first, *others = abouts = all_of(read, runs)
    hashes = [f"{record['input_hash'][:16]}… (dataset “{record.get('dataset')}”)" for record in abouts]
    if problems := [
        Problem.stated(
            "other-data", str(path / "run.json"), None, "input_hash", words, first=hashes[0], run=runs[0]
        )
        for path, record, words in zip(runs[1:], others, hashes[1:], strict=True)
        if record["input_hash"] != first["input_hash"]
    ]:
        raise InputError(problems)
    return abouts


def _finished(runs: list[Path], abouts: list[dict[str, Any]]) -> list[FinishedRun]:
    import xarray as xr

    from bayestissue.inference.answers.finished import Finished
    from bayestissue.inference.comparing import FinishedRun, observed_by
    from bayestissue.report.run_folder import read_groups

    def read(run: tuple[str, Path, dict[str, Any]]) -> FinishedRun:
        name, path, record = run
        needed = _GROUPS | {"observed_data": (observed_by(record["model"]["likelihood"]),)}
        groups = read_groups(path / "posterior.nc", needed, _AGAIN, of_impacts=_OF_IMPACTS)
        tree = xr.DataTree.from_dict(groups)
        return FinishedRun(name, record["model"], tree, Finished.from_tree(tree, record["model"]))

    return all_of(read, zip(_names(runs), runs, abouts, strict=True))


def _names(runs: list[Path]) -> list[str]:
    """As many of the last parts of each path as it takes to tell the runs apart."""
    paths = [path.resolve().parts for path in runs]
    for count in range(1, max(map(len, paths))):
        names = ["/".join(parts[-count:]) for parts in paths]
        if len(set(names)) == len(names):
            return names
    return [str(path.resolve()) for path in runs]


def print_comparison(comparison: pd.DataFrame, posteriors: pd.DataFrame) -> None:
    """Print the two tables; see `bayestissue.inference.comparing`."""
    import pandas as pd

    from bayestissue.commands.console import SCREEN, echo, explained, line, show, table
    from bayestissue.inference.comparing import OF_OUTCOMES
    from bayestissue.remedies import codes_in

    words = ["model"] + (["data"] if len(comparison["data"].unique()) > 1 else [])
    headings = [
        *("run" if name == "model" else name for name in words),
        *(_HEADINGS.get(k, k) for k in _DIGITS),
    ]
    for scheme, rows in comparison.groupby("scheme", sort=False):
        cells = (
            [
                *(row[k] for k in words),
                *(f"{row[k]:.{d}f}" if pd.notna(row[k]) else "" for k, d in _DIGITS.items()),
            ]
            for row in rows.to_dict("records")
        )
        show(table(str(scheme), headings, cells, words=("run", "data")))
        for row in rows[rows["warning"] != ""].to_dict("records"):
            line(f"  {row['model']}: {row['warning']}")
    explained(codes_in("; ".join(comparison["warning"])))
    people = posteriors[posteriors["label"] != ""]
    few = people["label"].nunique() <= SCREEN.people
    together = posteriors["label"] == ""
    of_outcomes = posteriors["variable"].isin(OF_OUTCOMES)
    shown = posteriors[together | ~of_outcomes] if few else posteriors[together]
    _print_posteriors(shown)
    if count := people["label"].nunique():
        what = "outcomes" if few else "K, C and outcomes"
        echo(f"  {what} of the {count} people: --json prints them, --out writes posteriors.csv")


def print_answers(answers: pd.DataFrame, questions: Collection[str]) -> None:
    """What was asked on the command line: a line of each run."""
    from bayestissue.commands.console import line
    from bayestissue.report.comparison import answer_words

    # A choice has an answer for each level.
    shown = answers[answers["question"].str.startswith(tuple(questions))]
    for question, rows in shown.groupby("question", sort=False):
        line(str(question))
        width = rows["run"].str.len().max()
        for row in rows.to_dict("records"):
            line(f"  {row['run']:{width}}  {answer_words(row)}")


def _print_posteriors(posteriors: pd.DataFrame) -> None:
    """Each quantity with what its intervals are of, and under it a line for each run."""
    from bayestissue.commands.console import line
    from bayestissue.inference.results.meanings import heading_words
    from bayestissue.report.wording import estimated

    line("posteriors: median and 90 % interval", "italic")
    for (variable, level, label, unit), shown in posteriors.groupby(
        ["variable", "of", "label", "unit"], sort=False
    ):
        line(heading_words(str(variable), str(level), str(label)) + ("" if unit == "1" else f" ({unit})"))
        width = shown["run"].str.len().max()
        for row in shown.to_dict("records"):
            median, low, high = estimated(*(row[name] for name in ("median", "eti90_low", "eti90_high")))
            line(f"  {row['run']:{width}}  {median}, {low} to {high}")
