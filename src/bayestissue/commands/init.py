"""`bayestissue init`: a dataset from a folder of recorder files."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from bayestissue.commands.delivery import Json, Overwrite, Quiet, SkipBad
from bayestissue.errors import Problem, by_cause, printable, refuse

if TYPE_CHECKING:
    from bayestissue.intake import Intake, Question

_CHAIN = {
    "mass": "relative_mass_sd",
    "velocity": "velocity_sd_m_s",
    "gain": "relative_gain_sd",
    "offset": "offset_sd",
}


def run(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER")],
    out: Path | None = None,
    pattern: Annotated[str | None, typer.Option(metavar="PATTERN")] = None,
    table: Annotated[Path | None, typer.Option(metavar="FILE.csv")] = None,
    shared: Annotated[list[str] | None, typer.Option("--set", metavar="NAME=VALUE")] = None,
    channel: str | None = None,
    quantity: Literal["deceleration", "acceleration", "displacement"] | None = None,
    unit: str | None = None,
    scale: float = 1.0,
    offset: float = 0.0,
    time: str | None = None,
    time_unit: str | None = None,
    rate_hz: Annotated[float | None, typer.Option(min=0)] = None,
    crop: Annotated[tuple[float, float] | None, typer.Option(metavar="START STOP")] = None,
    recorder: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE")] = None,
    text: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE")] = None,
    uncertainty: Annotated[list[str] | None, typer.Option(metavar="NAME=SD")] = None,
    force: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE|none")] = None,
    gravity: Annotated[str | None, typer.Option(metavar="none|drop|M_S2")] = None,
    zero: Literal["free_fall", "rest"] | None = None,
    contact: Literal["on_sample", "between"] | None = None,
    several: bool = False,
    threshold: Annotated[float, typer.Option(min=1)] = 20.0,
    separation_s: Annotated[float, typer.Option(min=0.001)] = 0.5,
    name: str = "",
    skip_bad: SkipBad = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
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
        pattern: How file names are read; guessed from the names unless given. A name in braces is a column of
            impacts.csv; {} is what does not matter. mass_g, velocity_cm_s, drop_height_m, _cm and _mm are
            converted (v = sqrt(2 g h), for a pendulum too). {subject:group} counts
            anew in each group. With / the folders above the file are read as well.
        table: A table with a column file, the name of a recording, and a column for each fact; with a column
            number too, a row for each impact of a recording. Without file it is joined by the columns that
            names have too, such as subject.
        shared: A fact that holds for all recordings; may be repeated.
        channel: The channel with the values.
        quantity: What it recorded; a deceleration is positive while it slows.
        unit: Its unit, such as "m/s^2", g or mm, after scale and offset.
        scale: Raw values are multiplied by it.
        offset: Added to them after that.
        time: The channel with the times, if the format has no clock.
        time_unit: Its unit; s unless stated.
        rate_hz: The sampling rate, where there are no times.
        crop: The stretch of every recording that is read, in its unit of time.
        recorder: An entry of the table [recorder], a known low-pass that the recordings went through:
            low_pass_hz, order, kind, zero_phase, or sae_class; noise, applied; may be repeated.
        text: How text files are written, where that is not found rightly: encoding (utf-8, utf-16, cp1252),
            delimiter (comma, semicolon, tab, pipe, space), decimal (point, comma), thousands (none, point,
            comma, space, apostrophe), header_row, units_row; may be repeated.
        uncertainty: How well the measuring chain is known, as a standard deviation: mass and gain as a
            fraction, velocity in m/s, offset in m/s^2, such as velocity=0.01; may be repeated.
        force: An entry of the table [[channel]] of a force beside the motion: value_column, place
            (impactor or base), unit, scale, tip_mass_kg, relative_gain_sd, time_column, time_offset_s; may be
            repeated. The only channel with a unit of force is taken unless given; none leaves it out.
        gravity: The part of gravity along the motion: none (a pendulum at its lowest point), drop (straight
            down), or a number of m/s², positive into the tissue. Asked for where a drop height is given.
        zero: Where an accelerometer read 0; in free fall unless stated.
        contact: Where contact falls: on a sample, of a recorder that contact triggers and of recordings cut
            there, or between two, of one that samples at its own pace. All recordings together tell unless
            given.
        several: Cut several impacts in one recording apart.
        threshold: Standard deviations of the noise an impact rises above.
        separation_s: The least time between two impacts, s.
        name: Name of the dataset; the folder's if not given.
    """
    from bayestissue.commands.console import echo, show
    from bayestissue.errors import more
    from bayestissue.intake import Choices, Cutting, default_out, prepare, write

    choices = Choices(
        channel=channel, quantity=quantity, unit=unit, time=time, time_unit=time_unit, rate_hz=rate_hz,
        scale=scale, offset=offset, crop=crop, pattern=pattern, table=table, zero=zero, contact=contact,
        gravity=_gravity(gravity),
        shared=_facts(shared or []),
        recorder=_entries(recorder or [], "--recorder", "sae_class=180"),
        text=_entries(text or [], "--text", "decimal=comma"),
        uncertainty=_uncertainty(uncertainty or []),
        force="none" if force == ["none"] else _entries(force or [], "--force", "place=base"),
    )  # fmt: skip
    intake = prepare(folder, choices)
    if intake.questions and not quiet and not as_json and _at_a_terminal():
        intake = _asked(intake)
    elif intake.guess and not quiet and not as_json:
        echo("\n".join(intake.design()))
    out = out or default_out(folder)
    cutting = Cutting(threshold, separation_s) if several else None
    built = write(intake, out, name=name, cutting=cutting, skip_bad=skip_bad, overwrite=overwrite)
    path = built.dataset.folder or out
    if not quiet and not as_json:
        for problem in by_cause(built.left_out):
            echo(f"left out: {problem} [{problem.code}]")
        show(more(problem.code for problem in built.left_out))
        for words in intake.written():
            echo(f"texts read as: {words}")
        for words in intake.passed_over():
            echo(f"passed over: {words}")
        for note in built.notes:
            echo(note)
        echo(f"wrote {path}; look at {path / 'init.html'}")
    if not quiet:
        from bayestissue.commands import datasets

        datasets.check(dataset=path, as_json=as_json)


