"""`bayestissue open`: the impacts of a dataset on a page, each to be looked at, left out or used again."""

from __future__ import annotations

from typing import Annotated

import typer

from bayestissue.commands.options import DatasetFolder
from bayestissue.runtime import configure


def run(
    dataset: DatasetFolder,
    port: Annotated[
        int,
        typer.Option(
            "--port", help="Of the page on this machine; a free one unless given.", min=0, max=65535
        ),
    ] = 0,
) -> None:
    """Look at each impact of a dataset on a page, and leave one out with a reason.

    Reasons are written into left_out.csv in the dataset; recordings stay as they are. `check`, `estimate`,
    `fit` and their pages then do without these impacts and say why. Stop it by Ctrl-C.
    """
    configure()
    from bayestissue.bench.server import require_server, serve
    from bayestissue.bench.views import DatasetView
    from bayestissue.commands.console import echo
    from bayestissue.results import locked_folder

    require_server()
    with locked_folder(dataset, ()):
        serve(DatasetView(dataset), port, echo)
