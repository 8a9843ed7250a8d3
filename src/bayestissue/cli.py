"""The command line: which commands there are, and what ends one before it is done.

A command with its options is a function of a module of `bayestissue.commands`. These modules import what is
heavy within their functions, so that `--help` answers at once.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, NoReturn

import typer
import typer.core

from bayestissue.base import runtime, stopping
from bayestissue.base.declarations import described
from bayestissue.base.errors import InputError, PartialResultError, Problem, by_cause, more, printable
from bayestissue.base.outline import counted
from bayestissue.commands import datasets, delivery, finished_runs, init_command, live, plan_command, program

# Of the process, and what each means.
STATUSES = {
    0: "done",
    1: "whoever read the output closed it",
    2: "the input is wrong, nothing written",
    delivery.FAILED_DIAGNOSTICS: "finished, but the sampler's diagnostics failed, or a check of `selftest` "
    "or `certify`",
    4: "the results are written, but not their page, as the message says",
    5: "the machine failed (a full disk, say), nothing kept but what the message names",
    stopping.INTERRUPTED: "interrupted",
}


class _Command(typer.core.TyperCommand):
    """A command that says of an option, or its value, of an earlier version what to use instead."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        known = {name for option in self.get_params(ctx) for name in option.opts}
        for arg, following in pairwise([*args, ""]):
            name, _, value = arg.partition("=")
            for gone in (f"{self.name} {name}", name) if name.startswith("--") and name not in known else ():
                _refuse_retired("option", gone)
            _refuse_retired("option", f"{self.name} {name} {value or following}")
        return super().parse_args(ctx, args)


class _Init(_Command):
    """`init`, whose options come from what dataset.toml may say, which is read when they are asked for."""

    @cached_property
    def _whole(self) -> Any:
        app = typer.Typer(add_completion=False)
        function, words = delivery.documented(init_command.with_options())
        app.command(self.name, help=words)(function)
        return typer.main.get_command(app)

    @property
    def params(self) -> Any:
        return self._whole.params

    @params.setter
    def params(self, _: object) -> None:
        """Those of a command without options."""

    def invoke(self, ctx: Any) -> Any:
        return self._whole.invoke(ctx)


class _Commands(typer.core.TyperGroup):
    """The commands; one of an earlier version says what to use instead."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        _refuse_retired("command", args[0])
        return super().resolve_command(ctx, args)


def _refuse_retired(kind: str, name: str) -> None:
    if problem := Problem.of_retired(kind, name, "bayestissue"):
        raise InputError(problem)


app = typer.Typer(
    name="bayestissue",
    cls=_Commands,
    help="Stiffness K and damping C of soft tissue from the recorded deceleration of an impact: "
    "what they are, how sure one can be, and whether their dependence on mass is real.",
    epilog=f"Exit status: {'; '.join(f'{status} {words}' for status, words in STATUSES.items())}.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

_FAILED = more(["machine-failed"])

_COMMANDS: dict[str, Callable[..., None]] = {
    **{"plan": plan_command.plan, "init": init_command.run, "check": datasets.check},
    **{"simulate": datasets.simulate, "estimate": datasets.estimate, "model": program.model},
    **{"fit": datasets.fit, "reproduce": program.reproduce, "report": finished_runs.report},
    **{"compare": finished_runs.compare, "ask": finished_runs.ask, "predict": finished_runs.predict},
    **{"export": finished_runs.export, "watch": live.watch, "open": live.open_, "explain": program.explain},
    **{"selftest": program.selftest, "certify": finished_runs.certify},
}
for name, command in _COMMANDS.items():
    if command is init_command.run:
        app.command(name, cls=_Init, help=described(command.__doc__, "Args")[0])(lambda: None)
        continue
    function, words = delivery.documented(command)
    app.command(name, cls=_Command, help=words)(function)


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"bayestissue {installed('bayestissue')}")
        raise typer.Exit


def main() -> None:
    """Run the command line; what ends it before it is done is one line on standard error and a status."""
    runtime.quieten_libraries()
    runtime.keep_compiled()
    # BLAS keeps to the thread that calls it, in worker processes too: chains have a thread each.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        try:
            app()
        finally:
            _flush()
    except InputError as error:
        _leave(2, _problems(error), *getattr(error, "__notes__", ()))
    except PartialResultError as error:
        _leave(4, str(error), more([error.code]))
    except BrokenPipeError:
        # Whoever read the output has seen enough.
        _leave(1)
    except OSError as error:
        said = f"could not go on: {error.filename or 'standard output'}: {error.strerror or error}"
        _leave(5, said, *getattr(error, "__notes__", ()), _FAILED)
    except MemoryError as error:
        _leave(5, "could not go on: there is not enough memory", *getattr(error, "__notes__", ()), _FAILED)


def _leave(status: int, *said: str) -> NoReturn:
    with suppress(OSError):
        for line in said:
            typer.echo(printable(line, lines=True), err=True)
    try:
        _flush()
    except OSError:
        # What can't be written would be tried once more at the very end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(status)


def _flush() -> None:
    # Without a standard output there is nothing to flush.
    if sys.stdout is not None:
        sys.stdout.flush()


def _problems(error: InputError) -> str:
    if "--json" in sys.argv:
        return json.dumps({"problems": [p.as_dict() for p in error.problems]}, default=str)
    problems = by_cause(error.problems)
    heading = f"{counted(len(problems), 'problem')}; nothing was written."
    codes = more(problem.code for problem in problems)
    return "\n".join([heading, *(f"  {problem.with_code}" for problem in problems), codes])


if __name__ == "__main__":
    main()
