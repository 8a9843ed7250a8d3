"""Every command of the command line with its arguments and options, as `--help` has them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import typer

from bayestissue.cli import STATUSES, app
from from_program.markdown import code, escaped, paragraphs, table

_KINDS = {"<path>": "PATH", "<str>": "TEXT", "<list[str]>": "TEXT"}
_NUMBER = re.compile(r"<(?:int|float)(?: range)?>")


def commands() -> str:
    """A section for each command."""
    group = typer.main.get_command(app)
    return "\n\n".join(_section(name, command) for name, command in group.commands.items())


def statuses() -> str:
    """What the exit status of a command means."""
    return table(["status", "meaning"], [(str(status), words) for status, words in STATUSES.items()])


def _section(name: str, command: Any) -> str:
    context = command.make_context(name, [], resilient_parsing=True)
    arguments = [each.metavar for each in command.params if each.param_type_name == "argument"]
    usage = " ".join(["bayestissue", name, *arguments, "[OPTIONS]"])
    rows = [_row(each, context) for each in command.params]
    parts = [f"## {name}", paragraphs(command.help), f"```text\n{usage}\n```"]
    return "\n\n".join([*parts, table(["", "default", "meaning"], rows)])


def _row(parameter: Any, context: Any) -> tuple[str, str, str]:
    is_argument = parameter.param_type_name == "argument"
    name = parameter.metavar if is_argument else _option(parameter.get_help_record(context)[0])
    return code(name), _default(parameter), escaped(" ".join(_words(parameter)))


def _option(name: str) -> str:
    for kind, said in _KINDS.items():
        name = name.replace(kind, said)
    return _NUMBER.sub("NUMBER", name)


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    return (
        ""
        if getattr(parameter, "is_flag", False) or parameter.default in (None, "")
        else code(parameter.default)
    )


def _words(parameter: Any) -> Iterator[str]:
    yield parameter.help
    if getattr(parameter, "min", None):
        yield f"At least {parameter.min:g}."
    if parameter.multiple and "repeated" not in parameter.help:
        yield "May be repeated."
