"""`bayestissue model`: a model file that comes with the program, whole and commented."""

from __future__ import annotations

from typing import Annotated

import typer


def run(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE")],
) -> None:
    """Print a model file whole, every key with its meaning, to begin one of your own with.

    `bayestissue model maxwell > mine.toml`. A file need only say how it differs from another: like =
    "maxwell", and the keys that have other values. This prints what such a file comes to.

    Args:
        name: A model that comes with the program, such as impact or maxwell; or a file of your own.
    """
    from bayestissue.commands.console import echo
    from bayestissue.resources import model_file, model_text

    echo(model_text(model_file(name, lambda _: True)).rstrip())
