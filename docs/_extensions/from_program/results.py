"""What result folders hold: files with their columns, and the variables of posterior.nc."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from bayestissue.base.results.tables import ResultFile, declared_files
from bayestissue.inference.answers.reliability import Variances, as_variables, coefficients_of
from bayestissue.inference.results import labels
from bayestissue.inference.results.labels import GROUPS, Variable
from from_program.keys import unit
from from_program.markdown import code, escaped, table

# Those of printed estimates, which `reproduce` alone has.
_PUBLISHED = ("_observed", "_average", "_sd")


def files() -> str:
    """Every file, and a section for each table with its columns."""
    every = [
        (f"[`{name}`](#{_anchor(name)})" if file.columns else code(name), _by(file), escaped(file.holds))
        for name, file in declared_files().items()
    ]
    sections = [
        f"({_anchor(name)})=\n## {name}\n\nWritten by {_by(file)}. A row is {escaped(file.holds)}.\n\n"
        + table(["column", "unit", "meaning"], _columns(file))
        for name, file in declared_files().items()
        if file.columns
    ]
    return "\n\n".join([table(["file", "written by", "holds; of a table, what a row is"], every), *sections])


def groups() -> str:
    """The groups of posterior.nc."""
    return table(["group", "holds"], [(code(name), escaped(words)) for name, (words, _) in GROUPS.items()])


def variables() -> str:
    """The variables of posterior.nc: a section for each group that has some of its own."""
    every, apart = _variables(), {name for _, names in GROUPS.values() for name in names}
    places = {group: names for group, (_, names) in GROUPS.items() if names}
    places = {"posterior": tuple(name for name in every if name not in apart)} | places
    return "\n\n".join(
        f"## Variables of {code(group)}\n\n"
        + table(
            ["variable", "one for each", "unit", "meaning"],
            [
                (
                    code(name),
                    ", ".join(every[name].dims),
                    every[name].attrs.get("unit", ""),
                    escaped(_sentence(every[name].attrs.get("long_name", ""))),
                )
                for name in names
            ],
        )
        for group, names in places.items()
    )


def _variables() -> dict[str, Variable]:
    """Every variable of a fit of traces, by name."""
    of_traces = {
        name: one
        for name, one in labels.variables().items()
        if not name.startswith("linear_") and name.removeprefix("K").removeprefix("C") not in _PUBLISHED
    }
    return of_traces | _of_reliability()


def _of_reliability() -> dict[str, Variable]:
    """What `as_variables` labels: made of any numbers, since names and units are asked for alone."""
    rng = np.random.default_rng(0)
    some = {name: rng.uniform(0.1, 0.2, (2, 3)) for name in ("people", "within", "impacts", "trial")}
    found = Variances(some["people"], 0.0, {"trial": (some["trial"], 3.0)}, {}, some["impacts"], 0.01, 3.0)
    draws = xr.Dataset({f"{q}_typical_person": (("chain", "draw"), some["within"]) for q in ("K", "C")})
    labelled = as_variables([one for q in ("K", "C") for one in coefficients_of(q, found, draws)])
    return {str(k): Variable(dict(v.attrs)) for k, v in labelled.items()}


def _columns(file: ResultFile) -> list[tuple[Any, ...]]:
    return [
        (code(name), unit(name), escaped(_sentence(column.meaning))) for name, column in file.columns.items()
    ]


def _by(file: ResultFile) -> str:
    return ", ".join(map(code, file.by)) if file.by != ("all",) else "every command that writes a folder"


def _anchor(name: str) -> str:
    return name.replace(".", "-").replace("_", "-")


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]
