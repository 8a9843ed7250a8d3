"""Texts that come with the program: `bayestissue explain` of warnings and errors, `model` of model files."""

from __future__ import annotations

import difflib
import json
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import groupby
from typing import Annotated

import typer

from bayestissue.base.errors import InputError, Problem
from bayestissue.base.remedies import Remedy, entries, retired
from bayestissue.commands.delivery import Json


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
    if unknown := [code for code in codes or () if code not in known]:
        raise InputError(_unknown(code, list(known)) for code in unknown)
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


def _unknown(code: str, known: Sequence[str]) -> Problem:
    near = difflib.get_close_matches(code, known, n=1)
    hint = f"Is it {near[0]}? " if near else ""
    return Problem.stated("option-value.code", "explain", value=code, hint=hint)


def model(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE")],
) -> None:
    """Print a model file whole, every key with its meaning, to begin one of your own with.

    `bayestissue model maxwell > mine.toml`. A file need only say how it differs from another: like =
    "maxwell", and the keys that have other values. This prints what such a file comes to.

    Args:
        name: A model that comes with the program, such as impact or maxwell; or a file of your own.
    """
    from bayestissue.base.resources import model_file, model_text
    from bayestissue.commands.console import echo

    echo(model_text(model_file(name, lambda _: True)).rstrip())
