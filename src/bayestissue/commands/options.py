"""What a command's function says of its options, and those that several commands have."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from bayestissue import runtime
from bayestissue.declarations import described

# The exit status of what finished, but whose sampler's diagnostics failed.
FAILED_DIAGNOSTICS = 3
DatasetFolder = Annotated[
    Path, typer.Argument(help="Folder with dataset.toml, impacts.csv and the traces.", metavar="DATASET")
]
Out = Annotated[Path, typer.Option("--out", help="Folder for the results; it must be new or empty.")]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace what --out holds, if that is results of bayestissue and nothing else.",
    ),
]


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Port = Annotated[
    int,
    typer.Option("--port", help="Of the page on this machine; a free one unless given.", min=0, max=65535),
]
FormulaOfC = Annotated[
    str | None, typer.Option("--C", metavar="FORMULA", help="The same of log C; that of --K unless given.")
]
Json = Annotated[bool, typer.Option("--json", help="Print the table as JSON.")]
SkipBad = Annotated[
    bool, typer.Option("--skip-bad", help="Go on with the good impacts and list what was left out.")
]
# As text: a path would lose the "./" that tells a file from the program's model of that name.
Model = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME|FILE",
        help="What is believed and sampled: the name of a model that comes with the program (impact of "
        "recorded decelerations and accelerations and arma of displacements unless given; maxwell ...), from "
        "any folder, or a file of your own. A name means the program's model; write ./NAME for a file that "
        "is called so.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="A running Dask scheduler, such as tcp://host:8786. Its workers compute what is done impact by "
        "impact, where there are hundreds.",
    ),
]
FinishedFit = Annotated[
    Path, typer.Argument(help="Folder of a finished run of `bayestissue fit`.", metavar="RUN")
]
Seed = Annotated[
    int, typer.Option("--seed", help="Same seed, same machine: same numbers.", min=0, max=runtime.MOST_SEED)
]
# Instead of the one that a file of the command states.
OtherSeed = Annotated[int | None, typer.Option("--seed", min=0, max=runtime.MOST_SEED)]


def documented(command: Callable[..., None]) -> tuple[Callable[..., None], str]:
    """The function of a command with the help of each option, and the help of the command itself.

    Both are its docstring: what stands under ``Args:`` is an option's help, the rest the command's. An option
    is so declared once: its name, type and default in the signature, its meaning in the docstring. What else
    there is of it, such as bounds or another name, is `typer.Option` in its annotation; a bool is a flag.
    """
    words, helps = described(command.__doc__, "Args")
    signature = inspect.signature(command, eval_str=True)
    options = [
        _with_help(option, helps[option.name]) if option.name in helps else option
        for option in signature.parameters.values()
    ]
    command.__signature__ = signature.replace(parameters=options)  # type: ignore[attr-defined]
    return command, words


def _with_help(option: inspect.Parameter, text: str) -> inspect.Parameter:
    """A parameter whose annotation says what typer is to say of it."""
    annotated = hasattr(option.annotation, "__metadata__")
    kind, *stated = get_args(option.annotation) if annotated else (option.annotation,)
    flag = [f"--{option.name.replace('_', '-')}"] if kind is bool else []
    stated_option: Any = copy(stated[0]) if stated else typer.Option(*flag)
    stated_option.help = text
    return option.replace(annotation=Annotated[kind, stated_option])
