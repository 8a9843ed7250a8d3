"""The files of a finished run, read and checked, and the page that is made of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.errors import InputError, all_of
from bayestissue.base.results.files import whole_file
from bayestissue.base.results.manifest import require_as_written
from bayestissue.base.results.tables import AGAIN, HELD, read_table, wrong_in
from bayestissue.base.runtime import FORMAT

# Of every run with a posterior.
POSTERIOR_TABLES = ("summary", "hypotheses", "sensitivity")


def of_table(name: str, words: str) -> property:
    """The table of a run of this name, text and numbers as they are declared; ``words`` say what it has."""
    return property(lambda run: run.table(name), doc=words)


def stored_table(folder: Path, name: str) -> pd.DataFrame:
    """A table of a run in a folder.

    Raises:
        KeyError: the run has none of this name.
    """
    if not (folder / f"{name}.csv").is_file():
        raise KeyError(name)
    return read_table(folder, name)


@dataclass(frozen=True, eq=False, repr=False)
class PosteriorRun:
    """A finished run with a posterior of K and C, just made or read back from its folder.

    Attributes:
        about: the content of ``run.json``.
        posterior: the ArviZ DataTree with all groups of ``posterior.nc``: draws, predictions, densities,
            data. Of a run that was read back they are read from the file as they are needed.
        diagnostics: whether the sampler did its work (``passed``), and each check: ``diagnostics.json``.
            Besides, what is in doubt whatever the sampler did: ``measuring_chain`` (see
            `bayestissue.inference.checking.measuring_chain.judge`) and ``model_form``.
        table: a table of the folder by its name, such as "summary"; a KeyError where there is none.
        folder: of the run that was read back, or of the dataset that was fitted; None where it has none.
    """

    # Without which it is no such run, and what pages can't do without: groups of `posterior.nc`, variables by
    # group, and tables; and how a run is made anew.
    opened: ClassVar[tuple[str, ...]]
    needed: ClassVar[Mapping[str, Sequence[str]]]
    table_files: ClassVar[tuple[str, ...]]
    again: ClassVar[str]

    about: dict[str, Any]
    posterior: xr.DataTree
    diagnostics: dict[str, Any]
    table: Callable[[str], pd.DataFrame]
    folder: Path | None = None

    summary = of_table("summary", "Mean, median, intervals, R-hat, effective sample sizes of all quantities.")
    hypotheses = of_table("hypotheses", "Probabilities of what is claimed of mass exponents.")
    sensitivity = of_table("sensitivity", "How much prior and data move each quantity of the population.")

    @classmethod
    def read(cls, folder: Path, record: dict[str, Any]) -> Self:
        """The run in a folder, whose ``run.json`` holds ``record``; its files are read as they are needed.

        Raises:
            InputError: files lack, or aren't what a run writes.
        """
        require_files(folder, ["posterior.nc", "diagnostics.json"])
        tree = open_tree(folder / "posterior.nc", cls.opened, cls.again)
        diagnostics = read_json(folder / "diagnostics.json")
        return cls(record, tree, diagnostics, cache(partial(stored_table, folder)), folder)

    def complete(self) -> Self:
        """The same, after every file that a page is made of was read.

        Raises:
            InputError: a file lacks or isn't what a run writes; all such files are named at once.
        """
        if (folder := self.folder) is not None:
            require_files(folder, [f"{name}.csv" for name in self.table_files])
            all_of(lambda read: read(), self._readers())
        return self

    def _readers(self) -> list[Callable[[], Any]]:
        """What reads each of these files."""
        return [*(partial(self.table, name) for name in self.table_files), lambda: self.groups]

    @cached_property
    def groups(self) -> dict[str, xr.Dataset]:
        """The groups that pages show, in memory."""
        require_groups(self.posterior, self.needed, (self.folder or Path()) / "posterior.nc", self.again)
        return {name: self._shown(name).load() for name in self.needed}

    def _shown(self, group: str) -> xr.Dataset:
        return self.posterior[group].to_dataset()

    @property
    def record(self) -> dict[str, Any]:
        """What pages say of the run: ``about``."""
        return self.about

    def draws(self, variable: str, group: str = "posterior") -> np.ndarray:
        """All draws of ``variable``, [draw, ...]: chains one after the other."""
        array = self.groups[group][variable]
        array = array.transpose("chain", "kept_draw" if "kept_draw" in array.dims else "draw", ...)
        return array.to_numpy().reshape(-1, *array.shape[2:])

    def has(self, variable: str) -> bool:
        """Whether the model has ``variable``; one without mass, say, has no mass exponent."""
        return variable in self.groups["posterior"]

    def labels(self, dimension: str) -> list[str]:
        """The labels along ``dimension``."""
        return [str(label) for label in self.groups["posterior"][dimension].to_numpy()]

    def constant(self, name: str) -> np.ndarray:
        """One of the numbers that the model was given, such as ``mass_kg`` [impact] or [trial]."""
        return self.groups["constant_data"][name].to_numpy()


def read_about(folder: Path) -> dict[str, Any]:
    """The content of ``run.json``, which every finished run holds.

    Raises:
        InputError: the folder or the file is missing, it isn't the JSON object that a run writes, a version
            wrote it whose files or element this one does not know, or a file is not as it was written.
    """
    path = folder / "run.json"
    if not path.is_file():
        expected = "a file that every finished run holds"
        raise InputError(wrong_in(path, expected, value="no such file", code="not-a-run"))
    require_as_written(folder)
    record = read_json(path)
    if not isinstance(record.get("kind"), str):
        keys = ", ".join(record) or "no keys"
        raise InputError(wrong_in(path, 'the key "kind"', value=keys, code="not-a-run"))
    _require_version(path, record)
    return record


def _require_version(path: Path, record: Mapping[str, Any]) -> None:
    """Raise an `InputError` of a ``run.json`` whose files, or whose element, this version does not know."""
    if record.get("format") != FORMAT:
        command = "fit DATASET" if record["kind"] == "fit" else f"{record.get('command', record['kind'])} ..."
        where = str(path), None, "format", record.get("format", "none")
        raise InputError.stated("another-version.format", *where, format=FORMAT, command=command)
    model = record.get("model")
    name = model.get("element") if isinstance(model, Mapping) else None
    if name is not None:
        from bayestissue.mechanics.elements import element_names

        if name not in (known := element_names()):
            where = str(path), None, "model.element", name
            raise InputError.stated("another-version.element", *where, known=", ".join(known))


def require_files(folder: Path, names: list[str]) -> None:
    """Raise an `InputError` that names every one of ``names`` that ``folder`` lacks."""
    if lacking := [name for name in names if not (folder / name).is_file()]:
        raise InputError(wrong_in(folder / name, HELD, value="no such file") for name in lacking)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object.

    Raises:
        InputError: the file isn't JSON, or isn't an object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(wrong_in(path, "JSON as a run writes it", value=str(error))) from error
    if not isinstance(content, dict):
        raise InputError(wrong_in(path, "a JSON object", value=type(content).__name__))
    return content


def open_tree(path: Path, groups: Sequence[str], remedy: str) -> xr.DataTree:
    """The DataTree of a ``posterior.nc``, its draws left on disk.

    Args:
        path: of the file.
        groups: without which the file is of no use.
        remedy: what to do if it is not such a file.

    Raises:
        InputError: it isn't such a file, or lacks some of them.
    """
    try:
        tree = xr.open_datatree(path, engine="h5netcdf")
    except (OSError, KeyError, ValueError) as error:
        raise InputError(wrong_in(path, "a DataTree as a run writes it", remedy, value=str(error))) from error
    try:
        require_groups(tree, dict.fromkeys(groups, ()), path, remedy)
    except InputError:
        tree.close()
        raise
    return tree


def require_groups(
    tree: xr.DataTree, needed: Mapping[str, Sequence[str]], path: Path, remedy: str = AGAIN
) -> None:
    """Raise an `InputError` of a tree that lacks some of the variables ``needed``, by group."""
    lacking = [
        f"{group}/{name}" if name else group
        for group, names in needed.items()
        for name in names or ("",)
        if group not in tree.children or (name and name not in tree[group].data_vars)
    ]
    if lacking:
        raise InputError(wrong_in(path, f"the parts {', '.join(lacking)}", remedy, value="none of them"))


def write_report(run_dir: Path) -> Path:
    """Write ``report.html`` into the folder of a finished run, from the files in it alone.

    Returns:
        The path of the page.

    Raises:
        InputError: the folder isn't that of a finished run; what lacks is named.
    """
    run_dir = Path(run_dir)
    html, path = _page(run_dir, read_about(run_dir)), run_dir / "report.html"
    with whole_file(path) as staging:
        staging.write_text(html, encoding="utf-8")
    return path


# Of each kind of run: the module with its page, and the function that makes it.
_PAGES = {
    "published": ("thesis.published_page", "published_page"),
    "estimates": ("studies.estimates", "estimates_page"),
    "fit": ("reports.pages.fit.fit_page", "fit_page"),
    "comparison": ("reports.pages.comparison", "comparison_page"),
    "plan": ("reports.pages.plan_page", "plan_page"),
    "certificate": ("studies.certificate.certificate", "certificate_page"),
}


def _page(run_dir: Path, record: dict[str, Any]) -> str:
    kind = record["kind"]
    if kind not in _PAGES:
        kinds = " or ".join(f'"{known}"' for known in _PAGES)
        remedy = "Make the run anew with this version of the program."
        raise InputError(
            wrong_in(run_dir / "run.json", kinds, remedy, code="not-a-run", column="kind", value=kind)
        )
    module, name = _PAGES[kind]
    page: str = getattr(import_module(f"bayestissue.{module}"), name)(run_dir, record)
    return page
