"""New impacts: K, C and the peaks of the motion at masses, velocities and covariates of a table, by person.

A prediction is of one new impact. Its log K and log C are the expected ones at its levels, with the scatter
from impact to impact added: N(0, S), S with the spreads sd_impact_K, sd_impact_C and their correlation; a
further parameter of the element likewise. People, conditions and other levels that were measured keep their
effects; any other level, and one that is not given, is a new one of its population. Each draw's K and C, with
the mass and velocity, are then simulated on the run's element, along the gravity of the run.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.dataset.cells import cells_of, read_cells
from bayestissue.elements import element
from bayestissue.errors import Coded, InputError, Problem, has_control_characters
from bayestissue.hierarchy.effects import RESPONSES, parameter_of, sd_impact
from bayestissue.hierarchy.levels import NEW
from bayestissue.hierarchy.recorded import Condition, Recorded
from bayestissue.inference.answers.finished import Finished
from bayestissue.inference.answers.law import NO_LAW, numbers, parameter_log, simulated_step
from bayestissue.inference.answers.meaning import average_notes, beyond_notes
from bayestissue.inference.answers.settings import SETTINGS
from bayestissue.inference.checking.pooled_parameters import pooled_parameters
from bayestissue.inference.results.meanings import COLUMNS, HEADFORM_COLUMNS, OUTCOME_COLUMNS
from bayestissue.inference.samplers.diagnostics import ELEMENT_ALONE
from bayestissue.inference.samplers.sampling import quantiles

# Units stand in the names of the columns; each has beside it the ends of the 90 % interval, _low and _high.
QUANTITIES = COLUMNS | OUTCOME_COLUMNS
# What may never happen or end, on a tissue that is never left.
NEVER = ("time_to_peak", "contact_duration", "impulse")
NO_VELOCITY = Coded("no peaks: no velocity_m_s, and the run has none", "not-simulated")
_QUANTILES = {"": 0.5, "_low": 0.05, "_high": 0.95}
_LEVELS, _SCATTER = 1, 2


def predict(finished: Finished, conditions: Sequence[Condition]) -> pd.DataFrame:
    """Predictions of one new impact in each condition; float64 must be set.

    Args:
        finished: the fit.
        conditions: what is given in each, by column; see `bayestissue.hierarchy.levels`.

    Returns:
        A row a condition: what it was given, which levels are ``new``, `QUANTITIES` with median and 90 %
        interval, the number of ``draws``, of which ``simulated`` were simulated, and a ``note`` where
        something lacks or lies beyond what was measured.
    """
    recorded, which = finished.recorded, element(finished.element)
    names = [*RESPONSES, *(value.name for value in which.extra)]
    logs = _parameters(finished, names, conditions)
    parameters = {
        name: np.exp(value.reshape(-1, len(conditions))) for name, value in zip(names, logs, strict=True)
    }
    count = len(parameters["K"])
    step = simulated_step(count, len(conditions))
    simulated = {name: value[::step] for name, value in parameters.items()}
    values = {"K": parameters["K"], "C": parameters["C"]}
    mass, velocity, diameter = (numbers(recorded, conditions, name) for name in _GIVEN)
    mixed = [one.note for one in pooled_parameters(finished.posterior, recorded, which)]
    notes = [
        [
            *beyond_notes(recorded, value),
            *_unknown(recorded, value),
            *average_notes(recorded, RESPONSES, value),
            *mixed,
        ]
        for value in conditions
    ]
    if finished.law is None:
        alone = [ELEMENT_ALONE] * finished.element_alone
        notes = [[*value, *alone, NO_LAW] for value in notes]
    else:
        values |= finished.law.outcomes(simulated, mass, velocity, diameter)
        notes = [[*n, *([] if v > 0 else [NO_VELOCITY])] for n, v in zip(notes, velocity, strict=True)]
    columns = COLUMNS | (HEADFORM_COLUMNS if finished.headform else OUTCOME_COLUMNS)
    return pd.DataFrame(
        [
            dict(condition)
            | {"mass_kg": mass[row], "velocity_m_s": velocity[row]}
            | {"new": ", ".join(_new(recorded, condition))}
            | _summary({name: value[:, row] for name, value in values.items()}, columns)
            | {"draws": count, "simulated": 0 if finished.discrepancy else len(simulated["K"])}
            | {"note": "; ".join(notes[row])}
            for row, condition in enumerate(conditions)
        ]
    )


_GIVEN = ("mass_kg", "velocity_m_s", "diameter_m")


def _parameters(
    finished: Finished, names: Sequence[str], conditions: Sequence[Condition]
) -> list[Float[np.ndarray, "chain draw condition"]]:
    """Draws of the log of each parameter of a new impact in each condition."""
    draws = finished.posterior
    shape = (draws.sizes["chain"], draws.sizes["draw"], len(conditions))
    scatter = np.random.default_rng(_SCATTER).standard_normal((len(names), *shape))
    if "residual_correlation" in draws:
        r = draws["residual_correlation"].to_numpy()[..., None]
        scatter[1] = r * scatter[0] + np.sqrt(1 - r**2) * scatter[1]
    logs = []
    for name, noise in zip(names, scatter, strict=True):
        log = parameter_log(draws, finished.recorded, name, conditions, new_levels=_LEVELS)
        logs.append(log + draws[sd_impact(parameter_of(name))].to_numpy()[..., None] * noise)
    return logs


def _summary(values: dict[str, Float[np.ndarray, " draw"]], columns: Mapping[str, str]) -> dict[str, float]:
    """Median and 90 % interval of each quantity that there is."""
    summary = {f"{column}{end}": np.nan for column in columns.values() for end in _QUANTILES}
    for name, draws in values.items():
        ends = quantiles(draws[None], list(_QUANTILES.values()))[:, 0]
        summary |= {f"{columns[name]}{end}": float(v) for end, v in zip(_QUANTILES, ends, strict=True)}
        if name in NEVER:
            summary[f"{columns[name]}_never"] = float(np.isinf(draws).mean())
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
        words = f'{name} "{value}" was not measured: a new one of the population{suggestion}'
        notes.append(Coded(words, "new-level"))
    return notes


_POSITIVE = {"mass_kg": "kg", "velocity_m_s": "m/s", "diameter_m": "m"}
_LABEL = "impact"
_TABLE = "table (rows from 0)"


def read_conditions(table: str | Path | pd.DataFrame, recorded: Recorded) -> list[Condition]:
    """What is given of each new impact, by column; an empty cell is not given, also where all of a row are.

    Args:
        table: a CSV file or a pandas table, whose columns are among those of the run's ``impacts.csv``.
            ``impact`` may name the rows.
        recorded: of the run.

    Raises:
        InputError: everything that is wrong, with file, row, column, value and what was expected.
    """
    if isinstance(table, pd.DataFrame):
        label, first = _TABLE, 0
        body = [[_text(value) for value in row] for row in table.itertuples(index=False, name=None)]
        cells, rows = cells_of([str(n) for n in table], body, range(first, len(body)), (), label=label)
    else:
        label = str(table)
        remedy = "Write one: a header with columns of impacts.csv, and a row for each new impact."
        cells, rows = read_cells(Path(table), (), label=label, keep_empty=True, remedy=remedy)
    if problems := list(_columns(cells, recorded, label)):
        raise InputError(problems)
    if problems := list(_wrong(cells, rows, recorded, label)):
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


def _columns(cells: pd.DataFrame, recorded: Recorded, label: str) -> Iterator[Problem]:
    """Columns that the run does not have, or has not kept."""
    usable = list(dict.fromkeys([*map(str, recorded.rows), *_POSITIVE]))
    for name in map(str, cells):
        if name not in (*usable, _LABEL):
            near = difflib.get_close_matches(name, usable, n=1)
            remedy = f'Is it "{near[0]}"?' if near else "Rename or remove the column."
            numbers = {"usable": ", ".join(usable), "remedy": remedy}
            yield Problem.stated("prediction-table.column", label, 1, name, name, **numbers)
    for name in recorded.lacking:
        yield Problem.stated("damaged-run.column", label, None, name)


def _wrong(cells: pd.DataFrame, rows: np.ndarray, recorded: Recorded, label: str) -> Iterator[Problem]:
    for name in map(str, cells):
        known = recorded.levels(name) if name in recorded.named and not recorded.may_be_new(name) else None
        for text, row in zip(cells[name], rows, strict=True):
            wanted, hint = "", ""
            if has_control_characters(text):
                wanted = "text on one line and without control characters"
            elif text and name != _LABEL and _is_number(name, recorded):
                wanted = _no_number(name, text)
            elif text and name != _LABEL and known is not None and text not in known:
                wanted = f"one of {', '.join(known[:8])}"
                near = difflib.get_close_matches(text, known, n=1)
                hint = f'Is it "{near[0]}"? ' if near else ""
            if wanted:
                where = (label, int(row), name, text)
                yield Problem.stated("prediction-table.cell", *where, wanted=wanted, hint=hint)


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
