"""The command line: parse, call, print. Every command's work lives in `bayestissue.commands`."""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import typer

from bayestissue import runtime, stopping
from bayestissue.errors import InputError, PartialResultError, Problem, by_cause, more, printable

# Of the process, and what each means.
STATUSES = {
    0: "done",
    1: "whoever read the output closed it",
    2: "the input is wrong, nothing written",
    3: "finished, but the sampler's diagnostics failed",
    4: "the results are written, but not their page, or in another folder, as the message says",
    5: "the machine failed (a full disk, say), nothing kept but what the message names",
    stopping.INTERRUPTED: "interrupted",
}

app = typer.Typer(
    name="bayestissue",
    help="Stiffness K and damping C of soft tissue from the recorded deceleration of an impact: "
    "what they are, how sure one can be, and whether their dependence on mass is real.",
    epilog=f"Exit status: {'; '.join(f'{status} {words}' for status, words in STATUSES.items())}.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

Dataset = Annotated[
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
        "recorded decelerations and arma of displacements unless given; maxwell ...), from any folder, or a "
        "file of your own. A name means the program's model; write ./NAME for a file that is called so.",
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
Excel = Annotated[
    Literal["auto", "comma", "point"] | None,
    typer.Option(
        "--excel",
        help="Write the tables as your Excel opens them: comma if it writes 1,5, point if 1.5, auto by the "
        "language of this machine.",
    ),
]
FinishedFit = Annotated[
    Path, typer.Argument(help="Folder of a finished run of `bayestissue fit`.", metavar="RUN")
]
Seed = Annotated[
    int, typer.Option("--seed", help="Same seed, same machine: same numbers.", min=0, max=runtime.MOST_SEED)
]


_FAILED = more(["machine-failed"])


@app.command()
def init(
    folder: Annotated[
        Path, typer.Argument(help="Folder of recorder files; nothing in it is changed.", metavar="FOLDER")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for the dataset, new or empty; that of the recordings with -dataset behind unless "
            "given. The dataset is called after it.",
        ),
    ] = None,
    pattern: Annotated[
        str | None,
        typer.Option(
            "--pattern",
            metavar="PATTERN",
            help="How file names are read; guessed from the names unless given. A name in braces is a "
            "column of impacts.csv; {} is what does not matter. mass_g, velocity_cm_s, drop_height_m, _cm "
            "and _mm are converted (v = sqrt(2 g h), for a pendulum too). With / the folders above the file "
            "are read as well.",
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            "--table",
            metavar="FILE.csv",
            help="A table with a column file, the name of a recording, and a column for each fact; with a "
            "column number too, a row for each impact of a recording.",
        ),
    ] = None,
    given: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="A fact that holds for all recordings; may be repeated."
        ),
    ] = None,
    channel: Annotated[str | None, typer.Option("--channel", help="The channel with the values.")] = None,
    quantity: Annotated[
        Literal["deceleration", "acceleration", "displacement"] | None,
        typer.Option("--quantity", help="What it recorded; a deceleration is positive while it slows."),
    ] = None,
    unit: Annotated[
        str | None, typer.Option("--unit", help='Its unit, such as "m/s^2", g or mm, after scale and offset.')
    ] = None,
    scale: Annotated[float, typer.Option("--scale", help="Raw values are multiplied by it.")] = 1.0,
    offset: Annotated[float, typer.Option("--offset", help="Added to them after that.")] = 0.0,
    time: Annotated[
        str | None, typer.Option("--time", help="The channel with the times, if the format has no clock.")
    ] = None,
    time_unit: Annotated[str | None, typer.Option("--time-unit", help="Its unit; s unless stated.")] = None,
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", help="The sampling rate, where there are no times.", min=0)
    ] = None,
    crop: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--crop",
            metavar="START STOP",
            help="The stretch of every recording that is read, in its unit of time.",
        ),
    ] = None,
    recorder: Annotated[
        list[str] | None,
        typer.Option(
            "--recorder",
            metavar="KEY=VALUE",
            help="An entry of the table [recorder], a known low-pass that the recordings went through: "
            "low_pass_hz, order, kind, zero_phase, noise, or sae_class; may be repeated.",
        ),
    ] = None,
    text: Annotated[
        list[str] | None,
        typer.Option(
            "--text",
            metavar="KEY=VALUE",
            help="How text files are written, where that is not found rightly: encoding (utf-8, utf-16, "
            "cp1252), delimiter (comma, semicolon, tab, pipe, space), decimal (point, comma), thousands "
            "(none, point, comma, space, apostrophe), header_row, units_row; may be repeated.",
        ),
    ] = None,
    uncertainty: Annotated[
        list[str] | None,
        typer.Option(
            "--uncertainty",
            metavar="NAME=SD",
            help="How well the measuring chain is known, as a standard deviation: mass and gain as a "
            "fraction, velocity in m/s, offset in m/s^2, such as velocity=0.01; may be repeated.",
        ),
    ] = None,
    gravity: Annotated[
        str | None,
        typer.Option(
            "--gravity",
            metavar="none|drop|M_S2",
            help="The part of gravity along the motion: none (a pendulum at its lowest point), drop "
            "(straight down), or a number of m/s², positive into the tissue. Asked for where a drop height "
            "is given.",
        ),
    ] = None,
    zero: Annotated[
        Literal["free_fall", "rest"] | None,
        typer.Option("--zero", help="Where an accelerometer read 0; in free fall unless stated."),
    ] = None,
    several: Annotated[
        bool, typer.Option("--several", help="Cut several impacts in one recording apart.")
    ] = False,
    threshold: Annotated[
        float,
        typer.Option("--threshold", help="Standard deviations of the noise an impact rises above.", min=1),
    ] = 20.0,
    separation_s: Annotated[
        float, typer.Option("--separation-s", help="The least time between two impacts, s.", min=0.001)
    ] = 0.5,
    name: Annotated[str, typer.Option("--name", help="Name of the dataset; the folder's if not given.")] = "",
    skip_bad: SkipBad = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Make a dataset of a folder of recorder files: CSV, Excel, Parquet, .lvm, .tdms, .mat, .c3d, .acq, .h5.

    What the files do not say is asked for at a terminal, or given as options. Files such as
    s01_left_2.5kg_1.lvm, whose names are read as {subject}_{side}_{mass_kg}kg_{n}, dropped from 12 cm:

        bayestissue init recorded --quantity deceleration --unit g --set drop_height_cm=12 --gravity drop
        --uncertainty velocity=0.01

    The recordings are copied as they are; init.html beside them shows what was understood.
    """
    from bayestissue.commands import init
    from bayestissue.intake import Choices, Cutting

    choices = Choices(
        channel,
        quantity,
        unit,
        time,
        time_unit,
        rate_hz,
        scale,
        offset,
        crop,
        pattern,
        table,
        init.given(given or []),
        init.entries(recorder or [], "--recorder", "sae_class=180"),
        init.entries(text or [], "--text", "decimal=comma"),
        init.gravity(gravity),
        zero,
        init.uncertainty(uncertainty or []),
    )
    init.run(
        folder,
        out=out,
        choices=choices,
        name=name,
        cutting=Cutting(threshold, separation_s) if several else None,
        skip_bad=skip_bad,
        overwrite=overwrite,
        quiet=quiet,
        as_json=as_json,
    )


@app.command()
def check(
    dataset: Dataset,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Also write quality figures and a page with one panel per impact."),
    ] = None,
    skip_bad: SkipBad = False,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Say what is wrong with a dataset: file, row, column, value, what was expected, how to mend it."""
    from bayestissue.commands import check

    check.run(
        dataset, out=out, skip_bad=skip_bad, excel=excel, overwrite=overwrite, quiet=quiet, as_json=as_json
    )


