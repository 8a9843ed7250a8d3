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

from bayestissue.base.errors import Coded, InputError, Problem, has_control_characters, path_argument
from bayestissue.base.outcome_table import HEADFORM_COLUMNS, NEVER, OUTCOME_COLUMNS
from bayestissue.base.results.files import whole_file, write_tree
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import DROP_HEIGHT, MOTION, NO_LAW, moving, unfit_height
from bayestissue.inference.answers.meaning import as_number, average_notes, beyond_notes, takes_number
from bayestissue.inference.answers.study import DRAWN, Study, simulated_step
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.inference.checking.formula_checks import pooled_parameters
from bayestissue.inference.results.labels import variables
from bayestissue.inference.results.meanings import COLUMNS
from bayestissue.inference.samplers.sampling import interval
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.levels import NEW
from bayestissue.model.hierarchy.recorded import Condition, Recorded
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.recordings.dataset.cells import Records, ignoring_case, in_whatever_case, nearest, read_cells
from bayestissue.recordings.dataset.source_files import Source, plain_text

# Units stand in the names of the columns; each has beside it the ends of the 90 % interval, _low and _high.
QUANTITIES = COLUMNS | OUTCOME_COLUMNS
NO_VELOCITY = Coded.stated("not-simulated.velocity")
# The seed of the scatter of single impacts.
_SCATTER = 2


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
    study: Study, conditions: Sequence[Condition], say: Callable[[str, int, int], None] | None = None
) -> pd.DataFrame:
    """The table of `predicted`, made in blocks of rows, so that draws of all of them are never there at once.

    Args:
        study: as of `predicted`.
        conditions: likewise.
        say: told the stage, how many rows are done, and of how many.
    """
    rng = np.random.default_rng(_SCATTER)
    block = max(1, SETTINGS.predicted // study.count)
    step = simulated_step(study.count, len(conditions))
    tables = []
    for begin in range(0, max(1, len(conditions)), block):
        if say is not None and len(conditions) > block:
            say("predicting", begin, len(conditions))
        rows = conditions[begin : begin + block]
        tables.append(predicted(study, rows, step, rng).table)
    return pd.concat(tables, ignore_index=True)


def predicted(
    study: Study, conditions: Sequence[Condition], step: int = 0, rng: np.random.Generator | None = None
) -> Predicted:
    """Predictions of one new impact in each condition; float64 must be set.

    Args:
        study: the fit.
        conditions: what is given in each, by column; see `bayestissue.model.hierarchy.levels`.
        step: every so manieth draw is simulated; as of so many conditions unless given.
        rng: of the scatter of single impacts.
    """
    step = step or simulated_step(study.count, len(conditions))
    rng = rng or np.random.default_rng(_SCATTER)
    held = np.array([study.holds(condition) for condition in conditions], bool)
    motion, headform = study.motion(conditions), study.law.headform
    parameters = study.at(study.law.parameters, conditions, new=rng)
    simulated = parameters.isel(draw=slice(None, None, step))
    outcomes = study.outcomes(simulated, conditions) if held.any() else xr.Dataset()
    notes = _notes(study, conditions, outcomes, held)
    columns = COLUMNS | (HEADFORM_COLUMNS if headform else OUTCOME_COLUMNS)
    of_motion = {str(name): draws for name, draws in outcomes.items()}
    summary = _summary({q: parameters[q] for q in RESPONSES} | of_motion, columns)
    count = simulated.sizes["chain"] * simulated.sizes["draw"]
    table = pd.DataFrame(
        [
            dict(moving(condition, study.law.gravity))
            | {name: motion[name][row] for name in ("mass_kg", "velocity_m_s")}
            | {"new": ", ".join(_new(study.recorded, condition))}
            | {name: float(values[row]) for name, values in summary.items()}
            | {"draws": study.count, "simulated": count if held[row] else 0}
            | {"note": "; ".join(notes[row])}
            for row, condition in enumerate(conditions)
        ]
    )
    known = variables()
    draws = simulated.assign(outcomes).rename(condition="row")
    draws = draws.assign_coords(row=np.arange(1, len(conditions) + 1))
    return Predicted(table, draws.assign({n: v.assign_attrs(known[str(n)].attrs) for n, v in draws.items()}))


def _notes(
    study: Study, conditions: Sequence[Condition], outcomes: xr.Dataset, held: Bool[np.ndarray, " condition"]
) -> list[list[str]]:
    """Of each condition what lacks, and what lies beyond what was measured."""
    recorded = study.recorded
    of_all: list[str] = [
        *(one.note for one in pooled_parameters(study.draws, recorded, element(study.law.element))),
        *[ELEMENT_ALONE] * study.element_alone,
    ]
    velocity = study.motion(conditions)["velocity_m_s"]
    depths = interval(outcomes["peak_depth"])["median"] if outcomes else velocity
    notes = []
    for condition, V, depth, lawful in zip(conditions, velocity, depths, held, strict=True):
        moved = moving(condition, study.law.gravity)
        further = [NO_LAW] if not lawful else study.deeper(moved, float(depth)) if V > 0 else [NO_VELOCITY]
        of_levels = [
            *beyond_notes(recorded, moved),
            *_unknown(recorded, moved),
            *average_notes(recorded, RESPONSES, moved),
        ]
        notes.append([*of_levels, *of_all, *further])
    return notes


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


def _summary(
    values: Mapping[str, xr.DataArray], columns: Mapping[str, str]
) -> dict[str, Float[np.ndarray, " row"]]:
    """Median and 90 % interval of each quantity that there is, and of the others nothing."""
    nothing = np.full(next(iter(values.values())).sizes["condition"], np.nan)
    summary = {f"{column}{end}": nothing for column in columns.values() for end in ("", "_low", "_high")}
    for name, draws in values.items():
        summary |= interval(draws, columns[name])
        if name in NEVER:
            never = xr.apply_ufunc(np.isinf, draws).where(~np.isnan(draws)).mean(DRAWN, skipna=False)
            summary[f"{columns[name]}_never"] = never.to_numpy()
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


_TABLE = "table (rows from 0)"


def read_conditions(table: str | Path | pd.DataFrame, study: Study) -> list[Condition]:
    """What is given of each new impact, by column; an empty cell is not given, also where all of a row are.

    Args:
        table: a CSV file or a pandas table, whose columns are among those of the run's ``impacts.csv``.
            `DROP_HEIGHT` may stand in place of a velocity.
        study: of which. Without gravity along its motion a height of fall gives no velocity.

    Raises:
        InputError: everything that is wrong, with file, row, column, value and what was expected.
    """
    recorded = study.recorded
    if isinstance(table, pd.DataFrame):
        label = _TABLE
        body = [[plain_text(value) for value in row] for row in table.itertuples(index=False, name=None)]
        cells, rows = Records([str(name) for name in table], body, range(len(body)), label).cells()
    else:
        path = path_argument("table", table, "a pandas table, or the path of a CSV file")
        label = str(table)
        remedy = "Write one: a header with columns of impacts.csv, and a row for each new impact."
        cells, rows = read_cells(Source.at(path, label, remedy=remedy), keep_empty=True)
    # A height in another unit, which no formula is of, would move nothing.
    moves = [n for n in map(str, recorded.rows) if n in recorded.needed or not n.startswith("drop_height")]
    usable = list(dict.fromkeys([*moves, *MOTION]))
    named = [in_whatever_case(name, usable) for name in map(str, cells)]
    # Of a column that stands there in two cases neither is the other.
    cells.columns = [new if named.count(new) == 1 else old for old, new in zip(cells, named, strict=True)]
    if problems := list(_columns(cells, usable, label)):
        raise InputError(problems)
    for name in {*map(str, cells)} & {*recorded.named}:
        levels = recorded.levels(name)
        cells[name] = cells[name].map({text: ignoring_case(text, levels) for text in set(cells[name])})
    if problems := list(_slips(cells, rows, study, label)):
        raise InputError(problems)
    return [
        {
            str(name): float(text) if name in MOTION or takes_number(str(name), recorded) else text
            for name, text in zip(cells, texts, strict=True)
            if text
        }
        for texts in cells.itertuples(index=False, name=None)
    ]


def _columns(cells: pd.DataFrame, usable: Sequence[str], label: str) -> Iterator[Problem]:
    """Columns that the run does not have."""
    for name in map(str, cells):
        if name not in usable:
            near = nearest(name, usable)
            remedy = f'Is it "{near}"?' if near else "Rename or remove the column."
            remedy = "Each row is a new impact: remove the column." if name == "impact" else remedy
            numbers = {"usable": ", ".join(usable), "remedy": remedy}
            yield Problem.stated("prediction-table.column", label, 1, name, name, **numbers)


def _slips(cells: pd.DataFrame, rows: np.ndarray, study: Study, label: str) -> Iterator[Problem]:
    """Cells without a number or level that may stand there; heights that give no velocity or a second one."""
    recorded = study.recorded

    def slip(row: int, name: str, text: str, wanted: str, hint: str = "") -> Problem:
        where = (label, int(row), name, text)
        return Problem.stated("prediction-table.cell", *where, wanted=wanted, hint=hint)

    for name in map(str, cells):
        known = recorded.levels(name) if name in recorded.named and not recorded.may_be_new(name) else None
        for text, row in zip(cells[name], rows, strict=True):
            if has_control_characters(text):
                yield slip(row, name, text, "text on one line and without control characters")
            elif not text:
                continue
            elif name in MOTION:
                if not 0 < as_number(text) < SETTINGS.largest:
                    wanted = f"a number of {MOTION[name][1]} above 0 and below {SETTINGS.largest:g}"
                    yield slip(row, name, text, wanted)
            elif takes_number(name, recorded):
                if not math.isfinite(as_number(text)):
                    yield slip(row, name, text, "a number")
            elif known is not None and text not in known:
                hint = f'Is it "{near}"? ' if (near := nearest(text, known)) else ""
                yield slip(row, name, text, f"one of {', '.join(known[:8])}", hint)
    for texts, row in zip(cells.to_dict("records"), rows, strict=True):
        stated = [str(name) for name, text in texts.items() if text]
        if wanted := unfit_height(recorded, stated, study.law.gravity):
            yield slip(row, DROP_HEIGHT, texts[DROP_HEIGHT], wanted)
