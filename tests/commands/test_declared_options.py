"""Options that are declared once: in a function's signature and docstring."""

from __future__ import annotations

import typer

from bayestissue import cli


def test_every_option_of_the_program_has_a_help() -> None:
    commands = typer.main.get_command(cli.app).commands
    assert {
        (name, option.name)
        for name, one in commands.items()
        for option in one.params
        if option.name != "help" and not option.help
    } == set()
