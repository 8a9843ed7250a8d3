"""The files of a finished run, read and checked, and the page that is made of them."""

from __future__ import annotations

import json
from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.errors import InputError, Problem
from bayestissue.base.results.files import whole_file
from bayestissue.base.results.manifest import require_as_written
from bayestissue.base.results.tables import AGAIN, HELD, wrong_in
from bayestissue.base.runtime import FORMAT

# Of every run with a posterior.
POSTERIOR_TABLES = ("summary", "hypotheses", "sensitivity")


class PosteriorRun:
    """What the files of a run with a posterior of K and C say.

    ``groups`` holds the data sets of `posterior.nc` that the report shows; the tables keep their column
    names, text as it was written and numbers as float64.
    """

    record: dict[str, Any]
    diagnostics: dict[str, Any]
    groups: dict[str, xr.Dataset]
    summary: pd.DataFrame
    hypotheses: pd.DataFrame
    sensitivity: pd.DataFrame

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


def not_a_fit(folder: Path, record: Mapping[str, Any], remedy: str) -> Problem:
    """The problem of a folder that holds another kind of run than a fit."""
    path, kind = folder / "run.json", record["kind"]
    return wrong_in(path, '"fit"', remedy, code="not-a-fit", column="kind", value=kind)


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


def open_tree(path: Path, needed: Mapping[str, Sequence[str]], remedy: str = AGAIN) -> xr.DataTree:
    """The DataTree of a ``posterior.nc``, its draws left on disk.

    Args:
        path: of the file.
        needed: variables by group, without which the file is of no use.
        remedy: what to do if it is not such a file.

    Raises:
        InputError: it isn't such a file, or lacks some of them.
    """
    with _as_input_errors(path, remedy):
        tree = xr.open_datatree(path, engine="h5netcdf")
        try:
            require_groups(tree, needed, path, remedy)
        except InputError:
            tree.close()
            raise
        return tree


def read_groups(
    path: Path,
    needed: Mapping[str, Sequence[str]],
    remedy: str = AGAIN,
    *,
    of_impacts: Collection[str] | None = None,
) -> dict[str, xr.Dataset]:
    """The groups ``needed`` of a ``posterior.nc``, in memory: see `open_tree`.

    Of draws of single impacts, which are most of the file, those of ``of_impacts``; all unless it is given.
    """
    import h5py

    with _as_input_errors(path, remedy), ExitStack() as files:
        with h5py.File(path) as file:
            present = [group for group in needed if group in file]
        # Not the others: opening a variable takes longer than reading it.
        groups = {
            group: files.enter_context(xr.open_dataset(path, group=group, engine="h5netcdf"))
            for group in present
        }
        _require_parts(groups, needed, path, remedy)
        if of_impacts is not None:
            groups = of_population(groups, of_impacts)
        return {name: data.load() for name, data in groups.items()}


def of_population(
    groups: Mapping[str, xr.Dataset], of_impacts: Collection[str] = ()
) -> dict[str, xr.Dataset]:
    """The groups with draws of single impacts for ``of_impacts`` alone."""
    posterior = groups["posterior"]
    single = {name for name in posterior.data_vars if "impact" in posterior[name].dims}
    return {**groups, "posterior": posterior.drop_vars(single - set(of_impacts))}


def require_groups(
    tree: xr.DataTree, needed: Mapping[str, Sequence[str]], path: Path, remedy: str = AGAIN
) -> None:
    """Raise an `InputError` of a tree that lacks some of the variables ``needed``, by group."""
    _require_parts({group: tree[group].data_vars for group in tree.children}, needed, path, remedy)


def _require_parts(
    groups: Mapping[str, Container[Any]], needed: Mapping[str, Sequence[str]], path: Path, remedy: str
) -> None:
    lacking = [
        f"{group}/{name}" if name else group
        for group, names in needed.items()
        for name in names or ("",)
        if group not in groups or (name and name not in groups[group])
    ]
    if lacking:
        raise InputError(wrong_in(path, f"the parts {', '.join(lacking)}", remedy, value="none of them"))


@contextmanager
def _as_input_errors(path: Path, remedy: str) -> Iterator[None]:
    """Whatever a file of draws can't be read for, as an `InputError`."""
    try:
        yield
    except InputError:
        raise
    except (OSError, KeyError, ValueError) as error:
        raise InputError(wrong_in(path, "a DataTree as a run writes it", remedy, value=str(error))) from error


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
    "published": ("thesis.pages.published_page", "published_page"),
    "estimates": ("studies.estimates", "estimates_page"),
    "fit": ("reports.pages.fit.fit_page", "fit_page"),
    "comparison": ("reports.pages.comparison", "comparison_page"),
    "plan": ("reports.pages.plan_page", "plan_page"),
    "certificate": ("reports.pages.certificate_page", "certificate_page"),
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
