"""How a command is declared and delivers what it computes: options of all, files, words, exit status.

Options:
    dataset: Folder with dataset.toml, impacts.csv and the traces.
    run: Folder of a finished run of `bayestissue fit`.
    out: Folder for the results; it must be new or empty.
    overwrite: Replace what --out holds, if that is results of bayestissue and nothing else.
    quiet: Print errors only.
    as_json: Print the table as JSON.
    skip_bad: Go on with the good impacts and list what was left out.
    scheduler: A running Dask scheduler, such as tcp://host:8786. Its workers compute what is done impact by
        impact, where there are hundreds.
    port: Of the page on this machine; a free one unless given.
    model: What is believed and sampled: the name of a model that comes with the program (impact of recorded
        decelerations and accelerations and arma of displacements unless given; maxwell ...), from any folder,
        or a file of your own. A name means the program's model; write ./NAME for a file that is called so.
    C: The same of log C; that of --K unless given.
    seed: Same seed, same machine: same numbers.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable
from contextlib import ExitStack, nullcontext
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, wraps
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from bayestissue.base import runtime
from bayestissue.base.declarations import described
from bayestissue.base.results.output_folder import OutputFolder, claim

if TYPE_CHECKING:
    from bayestissue.base.result import Result
    from bayestissue.commands.console import Shown, Stages

# The exit status of what finished, but whose sampler's diagnostics failed.
FAILED_DIAGNOSTICS = 3
DatasetFolder = Annotated[Path, typer.Argument(metavar="DATASET")]
FinishedFit = Annotated[Path, typer.Argument(metavar="RUN")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q")]
Json = Annotated[bool, typer.Option("--json")]
Port = Annotated[int, typer.Option(min=0, max=65535)]
FormulaOfK = Annotated[str | None, typer.Option("--K", metavar="FORMULA")]
FormulaOfC = Annotated[str | None, typer.Option("--C", metavar="FORMULA")]
# As text: a path would lose the "./" that tells a file from the program's model of that name.
Model = Annotated[str | None, typer.Option(metavar="NAME|FILE")]
Seed = Annotated[int, typer.Option(min=0, max=runtime.MOST_SEED)]
# Instead of the one that a file of the command states.
OtherSeed = Annotated[int | None, typer.Option(min=0, max=runtime.MOST_SEED)]


@dataclass
class Call:
    """One call of a command: the options that several commands have, and what its work may use.

    Attributes:
        out: folder for the results; None where none are to be written.
        scheduler: address of a Dask scheduler.
        skip_bad: go on with the good impacts.
        overwrite: replace what the folder holds.
        quiet: print errors only.
        as_json: print tables as JSON, and nothing else.
        target: ``out``, claimed.
        then: what is done with results that stand; whether it passed.
        patience_s: before this no line tells of the progress; see `bayestissue.commands.console.Stages`.
        blocks: that end when the results are written.
    """

    out: Path | None = None
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS")] = None
    skip_bad: bool = False
    overwrite: bool = False
    quiet: Quiet = False
    as_json: Json = False
    target: OutputFolder | None = None
    then: Callable[[Path], bool] | None = None
    patience_s: float = 0.0
    blocks: ExitStack = field(default_factory=ExitStack)

    @property
    def silent(self) -> bool:
        """Whether nothing is said beside the results."""
        return self.quiet or self.as_json

    @cached_property
    def say(self) -> Stages:
        """Told how far the work is; a bar from the first call on until the results are written."""
        from bayestissue.commands.console import Stages

        return self.blocks.enter_context(Stages(quiet=self.silent, patience_s=self.patience_s))

    def parts(self, job: str) -> Path:
        """A folder for finished parts of a job, kept until the results are written."""
        assert self.target is not None  # noqa: S101 - long commands need --out
        return self.blocks.enter_context(self.target.unfinished(job))

    def echo(self, text: str) -> None:
        """Say something before the results."""
        from bayestissue.commands.console import echo

        if text and not self.silent:
            echo(text)


type Words = Callable[[Any], Iterable[Shown]]


def delivers(
    *shared: str,
    out: Any = inspect.Parameter.empty,
    inputs: tuple[str, ...] = (),
    shown: Words = attrgetter("words"),
    verdict: Words = lambda _: (),
) -> Callable[[Callable[..., Result]], Callable[..., None]]:
    """A command whose function computes a `Result`; here it is written, printed, and ends the process.

    The function has the command's own options and, as ``call``, those of `Call`: --out, --overwrite and
    --quiet, and which of the others it names.

    Args:
        shared: of ``scheduler``, ``skip_bad`` and ``as_json`` those that it has.
        out: the default of --out, or what makes it of the other options; needed unless given.
        inputs: the options that name files and folders which must not be overwritten.
        shown: what is printed of a result, unless it has words of its own.
        verdict: what is printed before that, whatever --quiet says.
    """

    def declare(function: Callable[..., Result]) -> Callable[..., None]:
        default_out = out if callable(out) and out is not inspect.Parameter.empty else None
        options = _signature(function, shared, None if default_out else out)

        @wraps(function)
        def run(**stated: Any) -> None:
            bound = options.bind(**stated)
            bound.apply_defaults()
            arguments = bound.arguments
            call = Call(**{name: arguments.pop(name) for name in (*shared, "out", "overwrite", "quiet")})
            if call.out is None and default_out:
                call.out = default_out(arguments)
            values = [arguments[name] for name in inputs]
            paths = [path for value in values for path in (value if isinstance(value, list) else [value])]
            how: dict[str, Any] = {"overwrite": call.overwrite, "command": function.__name__, "inputs": paths}
            with nullcontext() if call.out is None else claim(call.out, **how) as call.target:
                runtime.configure()
                with call.blocks:
                    result = function(**arguments, call=call)
                    if call.target is not None:
                        said = vars(call).get("say")
                        result.put(call.target, said if said and said.started else lambda *_: None)
                _print(result, call, verdict, shown)
            passed = result.passed
            if call.then is not None and call.target is not None:
                passed &= call.then(call.target.path)
            if not passed:
                raise typer.Exit(FAILED_DIAGNOSTICS)

        run.__signature__ = options  # type: ignore[attr-defined]
        # What typer would evaluate otherwise, result and all.
        run.__annotations__ = {}
        return run

    return declare


def _signature(function: Callable[..., Any], shared: tuple[str, ...], out: Any) -> inspect.Signature:
    """The command's own options with those that are shared: --out behind what is needed, others last."""
    # A result's class is imported within the function.
    function.__annotations__.pop("return", None)
    stated = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "call"]
    needed = [p for p in stated if p.default is p.empty or _is_argument(p)]
    common = inspect.signature(Call, eval_str=True).parameters
    folder = common["out"].replace(annotation=common["out"].annotation if out is None else Path, default=out)
    last = [p for name, p in common.items() if name in (*shared, "overwrite", "quiet")]
    ordered = [*needed, folder, *(p for p in stated if p not in needed), *last]
    return inspect.Signature([p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in ordered])


def _is_argument(option: inspect.Parameter) -> bool:
    return any(isinstance(part, typer.models.ArgumentInfo) for part in get_args(option.annotation))


def _print(result: Result, call: Call, verdict: Words, shown: Words) -> None:
    from bayestissue.commands.console import echo, show

    if call.as_json:
        echo(json.dumps(result.as_json(), default=str, ensure_ascii=False))
        return
    for words in (*verdict(result), *(() if call.quiet else shown(result))):
        show(words)
    if call.target is not None and not call.quiet:
        echo(result.wrote(call.target.path))


def documented(command: Callable[..., None]) -> tuple[Callable[..., None], str]:
    """The function of a command with the help of each option, and the help of the command itself.

    Both are its docstring: what stands under ``Args:`` is an option's help, the rest the command's. Options
    that several commands have are described in the docstring of this module. An option is so declared once:
    its name, type and default in the signature, its meaning in a docstring. What else there is of it, such as
    bounds or another name, is `typer.Option` in its annotation; a bool is a flag.
    """
    words, arguments = described(command.__doc__, "Args")
    helps = described(__doc__, "Options")[1] | arguments
    signature = inspect.signature(command, eval_str=True)
    options = [_with_help(option, helps[option.name]) for option in signature.parameters.values()]
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
