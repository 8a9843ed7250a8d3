"""`bayestissue init`: a dataset from a folder of recorder files."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

import typer

from bayestissue.commands.console import echo, explained
from bayestissue.errors import InputError, Problem, by_cause, printable
from bayestissue.intake import Choices, Cutting, Intake, Question, default_out, prepare, write

_CHAIN = {
    "mass": "relative_mass_sd",
    "velocity": "velocity_sd_m_s",
    "gain": "relative_gain_sd",
    "offset": "offset_sd",
}


def run(
    folder: Path,
    *,
    out: Path | None,
    choices: Choices,
    name: str,
    cutting: Cutting | None,
    skip_bad: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Make a dataset of a folder of recorder files, ask at a terminal for what is not known, and check it.

    Writes ``dataset.toml``, ``impacts.csv``, the recordings as they are, and ``init.html``.

    Raises:
        InputError: something is wrong, or is not known and there is no terminal to ask at.
    """
    intake = prepare(folder, choices)
    if intake.questions and not quiet and not as_json and _at_a_terminal():
        intake = _asked(intake)
    elif intake.guess and not quiet and not as_json:
        echo("\n".join(intake.design()))
    out = out or default_out(folder)
    built = write(intake, out, name=name, cutting=cutting, skip_bad=skip_bad, overwrite=overwrite)
    path = built.dataset.folder or out
    if not quiet and not as_json:
        for problem in by_cause(built.left_out):
            echo(f"left out: {problem} [{problem.code}]")
        explained(problem.code for problem in built.left_out)
        for words in intake.written():
            echo(f"texts read as: {words}")
        for note in built.notes:
            echo(note)
        echo(f"wrote {path}; look at {path / 'init.html'}")
    if not quiet:
        from bayestissue.commands import check

        check.run(path, out=None, skip_bad=False, overwrite=False, quiet=False, as_json=as_json)


def given(
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
    found: dict[str, str] = {}
    problems = []
    for text in facts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value) or name in found:
            expected = f"{form}, each name once"
            remedy = f"Write, say, {option} {example}."
            problems.append(Problem(option, expected, remedy, value=text, code="option-value"))
        found[name] = value
    if problems:
        raise InputError(problems)
    return found


def entries(texts: list[str], option: str, example: str) -> dict[str, Any]:
    """Options such as ``--recorder KEY=VALUE`` as a table of TOML: numbers, true or false, words.

    Args:
        texts: behind the option.
        option: which one it is.
        example: of such a text.

    Raises:
        InputError: one has no key or no value, or a key stands there twice.
    """
    found = given(texts, option, "KEY=VALUE", example)
    return {key: _value(text) for key, text in found.items()}


def uncertainty(texts: list[str]) -> dict[str, Any]:
    """The options ``--uncertainty NAME=SD``, by the keys of ``[uncertainty]`` or their first words."""
    return {_CHAIN.get(key, key): sd for key, sd in entries(texts, "--uncertainty", "velocity=0.01").items()}


def gravity(text: str | None) -> str | float | None:
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
    words = question.what + (f" ({', '.join(question.answers)})" if question.answers else "")
    words = words[0].upper() + words[1:]
    while True:
        text = str(typer.prompt(printable(words), err=True)).strip()
        if text and (not question.answers or text in question.answers):
            return text
        echo(f"expected one of: {', '.join(question.answers)}", err=True)
