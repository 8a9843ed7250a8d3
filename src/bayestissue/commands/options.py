"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from bayestissue import runtime

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
