"""Options that are declared once: in a function's signature and docstring."""

from __future__ import annotations

from typing import Annotated

import pytest
import typer
from annotated_types import Ge, Le
from typer.testing import CliRunner

from bayestissue import cli
from bayestissue.commands.delivery import documented
from bayestissue.studies.planning.plan_file import Aim
from bayestissue.studies.simulation.simulation_file import Simulation


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


REPLACES = (
    ("plan", "studies", Aim, "studies"),
    ("plan", "seed", Aim, "seed"),
    ("simulate", "seed", Simulation, "seed"),
)


@pytest.mark.parametrize(("name", "option", "table", "field"), REPLACES)
def test_an_option_has_the_bounds_of_the_setting_that_it_replaces(name, option, table, field) -> None:
    params = typer.main.get_command(cli.app).commands[name].params
    (bounds,) = (one for one in params if one.name == option)
    limits = {type(limit): limit for limit in table.model_fields[field].metadata}
    assert bounds.min == limits[Ge].ge
    # The setting may end before: its own check then says so.
    assert bounds.max in (None, limits[Le].le if Le in limits else None)
