"""``plan``: how many people, masses and impacts a study needs, before anyone is hit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayestissue.base.errors import InputError, all_of, more
from bayestissue.base.outline import counted
from bayestissue.base.remedies import codes_in
from bayestissue.base.words import Words
from bayestissue.commands.delivery import Call, FormulaOfC, FormulaOfK, Model, OtherSeed, delivers
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS

if TYPE_CHECKING:
    from bayestissue.commands.console import Shown
    from bayestissue.studies.planning.plan import Plan
    from bayestissue.studies.planning.plan_file import PlanSpecification


def _of_plan(plan: Plan) -> Iterator[Shown]:
    from bayestissue.base.outline import numbers_in_short
    from bayestissue.commands.console import Grid
    from bayestissue.reports.pages.page import worded
    from bayestissue.reports.pages.page_tables import table_of_cells
    from bayestissue.reports.pages.wording import nouns_of_plan, with_error

    designs = plan.content["designs"]
    goals = [name.replace("_", " ") for name in designs[0]["goals"]]
    recorders = ["recorder"] if designs[0]["recorder"] else []
    people = nouns_of_plan(plan.content)("people")
    headings = ["kg", "m/s", "repeats", *recorders, "takes", *goals]
    rows = [
        (
            str(design["people"]),
            *(numbers_in_short(design[name].split()) for name in ("masses_kg", "velocities_m_s")),
            str(design["repeats"]),
            *(design[name] for name in recorders),
            worded("plan", "duration", design["minutes"]),
            *(with_error(goal["answered"], goal["se"]) for goal in design["goals"].values()),
        )
        for design in designs
    ]
    table = table_of_cells(rows, people, *headings, number=headings)
    yield Grid(f"{plan.content['plan']['name']}: the probability of an answer", table)
    yield plan.answer
    yield plan.content["warning"]
    yield more(codes_in(plan.content["warning"]))


@delivers("as_json", inputs=("file", "model", "after", "dataset"), shown=_of_plan)
def plan(
    file: Annotated[Path | None, typer.Argument(metavar="PLAN.toml")] = None,
    people: Annotated[str | None, typer.Option(metavar="NUMBERS")] = None,
    masses: Annotated[list[str] | None, typer.Option(metavar="KG")] = None,
    velocities: Annotated[list[str] | None, typer.Option(metavar="M_S")] = None,
    repeats: Annotated[str | None, typer.Option(metavar="NUMBERS")] = None,
    within: Annotated[list[str] | None, typer.Option(metavar="NAME=LEVELS")] = None,
    groups: Annotated[list[str] | None, typer.Option(metavar="NAME=LEVELS")] = None,
    ask: Annotated[list[str] | None, typer.Option(metavar="CLAIM")] = None,
    model: Model = None,
    K: FormulaOfK = None,
    C: FormulaOfC = None,
    after: Annotated[Path | None, typer.Option(metavar="RUN")] = None,
    dataset: Annotated[Path | None, typer.Option(metavar="DATASET")] = None,
    studies: Annotated[int | None, typer.Option(min=SETTINGS.block)] = None,
    seed: OtherSeed = None,
    *,
    call: Call,
) -> Plan:
    """How many people, masses and impacts it takes to answer a question, before anyone is hit.

    Studies of each design are drawn from what is believed of people and tissue. Each is analysed as `fit`
    will analyse the real one, and its questions are asked. The share of studies that answer is the design's
    assurance. The cheapest design that reaches the wanted assurance is chosen. Beliefs, costs, losses, the
    recorder, and how well a number is to be known are tables of a plan file; without one they are typical.

    With --overwrite a plan goes on from the studies that --out holds: more --studies, or further designs in
    PLAN.toml, take the time of what is new. So does an interrupted one when the same command is given again.

    Args:
        file: The plan; without it the options say what is planned.
        people: How many are recruited; 10,20,30 compares three.
        masses: The masses that each person is hit by, such as 0.5,1; given again it is compared.
        velocities: Velocities at contact, in the same way; 1.5 unless given.
        repeats: Impacts of each person by each mass; 1,3 compares two; 1 unless given.
        within: What each person is hit at every level of, such as side=left,right. Without this and --groups
            it is what questions name.
        groups: Groups that people belong to, as many people each, such as sex=f,m.
        ask: What is to be decided, such as "K[side=left] / K[side=right] > 1.1"; may be given again.
        K: What log K depends on, as `fit` takes it; as the model has it unless given.
        after: The fit of a study that has begun: what is planned is still to come.
        dataset: The recordings that were fitted, beside --after.
        studies: Studies that are drawn of each design, a multiple of 100; 500 unless the plan says.
        seed: Instead of the plan's.
    """
    from bayestissue.studies.planning.plan import carry_out, known_studies, with_changes
    from bayestissue.studies.planning.planned_study import study_of

    options = {"--people": people, "--masses": masses, "--velocities": velocities, "--repeats": repeats}
    options |= {"--within": within, "--groups": groups, "--ask": ask}
    options |= {"--model": model, "--K": K, "--C": C}
    stated, source = _specification(file, options)
    stated = with_changes(stated, source, "after", run=after, dataset=dataset)
    stated = with_changes(stated, source, "goal", studies=studies, seed=seed)
    study = study_of(stated, source)
    for words in () if file else (*_compared(options), *_factors(stated, Words(study.words))):
        call.echo(words)
    assert call.out is not None  # noqa: S101 - it is required
    # Studies are kept by what they depend on, so that those of another plan do no harm.
    return carry_out(study, say=call.say, known=known_studies(call.out), parts=call.parts("plan"))


def _specification(file: Path | None, options: dict[str, Any]) -> tuple[PlanSpecification, str]:
    """The plan of a file, or of options, and what messages call it."""
    from bayestissue.studies.planning.plan import content_of
    from bayestissue.studies.planning.plan_file import plan_of, read_plan

    named = [option for option, value in options.items() if value]
    if file is not None:
        if named:
            raise InputError.stated("impossible-plan.both", "command line", None, named[0], option=named[0])
        return read_plan(file), str(file)
    if missing := [option for option in ("--people", "--masses", "--ask") if not options[option]]:
        raise InputError.stated("impossible-plan.none", "command line", None, missing[0])
    read: list[Callable[[], Any]] = [
        lambda: _numbers(options["--people"], "--people", int, "10,20,30"),
        lambda: [_numbers(text, "--masses", float, "0.5,1") for text in options["--masses"]],
        lambda: [_numbers(text, "--velocities", float, "1.5") for text in options["--velocities"] or ["1.5"]],
        lambda: _numbers(options["--repeats"] or "1", "--repeats", int, "1,3"),
        lambda: _levels(options["--within"], "--within", "side=left,right"),
        lambda: _levels(options["--groups"], "--groups", "sex=f,m"),
    ]
    people, masses, velocities, repeats, within, groups = all_of(lambda part: part(), read)
    lists = {"people": people, "masses_kg": masses, "velocities_m_s": velocities, "repeats": repeats}
    settings = {"model": options["--model"], "K": options["--K"], "C": options["--C"]}
    content = content_of(lists, options["--ask"], within=within, groups=groups, **settings)
    return plan_of(content, "command line"), "command line"


def _numbers(text: str, option: str, kind: type[int] | type[float], example: str) -> list[float]:
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        words = {"option": option, "example": example, "above": " that are whole" if kind is int else ""}
        raise InputError.stated("option-value.numbers", "command line", None, option, text, **words) from None


def _levels(texts: Sequence[str] | None, option: str, example: str) -> dict[str, list[str]] | None:
    """Levels by the name of their factor; None where none are given."""
    levels = {}
    for text in texts or ():
        name, _, values = text.partition("=")
        levels[name.strip()] = [value.strip() for value in values.split(",") if value.strip()]
        if not name.strip() or len(levels[name.strip()]) < 2:
            words = {"option": option, "example": example}
            raise InputError.stated("option-value.levels", "command line", None, option, text, **words)
    return levels or None


def _compared(options: Mapping[str, Any]) -> Iterator[str]:
    """What several options of one value each mean, which others take for one design of all of them."""
    for option, noun in (("--masses", "mass"), ("--velocities", "velocity")):
        values = options[option] or []
        if len(values) > 1 and not any("," in value for value in values):
            together = f"write {option} {','.join(values)}"
            yield f"{counted(len(values), 'design')} of one {noun} each; for one design of all, {together}"


def _factors(plan: PlanSpecification, nouns: Words) -> Iterator[str]:
    """Factors at whose every level each person is hit, where they are not groups of people."""
    for factor in plan.candidates.factors:
        if factor.within:
            sentence, groups = nouns("each person is hit at"), nouns("of groups of people write")
            levels = " and ".join(factor.levels)
            option = f"--groups {factor.name}={','.join(factor.levels)}"
            yield f"{factor.name}: {sentence} {levels}; {groups} {option}"
