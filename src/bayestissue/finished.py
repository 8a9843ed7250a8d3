"""A finished run read back from its folder, to ask it more."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import xarray as xr

from bayestissue.answering import Answering
from bayestissue.errors import InputError
from bayestissue.inference.answers.finished import GROUPS, Finished
from bayestissue.outline import Rows, short
from bayestissue.report.run_folder import not_a_fit, open_tree, read_about, require_files

_AGAIN = "Give the folder of a finished run of `bayestissue fit`."


@dataclass(frozen=True, eq=False, repr=False)
class Run(Answering):
    """A finished run of `bayestissue fit`.

    Attributes:
        folder: where it lies.
        about: the content of ``run.json``.
        posterior: the ArviZ DataTree of ``posterior.nc``, whose draws are read from the file as they are
            needed.
    """

    folder: Path
    about: dict[str, Any]
    posterior: xr.DataTree

    def _outline(self) -> tuple[str, Rows]:
        rows = [
            ("dataset", short(str(self.about.get("dataset", "")))),
            ("model", short(str(self.about["model"].get("name", "")))),
            ("more in", ".ask(question), .predict(table), .posterior, .about"),
        ]
        return f"Finished run {short(str(self.folder))}", rows

    @cached_property
    def finished(self) -> Finished:  # noqa: D102 - as declared above
        return Finished.from_tree(self.posterior, self.about["model"])


def read_run(path: str | Path) -> Run:
    """Read a finished fit back from its folder.

    Args:
        path: the folder that `bayestissue fit` or `bayestissue.Fit.report` wrote.

    Raises:
        InputError: it is not such a folder, or its files are damaged.
    """
    folder = Path(path)
    about = read_about(folder)
    if about["kind"] != "fit" or not isinstance(about.get("model"), dict):
        raise InputError(not_a_fit(folder, about, _AGAIN))
    require_files(folder, ["posterior.nc"])
    # An earlier version wrote no draws of the prior.
    needed = {name: () for name in GROUPS if name != "prior"}
    return Run(folder, about, open_tree(folder / "posterior.nc", needed, _AGAIN))
