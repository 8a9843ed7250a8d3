"""New impacts: K, C and the peaks of the motion at masses, velocities and covariates of a table, by person.

A prediction is of one new impact. Its log K and log C are the expected ones at its levels, with the scatter
from impact to impact added: N(0, S), S with the spreads sd_impact_K, sd_impact_C and their correlation; a
further parameter of the element likewise. People, conditions and other levels that were measured keep their
effects; any other level, and one that is not given, is a new one of its population. Each draw's K and C, with
the mass and velocity, are then simulated on the run's element, along the gravity of the run.

The mass given is the true mass of the impactor that is to hit, whether or not the study declared the same
number; K and C are those at true masses, which the errors of the study's declared ones make as unsure as
they are. Of an impactor that is known no better than it was weighed the peaks have the error of that mass
besides.

Draws are joint: one draw of all rows is of one population, of the same people, conditions and new levels, so
that a difference of two rows is as unsure as it is. The scatter of single impacts alone is each row's own.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float

from bayestissue.dataset.cells import Records, alike, in_whatever_case, read_cells
from bayestissue.dataset.files import Source
from bayestissue.elements import element
from bayestissue.elements.outcomes import NEVER
from bayestissue.errors import Coded, InputError, Problem, has_control_characters, path_argument
from bayestissue.hierarchy.effects import RESPONSES, parameter_of, sd_impact
from bayestissue.hierarchy.levels import NEW
from bayestissue.hierarchy.recorded import Condition, Recorded
from bayestissue.inference.answers.finished import Finished
from bayestissue.inference.answers.law import (
    DROP_HEIGHT,
    MET,
    NO_LAW,
    Law,
    deeper,
    moving,
    numbers,
    parameter_log,
    reached_depths,
    simulated_step,
    unfit_height,
)
from bayestissue.inference.answers.meaning import average_notes, beyond_notes
from bayestissue.inference.answers.settings import SETTINGS
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.inference.checking.pooled_parameters import pooled_parameters
from bayestissue.inference.results.labels import ATTRIBUTES, element_attributes
from bayestissue.inference.results.meanings import COLUMNS, HEADFORM_COLUMNS, OUTCOME_COLUMNS
from bayestissue.inference.samplers.sampling import quantiles
from bayestissue.results import whole_file, write_tree

# Units stand in the names of the columns; each has beside it the ends of the 90 % interval, _low and _high.
QUANTITIES = COLUMNS | OUTCOME_COLUMNS
NO_VELOCITY = Coded.stated("not-simulated.velocity")
_QUANTILES = {"": 0.5, "_low": 0.05, "_high": 0.95}
_LEVELS, _SCATTER = 1, 2


class Predicted(NamedTuple):
    """New impacts.

    Attributes:
        table: a row a condition: what it was given, which levels are ``new``, `QUANTITIES` with median and
            90 % interval, the number of ``draws``, of which ``simulated`` were simulated, and a ``note``
            where something lacks or lies beyond what was measured.
        draws: of those simulated all quantities and parameters, [chain, draw, row], ``row`` being the place
            in the table, the first 1; each with its unit and meaning.
    """

    table: pd.DataFrame
    draws: xr.Dataset


def predict(
    finished: Finished, conditions: Sequence[Condition], say: Callable[[str, int, int], None] | None = None
) -> pd.DataFrame:
    """The table of `predicted`, made in blocks of rows, so that draws of all of them are never there at once.

    Args:
        finished: as of `predicted`.
        conditions: likewise.
        say: told the stage, how many rows are done, and of how many.
    """
    count, rng = _draws_of(finished), np.random.default_rng(_SCATTER)
    block = max(1, SETTINGS.predicted // count)
    step = simulated_step(count, len(conditions))
    tables = []
    for begin in range(0, max(1, len(conditions)), block):
        if say is not None and len(conditions) > block:
            say("predicting", begin, len(conditions))
        rows = conditions[begin : begin + block]
        tables.append(_predicted(finished, rows, step, rng).table)
    return pd.concat(tables, ignore_index=True)


def predicted(finished: Finished, conditions: Sequence[Condition]) -> Predicted:
    """Predictions of one new impact in each condition; float64 must be set.

    Args:
        finished: the fit.
        conditions: what is given in each, by column; see `bayestissue.hierarchy.levels`.
    """
    step = simulated_step(_draws_of(finished), len(conditions))
    return _predicted(finished, conditions, step, np.random.default_rng(_SCATTER))


def _draws_of(finished: Finished) -> int:
    return finished.posterior.sizes["chain"] * finished.posterior.sizes["draw"]


def _predicted(
    finished: Finished, conditions: Sequence[Condition], step: int, rng: np.random.Generator
) -> Predicted:
    """Predictions of which every ``step``th draw is simulated, the scatter of single impacts by ``rng``."""
    recorded, posterior, which = finished.recorded, finished.posterior, element(finished.element)
    conditions = [moving(condition, finished.gravity) for condition in conditions]
    names = [*RESPONSES, *(value.name for value in which.extra)]
    logs = _parameters(finished, names, conditions, rng)
    parameters = {name: np.exp(value) for name, value in zip(names, logs, strict=True)}
    count = _draws_of(finished)
    simulated = {name: value[:, ::step] for name, value in parameters.items()}
    met = {name: numbers(recorded, conditions, name) for name in MET}
    law = finished.law_of_levels
    held = np.array([law is not None and law.holds(recorded, condition) for condition in conditions], bool)
    outcomes = _outcomes(law, simulated, met, held)
    summarised = {name: parameters[name] for name in RESPONSES} | outcomes
    columns = COLUMNS | (HEADFORM_COLUMNS if finished.headform else OUTCOME_COLUMNS)
    notes = _notes(finished, conditions, met["velocity_m_s"], outcomes.get("peak_depth"), held)
    summary = _summary(summarised, columns)
    table = pd.DataFrame(
        [
            dict(condition)
            | {name: met[name][row] for name in ("mass_kg", "velocity_m_s")}
            | {"new": ", ".join(_new(recorded, condition))}
            | {name: float(values[row]) for name, values in summary.items()}
            | {"draws": count, "simulated": simulated["K"][..., row].size if held[row] else 0}
            | {"note": "; ".join(notes[row])}
            for row, condition in enumerate(conditions)
        ]
    )
    coords = {name: posterior[name].to_numpy() for name in ("chain", "draw")}
    coords |= {"draw": coords["draw"][::step], "row": np.arange(1, len(conditions) + 1)}
    attributes = ATTRIBUTES | element_attributes()
    draws = {name: (tuple(coords), value, attributes[name]) for name, value in (simulated | outcomes).items()}
    return Predicted(table, xr.Dataset(draws, coords))


def _outcomes(
    law: Law | None,
    parameters: Mapping[str, Float[np.ndarray, "chain draw condition"]],
    met: Mapping[str, Float[np.ndarray, " condition"]],
    held: Bool[np.ndarray, " condition"],
) -> dict[str, Float[np.ndarray, "chain draw condition"]]:
    """What impacts of such parameters and motions come to, NaN where the law does not hold."""
    if law is None or not held.any():
        return {}
    shape = parameters["K"].shape
    flat = {name: value.reshape(-1, shape[-1]) for name, value in parameters.items()}
    of_law = law.outcomes(flat, *(met[name] for name in MET))
    return {name: np.where(held, value.reshape(shape), np.nan) for name, value in of_law.items()}


def _notes(
    finished: Finished,
    conditions: Sequence[Condition],
    velocity: Float[np.ndarray, " condition"],
    depth: Float[np.ndarray, "chain draw condition"] | None,
    held: Bool[np.ndarray, " condition"],
) -> list[list[str]]:
    """Of each condition what lacks, and what lies beyond what was measured."""
    recorded, posterior = finished.recorded, finished.posterior
    of_all: list[str] = [
        one.note for one in pooled_parameters(posterior, recorded, element(finished.element))
    ]
    notes = [
        [
            *beyond_notes(recorded, condition),
            *_unknown(recorded, condition),
            *average_notes(recorded, RESPONSES, condition),
            *of_all,
        ]
        for condition in conditions
    ]
    lacks: list[list[str]] = [[] if law else [NO_LAW] for law in held.tolist()]
    alone = [ELEMENT_ALONE] * finished.element_alone
    if depth is None:
        return [[*one, *alone, *law] for one, law in zip(notes, lacks, strict=True)]
    depths, reached = np.median(depth, axis=(0, 1)), reached_depths(posterior)
    return [
        [*one, *alone, *(law or (deeper(reached, recorded, at, float(x)) if v > 0 else [NO_VELOCITY]))]
        for one, at, v, x, law in zip(notes, conditions, velocity, depths, lacks, strict=True)
    ]


# What joint draws are written as.
DRAWS_AS = (".parquet", ".nc")
_MARKED = {"program": "bayestissue", "holds": "joint draws of predictions"}


def is_draws(path: Path) -> bool:
    """Whether a file is what `write_draws` wrote."""
    with suppress(Exception):
        if path.suffix == ".nc":
            with xr.open_dataset(path, engine="h5netcdf") as draws:
                return _MARKED.items() <= draws.attrs.items()
        return _MARKED.items() <= pd.read_parquet(path, columns=["row"]).attrs.items()
    return False


def write_draws(draws: xr.Dataset, path: Path) -> None:
    """Write joint draws: netCDF where the name ends in ``.nc``, else Parquet, a row a chain, draw and row.

    Columns of Parquet are those of ``predictions.csv``, units in their names.
    """
    with whole_file(path) as staging:
        if path.suffix == ".nc":
            # It is asked whether there is room for it, under a name that is free.
            staging.unlink()
            write_tree(xr.DataTree(draws.assign_attrs(_MARKED)), staging)
            return
        table = draws.to_dataframe(["chain", "draw", "row"]).reset_index()
        table = table.rename(columns=COLUMNS | HEADFORM_COLUMNS)
        table.attrs.update(_MARKED)
        table.to_parquet(staging, index=False)


def _parameters(
    finished: Finished, names: Sequence[str], conditions: Sequence[Condition], rng: np.random.Generator
) -> list[Float[np.ndarray, "chain draw condition"]]:
    """Draws of the log of each parameter of a new impact in each condition."""
    draws = finished.posterior
    shape = (draws.sizes["chain"], draws.sizes["draw"], len(conditions))
    scatter = rng.standard_normal((len(names), *shape))
    if "residual_correlation" in draws:
        r = draws["residual_correlation"].to_numpy()[..., None]
        scatter[1] = r * scatter[0] + np.sqrt(1 - r**2) * scatter[1]
    logs = []
    for name, noise in zip(names, scatter, strict=True):
        log = parameter_log(draws, finished.recorded, name, conditions, new_levels=_LEVELS)
        logs.append(log + draws[sd_impact(parameter_of(name))].to_numpy()[..., None] * noise)
    return logs


def _summary(
    values: Mapping[str, Float[np.ndarray, "chain draw row"]], columns: Mapping[str, str]
) -> dict[str, Float[np.ndarray, " row"]]:
    """Median and 90 % interval of each quantity that there is, and of the others nothing."""
    nothing = np.full(next(iter(values.values())).shape[-1], np.nan)
    summary = {f"{column}{end}": nothing for column in columns.values() for end in _QUANTILES}
    for name, draws in values.items():
        of_rows = np.ascontiguousarray(draws.reshape(-1, draws.shape[-1]).T)
        ends = quantiles(of_rows, list(_QUANTILES.values()))
        summary |= {f"{columns[name]}{end}": v for end, v in zip(_QUANTILES, ends, strict=True)}
        if name in NEVER:
            known = ~np.isnan(of_rows).any(axis=1)
            summary[f"{columns[name]}_never"] = np.where(known, np.isinf(of_rows).mean(axis=1), np.nan)
    return summary


def _new(recorded: Recorded, condition: Condition) -> list[str]:
    """The groups of which a condition has a new level."""
    complete = recorded.completed(condition)
    groups = []
    for term in recorded.terms:
        levels = {factor: complete[factor] for factor in term.factors if factor in complete}
        if len(levels) < len(term.factors) or not recorded.matching(levels).any():
            groups.append(term.grouping)
    return list(dict.fromkeys(groups))


def _unknown(recorded: Recorded, condition: Condition) -> list[Coded]:
    """Names of levels that were not measured and look like slips."""
    notes = []
    for name, value in condition.items():
        if name not in recorded.factors or value == NEW or value in (levels := recorded.levels(name)):
            continue
        small = {level.casefold(): level for level in levels}
        near = difflib.get_close_matches(str(value).casefold(), list(small), n=1, cutoff=SETTINGS.likeness)
        suggestion = f"; did you mean {small[near[0]]}?" if near else ""
        notes.append(Coded.stated("new-level", name=name, level=value, suggestion=suggestion))
    return notes


_POSITIVE = {"mass_kg": "kg", "velocity_m_s": "m/s", "diameter_m": "m", DROP_HEIGHT: "cm"}
_TABLE = "table (rows from 0)"


def read_conditions(
    table: str | Path | pd.DataFrame, recorded: Recorded, gravity: float = 0.0
) -> list[Condition]:
    """What is given of each new impact, by column; an empty cell is not given, also where all of a row are.

    Args:
        table: a CSV file or a pandas table, whose columns are among those of the run's ``impacts.csv``.
            `DROP_HEIGHT` may stand in place of a velocity.
        recorded: of the run.
        gravity: along its motion [m/s^2], without which a height of fall gives no velocity.

    Raises:
        InputError: everything that is wrong, with file, row, column, value and what was expected.
    """
    if isinstance(table, pd.DataFrame):
        label = _TABLE
        body = [[_text(value) for value in row] for row in table.itertuples(index=False, name=None)]
        cells, rows = Records([str(name) for name in table], body, range(len(body)), label).cells()
    else:
        path = path_argument("table", table, "a pandas table, or the path of a CSV file")
        label = str(table)
        remedy = "Write one: a header with columns of impacts.csv, and a row for each new impact."
        cells, rows = read_cells(Source.at(path, label, remedy=remedy), keep_empty=True)
    usable = _usable(recorded)
    named = [in_whatever_case(name, usable) for name in map(str, cells)]
    # Of a column that stands there in two cases neither is the other.
    cells.columns = [new if named.count(new) == 1 else old for old, new in zip(cells, named, strict=True)]
    if problems := list(_columns(cells, usable, label)):
        raise InputError(problems)
    for name in {*map(str, cells)} & {*recorded.named}:
        levels = recorded.levels(name)
        cells[name] = cells[name].map({text: alike(text, levels) for text in set(cells[name])})
    if problems := [*_wrong(cells, rows, recorded, label), *_heights(cells, rows, recorded, gravity, label)]:
        raise InputError(problems)
    return [
        {
            str(name): float(text) if _is_number(str(name), recorded) else text
            for name, text in zip(cells, texts, strict=True)
            if text
        }
        for texts in cells.itertuples(index=False, name=None)
    ]


def _text(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)) or value is pd.NA:
        return ""
    if isinstance(value, float | np.floating):
        return f"{float(value):.17g}"
    return str(value).strip()


def _is_number(name: str, recorded: Recorded) -> bool:
    return name in _POSITIVE or (name in recorded.rows and name not in recorded.named)


def _usable(recorded: Recorded) -> list[str]:
    """The columns that may be given."""
    # A height in another unit, which no formula is of, would move nothing.
    moves = [n for n in map(str, recorded.rows) if n in recorded.needed or not n.startswith("drop_height")]
    return list(dict.fromkeys([*moves, *_POSITIVE]))


def _columns(cells: pd.DataFrame, usable: Sequence[str], label: str) -> Iterator[Problem]:
    """Columns that the run does not have."""
    for name in map(str, cells):
        if name not in usable:
            near = difflib.get_close_matches(name, usable, n=1)
            remedy = f'Is it "{near[0]}"?' if near else "Rename or remove the column."
            remedy = "Each row is a new impact: remove the column." if name == "impact" else remedy
            numbers = {"usable": ", ".join(usable), "remedy": remedy}
            yield Problem.stated("prediction-table.column", label, 1, name, name, **numbers)


def _wrong(cells: pd.DataFrame, rows: np.ndarray, recorded: Recorded, label: str) -> Iterator[Problem]:
    for name in map(str, cells):
        known = recorded.levels(name) if name in recorded.named and not recorded.may_be_new(name) else None
        for text, row in zip(cells[name], rows, strict=True):
            wanted, hint = "", ""
            if has_control_characters(text):
                wanted = "text on one line and without control characters"
            elif text and _is_number(name, recorded):
                wanted = _no_number(name, text)
            elif text and known is not None and text not in known:
                wanted = f"one of {', '.join(known[:8])}"
                near = difflib.get_close_matches(text, known, n=1)
                hint = f'Is it "{near[0]}"? ' if near else ""
            if wanted:
                where = (label, int(row), name, text)
                yield Problem.stated("prediction-table.cell", *where, wanted=wanted, hint=hint)


def _heights(
    cells: pd.DataFrame, rows: np.ndarray, recorded: Recorded, gravity: float, label: str
) -> Iterator[Problem]:
    """Heights of fall that give no velocity, or give a second one."""
    for texts, row in zip(cells.to_dict("records"), rows, strict=True):
        stated = [str(name) for name, text in texts.items() if text]
        if wanted := unfit_height(recorded, stated, gravity):
            where = (label, int(row), DROP_HEIGHT, texts[DROP_HEIGHT])
            yield Problem.stated("prediction-table.cell", *where, wanted=wanted, hint="")


def _no_number(name: str, text: str) -> str:
    """What was expected of a cell that should hold a number; empty where it does."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if name in _POSITIVE:
        good = 0 < value < SETTINGS.largest
        return "" if good else f"a number of {_POSITIVE[name]} above 0 and below {SETTINGS.largest:g}"
    return "" if math.isfinite(value) else "a number"