@app.command()
def simulate(
    specification: Annotated[
        Path, typer.Argument(help="Design, tissue, measuring chain and seed.", metavar="SPEC.toml")
    ],
    out: Out,
    seed: Annotated[
        int | None, typer.Option("--seed", help="Instead of the one in SPEC.toml.", min=0)
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Make a dataset whose truth is known: a design, a tissue, a measuring chain, and truth.csv beside it."""
    from bayestissue.commands import simulate

    simulate.run(specification, out=out, seed=seed, overwrite=overwrite, quiet=quiet)


@app.command()
def estimate(
    dataset: Dataset,
    out: Out,
    method: Annotated[
        Literal["impact", "exact", "dds"] | None,
        typer.Option(
            "--method",
            help="impact: each deceleration by itself under the impact likelihood with its measuring chain; "
            "its intervals hold. exact: maximum likelihood of an ARMA(2,1) about the rest position. "
            "dds: the thesis's conditional fit about the sample mean. Unless given: impact, and exact for "
            "displacements and where [signal] filters, centres or integrates otherwise.",
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            metavar="NAME|FILE",
            help="A model, by name or as a file, as in fit; its [signal] table says how x is made from the "
            "recording.",
        ),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            help="Also tabulate K and C over the values of a signal choice: window, contact, filter.",
        ),
    ] = None,
    scheduler: Scheduler = None,
    skip_bad: SkipBad = False,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """K and C of every impact by itself, with 90 % intervals; --method dds is the thesis's own chain."""
    from bayestissue.commands import estimate

    estimate.run(
        dataset,
        out=out,
        method=method,
        model=model,
        vary=tuple(vary or ()),
        scheduler=scheduler,
        skip_bad=skip_bad,
        excel=excel,
        overwrite=overwrite,
        quiet=quiet,
        as_json=as_json,
    )


@app.command()
def fit(
    dataset: Dataset,
    out: Out,
    model: Model = None,
    K: Annotated[
        str | None,
        typer.Option(
            "--K",
            metavar="FORMULA",
            help='What log K depends on, such as "log(mass_kg) + side + (1|subject)"; as the model has it '
            "unless given.",
        ),
    ] = None,
    C: Annotated[
        str | None,
        typer.Option("--C", metavar="FORMULA", help="The same of log C; that of --K unless given."),
    ] = None,
    ask: Annotated[
        list[str] | None,
        typer.Option(
            "--ask",
            metavar="QUESTION",
            help='Answered at the end and on the page, such as "K[side=left] / K[side=right] > 1.1"; may be '
            "given again.",
        ),
    ] = None,
    path: Annotated[
        Literal["automatic", "exact", "summary"] | None,
        typer.Option(
            "--path",
            help="How draws are made, as sampler.path of a model file; exact goes on where a fit was given "
            "up because it would take long.",
        ),
    ] = None,
    scheduler: Scheduler = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """The posterior of K and C from the traces: of every impact, person and condition, and of the exponents.

    An interrupted fit goes on where it stopped when the same command is given again.
    """
    from bayestissue.commands import fit

    passed = fit.run(
        dataset,
        out=out,
        model=model,
        K=K,
        C=C,
        questions=ask or [],
        path=path,
        scheduler=scheduler,
        seed=seed,
        skip_bad=skip_bad,
        excel=excel,
        overwrite=overwrite,
        quiet=quiet,
    )
    if not passed:
        raise typer.Exit(3)


@app.command()
def reproduce(
    out: Out,
    model: Annotated[
        str | None,
        typer.Option(
            "--model", metavar="NAME|FILE", help="Model of the re-analysis; published unless given."
        ),
    ] = None,
    published: Annotated[
        Path | None,
        typer.Option("--published", help="Folder of published tables; the thesis's own unless given."),
    ] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Recompute, audit and re-analyse the thesis's published estimates, and write the report."""
    from bayestissue.commands import reproduce

    passed = reproduce.run(out, model=model, published=published, seed=seed, overwrite=overwrite, quiet=quiet)
    if not passed:
        raise typer.Exit(3)


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run.", metavar="DIR")],
    quiet: Quiet = False,
) -> None:
    """Write report.html anew from the files of a finished run."""
    from bayestissue.commands import report

    report.run(run, quiet=quiet)


@app.command()
def compare(
    runs: Annotated[
        list[Path], typer.Argument(help="Folders of two or more finished fits of one dataset.", metavar="DIR")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write the tables and a page with figures.")
    ] = None,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Which finished fit predicts best what it has not seen, and whether the fits agree on K and C."""
    from bayestissue.commands import compare

    compare.run(runs, out=out, excel=excel, overwrite=overwrite, quiet=quiet, as_json=as_json)


@app.command()
def ask(
    run: FinishedFit,
    questions: Annotated[
        list[str],
        typer.Argument(
            metavar="QUESTION...",
            help='Such as "K[side=left] / K[side=right] > 1.1" or "mass_exponent_K between -0.1 and 0.1".',
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write questions.csv and report.html to this folder.")
    ] = None,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Questions to a finished fit: probability by posterior and prior, Bayes factor, Monte Carlo error.

    K alone is that of a typical person at the reference mass, the mean of other numbers and the first
    category. K[subject=s01, mass_kg=1.2] has these instead; all impacts' columns of the formula can be named,
    and what belongs to a person, such as sex, follows the person. K[subject=new] is a new person's,
    mean(K[subject, sex=f]) is over people, K[impact=7] is of one recorded impact. Any other quantity of
    summary.csv is called by its name: mass_exponent_K, sd_subject_K, K_new, subject_effect_K[subject=s01].
    Besides: numbers, + - * / ^ ( ), abs, exp, log, max, min, mean, < <= > >=, between, and, or, not. Odd
    names stand in quotes, those of quantities in backticks. Without a comparison the answer is a median and
    a 90 % interval.
    """
    from bayestissue.commands import ask

    ask.run(run, questions, out=out, excel=excel, overwrite=overwrite, quiet=quiet, as_json=as_json)


@app.command()
def predict(
    run: FinishedFit,
    at: Annotated[
        Path,
        typer.Option(
            "--at",
            metavar="TABLE.csv",
            help="A row for each new impact, with any columns of impacts.csv: subject, mass_kg, ...",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write predictions.csv and report.html to this folder.")
    ] = None,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """K, C, greatest depth and force, and time to peak of new impacts, by a finished fit.

    Each row of the table is one new impact, so the intervals hold its scatter too. Numbers and categories
    that are not given are at the reference: the reference mass, mean numbers, the first recorded category;
    what belongs to a known person follows the person. A person, condition or other level that is not given,
    or was not measured, is a new one of its population.
    """
    from bayestissue.commands import predict

    predict.run(run, at=at, out=out, excel=excel, overwrite=overwrite, quiet=quiet, as_json=as_json)


@app.command()
def causes(
    target: Annotated[
        str,
        typer.Argument(
            help='Folder of a dataset, or "published" for the thesis\'s own tables.',
            metavar="DATASET|published",
        ),
    ],
    out: Out,
    model: Annotated[
        str | None,
        typer.Option("--model", metavar="NAME|FILE", help="What is simulated; causes unless given."),
    ] = None,
    cause: Annotated[
        list[str] | None, typer.Option("--cause", help="Only this cause of the model file; may be repeated.")
    ] = None,
    campaigns: Annotated[
        int | None,
        typer.Option("--campaigns", help="Campaigns of every cause, instead of the model file's.", min=40),
    ] = None,
    method: Annotated[
        Literal["exact", "dds"],
        typer.Option("--method", help="How a dataset's impacts are estimated, as in estimate."),
    ] = "exact",
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", help="Worker processes; 1 works in this one. One per core unless given.", min=1
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", help="Address of a Dask scheduler that computes instead."),
    ] = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Why K grows with mass: simulate each proposed cause and say which could have made the numbers.

    An interrupted run goes on where it stopped when the same command is given again.
    """
    from bayestissue.commands import causes

    causes.run(
        target,
        out=out,
        model=model,
        only=tuple(cause or ()),
        campaigns=campaigns,
        method=method,
        jobs=jobs,
        scheduler=scheduler,
        seed=seed,
        skip_bad=skip_bad,
        overwrite=overwrite,
        quiet=quiet,
        as_json=as_json,
    )


@app.command()
def explain(
    codes: Annotated[
        list[str] | None,
        typer.Argument(help="As messages end with; all are listed unless given.", metavar="[CODE]..."),
    ] = None,
    as_json: Json = False,
) -> None:
    """What a warning or an error means, what it does to K and C, and what to do."""
    from bayestissue.commands import explain

    explain.run(codes or [], as_json=as_json)


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
    runtime.keep_compiled()
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
        where = error.filename or "standard output"
        said = f"could not go on: {where}: {error.strerror or error}"
        _leave(5, said, *getattr(error, "__notes__", ()), _FAILED)
    except MemoryError as error:
        _leave(5, "could not go on: there is not enough memory", *getattr(error, "__notes__", ()), _FAILED)
    except KeyboardInterrupt as error:
        _leave(stopping.INTERRUPTED, stopping.interrupted(*getattr(error, "__notes__", ())))


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
    heading = f"{len(problems)} problem{'s' if len(problems) > 1 else ''}; nothing was written."
    codes = more(problem.code for problem in problems)
    return "\n".join([heading, *(f"  {_with_code(problem)}" for problem in problems), codes])


def _with_code(problem: Problem) -> str:
    """The message with its code at the end of its first line: under that of a question stands its place."""
    first, *rest = str(problem).split("\n")
    return "\n".join([f"{first} [{problem.code}]", *rest])


if __name__ == "__main__":
    main()
