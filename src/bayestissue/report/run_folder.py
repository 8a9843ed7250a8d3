"""The files of a finished run, read and checked before a report is made of them."""

from __future__ import annotations

import json
from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.errors import InputError, Problem
from bayestissue.remedies.codes import Code
from bayestissue.results import damaged, read_table

AGAIN = (
    "Give the folder of a finished run, or make it anew with `bayestissue fit` or `bayestissue reproduce`."
)


@dataclass(frozen=True)
class TableFile:
    """A table that a run must hold: its columns of text and of numbers, and numbers that it may hold."""

    name: str
    text: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    further: tuple[str, ...] = ()


_MIDDLE = ("median", "eti50_low", "eti50_high", "eti90_low", "eti90_high")
# Of every run with a posterior.
POSTERIOR_TABLES = (
    TableFile(
        "summary",
        ("variable", "label", "unit"),
        ("mean", "sd", *_MIDDLE, "ess_bulk", "ess_tail", "r_hat", "mcse_mean"),
    ),
    TableFile("hypotheses", ("quantity", "hypothesis"), ("value", "rope_low", "rope_high", "probability")),
    TableFile("sensitivity", ("variable", "diagnosis"), ("prior", "likelihood")),
)


@dataclass(frozen=True)
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


def wrong_in(
    path: Path, expected: str, remedy: str = AGAIN, *, code: Code = "damaged-run", **location: Any
) -> Problem:
    """What is wrong with a file of a run; ``location`` says where in it, and what stands there."""
    return Problem(str(path), expected, remedy, code=code, **location)


def not_a_fit(folder: Path, record: Mapping[str, Any], remedy: str) -> Problem:
    """The problem of a folder that holds another kind of run than a fit."""
    path, kind = folder / "run.json", record["kind"]
    return wrong_in(path, '"fit"', remedy, code="not-a-fit", column="kind", value=kind)


def read_about(folder: Path) -> dict[str, Any]:
    """The content of ``run.json``, which every finished run holds.

    Raises:
        InputError: the folder or the file is missing, it isn't the JSON object that a run writes, or a file
            of the run has another size than it was written with.
    """
    path = folder / "run.json"
    if not path.is_file():
        expected = "a file that every finished run holds"
        raise InputError(wrong_in(path, expected, value="no such file", code="not-a-run"))
    if problems := [
        wrong_in(folder / name, f"{size} bytes, as they were written", value=f"{actual} bytes")
        for name, (size, actual) in damaged(folder).items()
    ]:
        raise InputError(problems)
    record = read_json(path)
    if not isinstance(record.get("kind"), str):
        keys = ", ".join(record) or "no keys"
        raise InputError(wrong_in(path, 'the key "kind"', value=keys, code="not-a-run"))
    return record


def require_files(folder: Path, names: list[str]) -> None:
    """Raise an `InputError` that names every one of ``names`` that ``folder`` lacks."""
    if lacking := [name for name in names if not (folder / name).is_file()]:
        raise InputError(
            wrong_in(folder / name, "a file that a finished run holds", value="no such file")
            for name in lacking
        )


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
            _require_parts({group: tree[group].data_vars for group in tree.children}, needed, path, remedy)
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
            posterior = groups["posterior"]
            single = {name for name in posterior.data_vars if "impact" in posterior[name].dims}
            groups["posterior"] = posterior.drop_vars(single - set(of_impacts))
        return {name: data.load() for name, data in groups.items()}


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


def read_tables(folder: Path, layouts: tuple[TableFile, ...]) -> Mapping[str, pd.DataFrame]:
    """Every table of ``layouts`` by its name without suffix; text keeps its printed digits.

    Raises:
        InputError: all the files that can't be read and all the columns that lack, at once.
    """
    problems: list[Problem] = []
    tables = {layout.name: _read_table(folder / f"{layout.name}.csv", layout, problems) for layout in layouts}
    if problems:
        raise InputError(problems)
    return tables


def _read_table(path: Path, layout: TableFile, problems: list[Problem]) -> pd.DataFrame:
    try:
        table = read_table(path)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        problems.append(wrong_in(path, "a table as a run writes it", value=type(error).__name__))
        return pd.DataFrame()
    missing = [column for column in (*layout.text, *layout.numbers) if column not in table]
    problems += [wrong_in(path, "this column", row=1, column=column) for column in missing]
    for column in (*layout.numbers, *layout.further):
        if column in table:
            values = pd.to_numeric(table[column], errors="coerce")
            wrong = table[column][values.isna() & ~table[column].str.lower().isin(["", "nan"])]
            problems += [
                wrong_in(path, "a number or nothing", row=int(index) + 2, column=column, value=cell)
                for index, cell in zip(wrong.index, wrong, strict=True)
            ]
            table[column] = values.astype("float64")
    return table
