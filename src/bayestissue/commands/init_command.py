"""`bayestissue init`: a dataset from a folder of recorder files."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin

import typer

from bayestissue.base.declarations import taking
from bayestissue.base.errors import Problem, by_cause, printable, refuse
from bayestissue.commands.delivery import Json, Quiet

if TYPE_CHECKING:
    from bayestissue.recordings.intake import MissingFact
    from bayestissue.studies.init import Intake

_CHAIN = {
    "mass": "relative_mass_sd",
    "velocity": "velocity_sd_m_s",
    "gain": "relative_gain_sd",
    "offset": "offset_sd",
}
# An entry of each table, by its option.
_ENTRIES = {
    **{"given": "mass_kg=2.1", "recorder": "sae_class=180", "text": "decimal=comma"},
    **{"uncertainty": "velocity=0.01", "force": "place=base", "words": "subject=pad"},
}


def _flag(name: str) -> str:
    return "--set" if name == "given" else f"--{name.replace('_', '-')}"


def with_options() -> Callable[..., None]:
    """The command with an option for each argument of `bayestissue.init_dataset`."""
    from bayestissue.recordings.intake import options

    return taking({name: _option(name, *declared) for name, declared in options().items()})(run)


def run(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER")],
    out: Path | None = None,
    overwrite: bool = False,
    quiet: Quiet = False,
    as_json: Json = False,
    **stated: Any,
) -> None:
    """Make a dataset of a folder of recorder files: tables, LabVIEW, MATLAB, C3D and others.

    What the files do not say is asked for at a terminal, or given as options. Files such as
    s01_left_2.5kg_1.lvm, whose names are read as {subject}_{side}_{mass_kg}kg_{n}, dropped from 12 cm:

        bayestissue init recorded --quantity deceleration --unit g --set drop_height_cm=12 --gravity drop
        --uncertainty velocity=0.01

    The recordings are copied as they are; init.html beside them shows what was understood.

    Args:
        folder: Folder of recorder files; nothing in it is changed.
        out: Folder for the dataset, new or empty; that of the recordings with -dataset behind unless given.
            The dataset is called after it.
        **stated: what the files do not say.
    """
    from bayestissue.base.errors import more
    from bayestissue.commands.console import echo, show
    from bayestissue.recordings.intake import choices_of
    from bayestissue.studies.init import default_out, prepare, write

    intake = prepare(folder, choices_of(**{name: _read(name, value) for name, value in stated.items()}))
    silent = quiet or as_json
    if intake.questions and not silent and _at_a_terminal():
        intake = _asked(intake)
    elif intake.guess and not silent:
        echo("\n".join(intake.design()))
    out = out or default_out(folder)
    built = write(intake, out, overwrite=overwrite)
    path = built.dataset.folder or out
    if not silent:
        for problem in by_cause(built.left_out):
            echo(f"left out: {problem} [{problem.code}]")
        show(more(problem.code for problem in built.left_out))
        said = [f"texts read as: {words}" for words in intake.written()]
        said += [f"passed over: {words}" for words in intake.passed_over()]
        echo("\n".join([*said, *built.notes, f"wrote {path}; look at {path / 'init.html'}"]))
    if not quiet:
        from bayestissue.commands import datasets

        datasets.check(dataset=path, as_json=as_json)


def _option(name: str, argument: Parameter, meaning: str) -> tuple[Parameter, str]:
    """The option of an argument: of a table its entries, of a number or word either, else what it is."""
    from bayestissue.base.settings import kinds

    flag, types = _flag(name), kinds(argument.annotation)
    kind, option, meaning = types[0], typer.Option(flag), meaning[:1].upper() + meaning[1:]
    if name in _ENTRIES:
        kind, option = list[str], typer.Option(flag, metavar="KEY=VALUE")
        if name == "uncertainty":
            meaning += f" Short for them are {', '.join(_CHAIN)}."
        meaning += f" An entry such as {_ENTRIES[name]}; may be repeated."
    elif get_origin(kind) is tuple:
        kind, option = tuple[float, float], typer.Option(flag, metavar="START STOP")
    elif len(types) > 1:
        words = "|".join([*get_args(kind), "NUMBER"])
        kind, option = Any, typer.Option(flag, metavar=words, parser=_number_or_word)
    default = None if name in _ENTRIES else argument.default
    kind = kind if kind is bool else kind | None
    return argument.replace(annotation=Annotated[kind, option], default=default), meaning


def _read(name: str, value: Any) -> Any:
    """What an option states; None where it was not given."""
    if name == "force" and value == ["none"]:
        return "none"
    if name not in _ENTRIES:
        return None if value is False else value
    entries = _entries(value or [], _flag(name), _ENTRIES[name])
    if name == "given":
        return entries
    names = _CHAIN if name == "uncertainty" else {}
    return {names.get(key, key): _value(text) for key, text in entries.items()}


def _entries(texts: list[str], option: str, example: str) -> dict[str, str]:
    """What stands behind an option such as ``--set NAME=VALUE``, whose ``example`` is of one, as a table.

    Raises:
        InputError: one has no name or no value, or a name stands there twice.
    """
    form = "NAME=VALUE" if option == "--set" else "KEY=VALUE"
    entries: dict[str, str] = {}
    problems = []
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value) or name in entries:
            words: dict[str, Any] = {"form": form, "option": option, "example": example}
            problems.append(Problem.stated("option-value.fact", option, value=text, **words))
        entries[name] = value
    refuse(problems)
    return entries


def _number_or_word(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def _value(text: str) -> Any:
    """A number, true or false, or words, as TOML has them."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _at_a_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def _asked(intake: Intake) -> Intake:
    from bayestissue.commands.console import echo
    from bayestissue.recordings.intake import MissingFact

    echo("\n".join(intake.listed()), err=True)
    options = []
    while intake.questions:
        question = intake.questions[0]
        text = _answer(question)
        intake = intake.answered(question, text)
        options.append(MissingFact(question.option, "", (), text).line)
    echo(f"The same without questions: {' '.join(options)}", err=True)
    echo("\n".join(intake.design()), err=True)
    typer.confirm("Write the dataset", default=True, abort=True, err=True)
    return intake


def _answer(question: MissingFact) -> str:
    from bayestissue.commands.console import echo

    words = question.what + (f" ({', '.join(question.answers)})" if question.answers else "")
    words = words[0].upper() + words[1:]
    while True:
        text = str(typer.prompt(printable(words), err=True)).strip()
        if text and (not question.answers or text in question.answers):
            return text
        echo(f"expected one of: {', '.join(question.answers)}", err=True)
