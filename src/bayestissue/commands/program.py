"""Commands that need no data of yours: `explain` and `model` print, `selftest` and `reproduce` verify."""

from __future__ import annotations

import difflib
import json
import shutil
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayestissue.base import resources, runtime
from bayestissue.base.errors import Problem, more, refuse
from bayestissue.base.remedies import Remedy, entries, retired
from bayestissue.base.result import Made
from bayestissue.base.results.files import write_json, write_tree
from bayestissue.commands.delivery import Call, Json, Model, Seed, delivers

if TYPE_CHECKING:
    from bayestissue.commands.console import Shown


def explain(
    codes: Annotated[list[str] | None, typer.Argument(metavar="[CODE]...")] = None,
    as_json: Json = False,
) -> None:
    """What a warning or an error means, what it does to K and C, and what to do.

    Args:
        codes: As messages end with, or names that are gone, such as excel; all codes are listed unless given.
    """
    from bayestissue.commands.console import echo

    known = entries() | _retired_names()
    problems = []
    for code in codes or ():
        if code not in known:
            hint = "".join(f"Is it {near}? " for near in difflib.get_close_matches(code, known, n=1))
            problems.append(Problem.stated("option-value.code", "explain", value=code, hint=hint))
    refuse(problems)
    chosen = [known[code] for code in codes or ()] or list(entries().values())
    if as_json:
        echo(json.dumps([asdict(entry) for entry in chosen], ensure_ascii=False))
    elif codes:
        echo("\n\n".join("\n".join(_lines(entry)) for entry in chosen))
    else:
        echo("\n".join(_list(chosen)))


def _lines(entry: Remedy) -> Iterator[str]:
    from bayestissue.commands.console import SCREEN

    filled = partial(textwrap.fill, width=SCREEN.width, initial_indent="    ")
    yield f"{entry.code}: {entry.title}"
    for heading, text in entry.parts:
        yield f"\n  {heading}"
        yield filled(text, subsequent_indent="    ")
    for kind, names in retired().items() if entry.code == "retired" else ():
        for name, instead in names.items():
            yield filled(f"{kind} {name}: {instead}", subsequent_indent="      ")


def _retired_names() -> dict[str, Remedy]:
    """By each name that is gone, an option's without dashes: the entry of all, with its own remedy."""
    entry = entries()["retired"]
    return {
        name.rpartition("--")[2]: replace(
            entry, code=name, title=f"a {kind} of an earlier version", remedy=instead
        )
        for kind, names in retired().items()
        for name, instead in names.items()
    }


def _list(chosen: Sequence[Remedy]) -> Iterator[str]:
    width = max(len(entry.code) for entry in chosen)
    for title, group in groupby(chosen, key=lambda entry: entry.group):
        yield title
        yield from (f"  {entry.code:{width}}  {entry.title}" for entry in group)
        yield ""
    yield "bayestissue explain CODE says what one means, what it does to K and C, and what to do."


def model(name: Annotated[str, typer.Argument(metavar="NAME|FILE")]) -> None:
    """Print a model file whole, every key with its meaning, to begin one of your own with.

    `bayestissue model maxwell > mine.toml`. A file need only say how it differs from another: like =
    "maxwell", and the keys that have other values. This prints what such a file comes to.

    Args:
        name: A model that comes with the program, such as impact or maxwell; or a file of your own.
    """
    from bayestissue.commands.console import echo

    echo(resources.model_text(resources.model_file(name, lambda _: True)).rstrip())


def _verdict(result: Made) -> Iterator[Shown]:
    from bayestissue.commands.console import Grid
    from bayestissue.reports.pages.page_tables import shown

    findings = result.tables["selftest"]
    failed = findings[findings["passed"] == 0]
    if len(failed):
        yield Grid("what failed", shown("selftest", failed, "failed"))
    yield result.about["verdict"]["words"]


@delivers(out=Path("selftest"), verdict=_verdict)
def selftest(thorough: bool = False, *, call: Call) -> Made:
    """Test the installed program on this machine: two minutes, no data of yours, one line of verdict.

    Numbers that others published, campaigns with a known truth, a file of each recorder format, and a fit
    that is killed and goes on. What it finds stands in selftest.md, which you can attach to a paper.

    Args:
        out: Folder for what was found; the files of the test are made beside it, in the place where your
            results are to lie, and removed.
        thorough: More models recovered, and a calibration of six hundred impacts: ten minutes.
    """
    from bayestissue.studies.selftest.selftest_checks import as_markdown, machine, self_test, verdict

    start, work = runtime.CommandStart(), call.parts("selftest")
    # Nothing of a test that was ended counts.
    shutil.rmtree(work)
    work.mkdir()
    try:
        findings = self_test(work, thorough=thorough, say=call.say)
    finally:
        shutil.rmtree(work)
    passed, words = verdict(findings)
    judged = {"passed": passed, "words": words}
    record = start.record("selftest", "selftest", thorough=thorough, machine=machine(), verdict=judged)

    def write(folder: Path) -> None:
        (folder / "selftest.md").write_text(as_markdown(findings, record), encoding="utf-8")

    return Made(record, {"selftest": findings}, write, passed=passed, files=("selftest.md",))


@delivers(inputs=("model",))
def reproduce(model: Model = None, seed: Seed = 0, *, call: Call) -> Made:
    """Recompute, audit and re-analyse the thesis's published estimates, and write the report.

    Args:
        model: Model of the re-analysis; published unless given.
    """
    from bayestissue.inference.checking.findings import verdict_in_words, warned_codes
    from bayestissue.model.hierarchy.specification import read_specification
    from bayestissue.recordings.dataset.published import read_published
    from bayestissue.thesis.audit import audit_published
    from bayestissue.thesis.published_page import published_page
    from bayestissue.thesis.reanalysis.analysis import analyse, competing_designs
    from bayestissue.thesis.reanalysis.observations import published_design, published_observations
    from bayestissue.thesis.reproduction import reproduce_published

    start, say = runtime.CommandStart(), call.say
    file = resources.model_file(
        "published" if model is None else model,
        lambda content: content.get("likelihood") == "published-estimates",
    )
    specification = read_specification(file)
    tables = read_published()
    observations = published_observations(tables)
    design = published_design(observations, specification, source=str(file))
    competing = competing_designs(observations, specification, str(file))
    say("recomputing what was published", 0, 1)
    reproduction = reproduce_published(tables)
    say("auditing the publication", 0, 1)
    audit = audit_published(tables, reproduction)
    analysis = analyse(observations, design, competing, specification, seed, say)
    agrees = reproduction["agrees"].astype("string").str.lower()
    words, passed = verdict_in_words(analysis.diagnostics), analysis.diagnostics["passed"]
    record = start.record(
        "reproduce",
        "published",
        model=specification.model_dump(mode="json") | design.resolved(),
        terms_left_out=design.terms_left_out(),
        seed=seed,
        input_hash=runtime.content_hash([*tables.paths, file]),
        verdict={"passed": passed, "words": words},
    )

    def write(folder: Path) -> None:
        write_tree(analysis.tree, folder / "posterior.nc")
        write_json(analysis.diagnostics, folder / "diagnostics.json")

    return Made(
        record,
        {"reproduction": reproduction.assign(agrees=agrees), "audit": audit, **analysis.tables},
        write,
        partial(published_page, record=record),
        passed,
        words=[words, more(warned_codes(analysis.diagnostics))],
    )