def _facts(
    facts: list[str], option: str = "--set", form: str = "NAME=VALUE", example: str = "mass_kg=2.1"
) -> dict[str, str]:
    """The options ``--set NAME=VALUE`` as a dictionary.

    Args:
        facts: the texts behind the option.
        option: which one it is.
        form: of such a text, in words.
        example: of one.

    Raises:
        InputError: one has no name or no value, or a name stands there twice.
    """
    facts_by_name: dict[str, str] = {}
    problems = []
    for text in facts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value) or name in facts_by_name:
            words: dict[str, Any] = {"form": form, "option": option, "example": example}
            problems.append(Problem.stated("option-value.fact", option, value=text, **words))
        facts_by_name[name] = value
    refuse(problems)
    return facts_by_name


def _entries(texts: list[str], option: str, example: str) -> dict[str, Any]:
    """Options such as ``--recorder KEY=VALUE`` as a table of TOML: numbers, true or false, words.

    Args:
        texts: behind the option.
        option: which one it is.
        example: of such a text.

    Raises:
        InputError: one has no key or no value, or a key stands there twice.
    """
    texts_by_key = _facts(texts, option, "KEY=VALUE", example)
    return {key: _value(text) for key, text in texts_by_key.items()}


def _uncertainty(texts: list[str]) -> dict[str, Any]:
    """The options ``--uncertainty NAME=SD``, by the keys of ``[uncertainty]`` or their first words."""
    return {_CHAIN.get(key, key): sd for key, sd in _entries(texts, "--uncertainty", "velocity=0.01").items()}


def _gravity(text: str | None) -> str | float | None:
    """The option ``--gravity``: a word, or a number of m/s²."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _at_a_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def _asked(intake: Intake) -> Intake:
    from bayestissue.commands.console import echo
    from bayestissue.intake import Question

    echo("\n".join(intake.listed()), err=True)
    options = []
    while intake.questions:
        question = intake.questions[0]
        text = _answer(question)
        intake = intake.answered(question, text)
        options.append(Question(question.option, "", (), text).line)
    echo(f"The same without questions: {' '.join(options)}", err=True)
    echo("\n".join(intake.design()), err=True)
    typer.confirm("Write the dataset", default=True, abort=True, err=True)
    return intake


def _answer(question: Question) -> str:
    from bayestissue.commands.console import echo

    words = question.what + (f" ({', '.join(question.answers)})" if question.answers else "")
    words = words[0].upper() + words[1:]
    while True:
        text = str(typer.prompt(printable(words), err=True)).strip()
        if text and (not question.answers or text in question.answers):
            return text
        echo(f"expected one of: {', '.join(question.answers)}", err=True)
