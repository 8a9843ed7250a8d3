"""Options that are declared once: in a function's signature and docstring."""

from __future__ import annotations

from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from bayestissue import cli
from bayestissue.commands.options import documented


def command(
    where: Annotated[str, typer.Argument(metavar="WHERE")],
    count: Annotated[int, typer.Option(min=1)] = 1,
    in_full: bool = False,
) -> None:
    """What it does.

    Args:
        where: A place, such as
            "a: b".
        count: How often.
        in_full: All of it.
    """
    typer.echo(f"{where} {count} {in_full}")


@pytest.fixture
def app():
    app, (function, words) = typer.Typer(), documented(command)
    app.command("it", help=words)(function)
    return app


def test_a_docstring_is_the_help_of_a_command_and_of_its_options(app) -> None:
    one = typer.main.get_command(app)
    helps = {option.name: option.help for option in one.params}
    assert one.help == "What it does."
    assert helps["where"] == 'A place, such as "a: b".'
    assert helps["count"] == "How often."
    assert helps["in_full"] == "All of it."


def test_types_bounds_and_defaults_are_those_of_the_signature(app) -> None:
    run = CliRunner().invoke
    assert run(app, ["here", "--in-full"]).output == "here 1 True\n"
    assert run(app, ["here", "--no-in-full"]).exit_code == 2
    assert run(app, ["here", "--count", "0"]).exit_code == 2


def test_every_option_of_the_program_has_a_help() -> None:
    commands = typer.main.get_command(cli.app).commands
    assert {
        (name, option.name)
        for name, one in commands.items()
        for option in one.params
        if option.name != "help" and not option.help
    } == set()
