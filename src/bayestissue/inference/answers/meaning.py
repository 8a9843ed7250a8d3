"""What the quantities of a question mean in a run, and what in it can't be answered.

A response of the hierarchy (K, C, a further parameter with a formula) is that of an impact at the levels in
its brackets, all else at the reference: see `bayestissue.model.hierarchy.levels`. So is an outcome, such as
peak_force[side=left, mass_kg=1, velocity_m_s=2]: what an impact of that motion comes to on the law of force
that was fitted, at the K and C of these levels. Any other name is a variable of the posterior, its brackets
choosing along its dimensions; so are K, C and outcomes of a recorded impact, as in K[impact=7].
"""

from __future__ import annotations

import difflib
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
import xarray as xr

from bayestissue.base.errors import Coded
from bayestissue.base.outline import first_of
from bayestissue.inference.answers.critical import ALONG, critical_motion
from bayestissue.inference.answers.grammar import (
    OF_MANY,
    Choice,
    Critical,
    Level,
    Node,
    Number,
    Quantity,
    QuestionError,
    claims,
    nodes,
    quantities,
)
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import DROP_HEIGHT, MOTION, NO_LAW, beyond, unfit_height
from bayestissue.inference.answers.study import DRAWN, Study
from bayestissue.inference.results.labels import variables
from bayestissue.mechanics.elements.head_injury import LONGEST
from bayestissue.mechanics.elements.outcomes import HEADFORM_OUTCOMES as OUTCOMES
from bayestissue.model.hierarchy.levels import NEW
from bayestissue.model.hierarchy.recorded import Condition, Recorded
from bayestissue.recordings.dataset.cells import alike, in_whatever_case

_ABOVE_ZERO = {
    "mass_kg": "a mass above 0 kg",
    "velocity_m_s": "a velocity above 0 m/s",
    "diameter_m": "a diameter above 0 m",
    DROP_HEIGHT: "a height above 0 cm",
}
_KEEP_UNIT = ("+", "-", "abs", *OF_MANY)


def is_response(quantity: Quantity, recorded: Recorded) -> bool:
    """Whether it is a response, or an outcome, at given levels, and no variable of the posterior."""
    known = quantity.name in recorded.formulas or quantity.name in OUTCOMES
    return known and all(level.column != "impact" for level in quantity.levels)


def responses_of(name: str, recorded: Recorded) -> tuple[str, ...]:
    """The responses that a response, or an outcome, is made of."""
    return tuple(recorded.formulas) if name in OUTCOMES else (name,)


def _columns_of(name: str, recorded: Recorded) -> tuple[str, ...]:
    """The columns that a response, or an outcome, depends on."""
    motion = MOTION if name in OUTCOMES else ()
    terms = (recorded.response(q).terms.columns for q in responses_of(name, recorded))
    return tuple(dict.fromkeys([*motion, *(column for columns in terms for column in columns)]))


def open_columns(quantity: Quantity, recorded: Recorded, posterior: xr.Dataset | None) -> list[str]:
    """The columns or dimensions of which it has all levels."""
    if is_response(quantity, recorded) or posterior is None:
        return [level.column for level in quantity.levels if level.value is None]
    chosen = [level.column for level in quantity.levels if level.value is not None]
    return [str(name) for name in posterior[quantity.name].dims if name not in (*DRAWN, *chosen)]


def condition_of(quantity: Quantity, recorded: Recorded) -> dict[str, str | float]:
    """What is given in the brackets of a response."""
    return {
        level.column: float(level.value) if _is_number(level.column, recorded) else level.value
        for level in quantity.levels
        if level.value is not None
    }


def conditions_of(quantity: Quantity, recorded: Recorded) -> list[Condition]:
    """The condition of a response, or one for each level of its open column that was recorded so."""
    condition = condition_of(quantity, recorded)
    free = [level.column for level in quantity.levels if level.value is None]
    if not free:
        return [condition]
    # What the response does not depend on chooses among what was recorded.
    moved = _columns_of(quantity.name, recorded)
    named = {k: v for k, v in condition.items() if v != NEW and (isinstance(v, str) or k not in moved)}
    return [condition | {free[0]: level} for level in recorded.levels(free[0], named)]


def beyond_notes(recorded: Recorded, condition: Condition) -> list[Coded]:
    """Numbers beyond those that were measured: the formula is then drawn out, and the element's law."""
    rows = recorded.rows
    numbered = [name for name, value in condition.items() if name in rows and isinstance(value, float)]
    measured = [name for name in numbered if recorded.is_number(name)]
    return [note for name in measured for note in beyond(name, float(condition[name]), rows[name])]


def average_notes(recorded: Recorded, responses: Iterable[str], columns: Iterable[str]) -> list[Coded]:
    """That responses are averaged where these columns are given; empty where nothing is."""
    columns = tuple(columns)
    over = dict.fromkeys(name for q in responses for name in recorded.response(q).averaged(columns))
    if not over:
        return []
    return [Coded.stated("averaged", columns=" and ".join(over))]


def unit_of(node: Node, posterior: xr.Dataset) -> str:
    """The unit of a quantity, and of a sum or mean of quantities that share it; otherwise empty.

    Of K / 1000 the unit can't be known: the number may stand for a change of unit.
    """
    if isinstance(node, Quantity):
        if node.name in posterior:
            unit = posterior[node.name].attrs.get("unit", "1")
        else:
            known = variables()
            unit = known[node.name].attrs["unit"] if node.name in known else "1"
        return "" if unit == "1" else str(unit)
    if isinstance(node, Critical):
        return ALONG[node.column]
    if isinstance(node, Number) or not (isinstance(node, Choice) or node.symbol in _KEEP_UNIT):
        return ""
    units = {unit_of(operand, posterior) for operand in node.operands}
    return units.pop() if len(units) == 1 else ""


def mistakes(
    node: Node, recorded: Recorded, posterior: xr.Dataset | None, *, within: bool = False
) -> Iterator[QuestionError]:
    """What can't be answered in a question, from left to right.

    Args:
        node: the question.
        recorded: of the run.
        posterior: its draws; None before they are made, when only responses can be judged.
        within: whether a quantity may have a value for each level.
    """
    if isinstance(node, Number):
        return
    if isinstance(node, Quantity):
        errors = list(_of_quantity(node, recorded, posterior))
        yield from errors
        if not errors and not within and (free := _open(node, recorded, posterior)):
            expected = f"one level of {free[0]}, or {node.name} within {'(), '.join(OF_MANY)}()"
            such = f"Such as {node.name}[{free[0]}=...] or mean({node.name}[{free[0]}])."
            yield QuestionError(node.position, f"{node.name} of every {free[0]}", expected, such)
        return
    if isinstance(node, Critical):
        yield from _of_critical(node, recorded)
    if isinstance(node, Choice):
        yield from _of_choice(node, recorded, posterior)
        return
    many = node.symbol in OF_MANY
    within = (within or many) and not isinstance(node, Critical)
    for operand in node.operands:
        yield from mistakes(operand, recorded, posterior, within=within)
    if many and posterior is not None:
        yield from _of_several(node.operands, recorded, posterior, node.position, node.symbol)


def as_recorded(node: Node, recorded: Recorded, posterior: xr.Dataset | None) -> Node:
    """The question with its columns and levels as they were recorded, in whatever case it names them."""
    if isinstance(node, Number):
        return node
    arrays = {} if posterior is None else posterior
    dims = [] if posterior is None else map(str, posterior.dims)
    columns = list(dict.fromkeys([*map(str, recorded.rows), *MOTION, *dims]))
    if not isinstance(node, Quantity):
        parts = tuple(as_recorded(operand, recorded, posterior) for operand in node.operands)
        if isinstance(node, Choice | Critical):
            return replace(node, operands=parts, column=in_whatever_case(node.column, columns))
        return replace(node, operands=parts)

    def named(level: Level) -> Level:
        column, labels = in_whatever_case(level.column, columns), []
        if column in recorded.named:
            labels = [*recorded.levels(column), NEW]
        elif node.name in arrays and column in arrays[node.name].dims:
            labels = arrays[node.name][column].astype(str).to_numpy().tolist()
        value = None if level.value is None else alike(level.value, labels)
        return replace(level, column=column, value=value)

    return replace(node, levels=tuple(map(named, node.levels)))


def at_level(node: Node, column: str, value: str | None, position: int) -> Node:
    """A question in which every quantity that does not name a column has this level of it.

    Args:
        node: the question.
        column: which.
        value: the level; None for all of them.
        position: what messages point at.
    """
    if isinstance(node, Quantity):
        if any(level.column == column for level in node.levels):
            return node
        return replace(node, levels=(*node.levels, Level(column, value, position, position)))
    if isinstance(node, Number):
        return node
    return replace(node, operands=tuple(at_level(one, column, value, position) for one in node.operands))


def alternatives(node: Choice, recorded: Recorded, posterior: xr.Dataset | None) -> dict[str, Node]:
    """What a choice compares: each level of its column, and the operand there."""
    (operand,) = node.operands
    first = next(quantities(at_level(operand, node.column, None, node.position)))
    if is_response(first, recorded):
        labels = [str(condition[node.column]) for condition in conditions_of(first, recorded)]
    else:
        labels = [] if posterior is None else posterior[node.column].astype(str).to_numpy().tolist()
    return {label: at_level(operand, node.column, label, node.position) for label in labels}


def _of_choice(node: Choice, recorded: Recorded, posterior: xr.Dataset | None) -> Iterator[QuestionError]:
    """What can't be answered in a choice: as of all its levels, of which there must be two."""
    (operand,) = node.operands
    if not any(True for _ in quantities(operand)):
        yield QuestionError(operand.position, "a number", "a quantity that levels may differ in")
        return
    of_all = at_level(operand, node.column, None, node.position)
    if all(quantity in set(quantities(of_all)) for quantity in quantities(operand)):
        yield QuestionError(
            operand.position, "one number for all", f"a quantity of which levels of {node.column} may differ"
        )
        return
    errors = list(mistakes(of_all, recorded, posterior, within=True))
    if not errors and posterior is not None:
        errors = list(_of_several([of_all], recorded, posterior, node.position, "best"))
    yield from errors
    if not errors and len(alternatives(node, recorded, posterior)) == 1:
        yield QuestionError(node.position, f"one level of {node.column}", "a column of two levels at least")


def _of_critical(node: Critical, recorded: Recorded) -> Iterator[QuestionError]:
    """What can't be answered in the search of a motion, beside the claim itself."""
    if node.column not in ALONG:
        wanted, near = f"one of {', '.join(ALONG)}", _near(node.column, [*ALONG])
        yield QuestionError(node.position, node.column, wanted, near)
        return
    named = [one for one in quantities(node) if one.name in OUTCOMES and is_response(one, recorded)]
    if not named:
        expected = "a claim about an outcome, such as peak_force < 1500"
        yield QuestionError(node.operands[0].position, "no outcome at stated levels", expected)
    for quantity in named:
        for level in quantity.levels:
            if level.column in ALONG:
                yield level.wrong(f"no {level.column}: it is what is asked")
        for response in responses_of(quantity.name, recorded):
            if "velocity_m_s" in recorded.response(response).terms.columns:
                yield quantity.wrong(f"an outcome of a {response} that does not depend on the velocity")


def searched(node: Node) -> set[Quantity]:
    """The quantities of a question whose motion is what is asked."""
    searches = (one for one in nodes(node) if isinstance(one, Critical))
    return {quantity for search in searches for quantity in quantities(search)}


def _open(quantity: Quantity, recorded: Recorded, posterior: xr.Dataset | None) -> list[str]:
    if posterior is None and not is_response(quantity, recorded):
        return []
    return open_columns(quantity, recorded, posterior)


def _of_several(
    operands: Sequence[Node], recorded: Recorded, posterior: xr.Dataset, position: int, symbol: str
) -> Iterator[QuestionError]:
    """What is averaged together must be of the same levels."""
    kinds = set()
    for quantity in (quantity for operand in operands for quantity in quantities(operand)):
        if any(mistakes(quantity, recorded, posterior, within=True)):
            return
        free = open_columns(quantity, recorded, posterior)
        if free and is_response(quantity, recorded):
            kinds.add((free[0], tuple(str(c[free[0]]) for c in conditions_of(quantity, recorded))))
        elif free:
            kinds |= {(name, tuple(posterior[name].astype(str).to_numpy())) for name in free}
    if len(kinds) > 1:
        actual = " and ".join(sorted(f"{len(levels)} of {name}" for name, levels in kinds))
        yield QuestionError(position, actual, f"the same levels throughout {symbol}()")


def _of_quantity(
    quantity: Quantity, recorded: Recorded, posterior: xr.Dataset | None
) -> Iterator[QuestionError]:
    if is_response(quantity, recorded):
        yield from _of_response(quantity, recorded)
        return
    if posterior is None:
        return
    if quantity.name not in posterior:
        names = list(dict.fromkeys([*recorded.formulas, *OUTCOMES, *map(str, posterior.data_vars)]))
        yield quantity.wrong("a quantity of this run", _near(quantity.name, names))
        return
    array = posterior[quantity.name]
    if "kept_draw" in array.dims:
        expected = "a quantity whose draws were all kept; of so many impacts single ones were kept in part"
        yield quantity.wrong(expected)
        return
    dims = [str(name) for name in array.dims if name not in DRAWN]
    for level in quantity.levels:
        if level.column not in dims:
            what = (
                f"of {quantity.name}: {', '.join(dims)}"
                if dims
                else f"no brackets: {quantity.name} is one number"
            )
            yield level.wrong(what, _near(level.column, dims))
        elif level.value is not None:
            labels = [str(label) for label in array[level.column].to_numpy()]
            if level.value not in labels:
                yield _strange(level, labels)


def _of_response(quantity: Quantity, recorded: Recorded) -> list[QuestionError]:
    errors = list(_of_levels(quantity, recorded))
    free = [level for level in quantity.levels if level.value is None]
    if not errors and free and not conditions_of(quantity, recorded):
        expected = f"a {free[0].column} that was recorded with the rest of these brackets"
        errors.append(free[0].wrong(expected))
    return errors


def _of_levels(quantity: Quantity, recorded: Recorded) -> Iterator[QuestionError]:
    needed = _columns_of(quantity.name, recorded)
    free = [level for level in quantity.levels if level.value is None]
    for level in free[1:]:
        yield level.wrong("one column without a level at most")
    velocities = [level for level in quantity.levels if level.column in ("velocity_m_s", DROP_HEIGHT)]
    if quantity.name in OUTCOMES and len(velocities) > 1 and DROP_HEIGHT not in recorded.needed:
        first, second, *_ = velocities
        yield second.wrong(f"{first.column} alone")
    for level in quantity.levels:
        moves = {level.column, *recorded.followers(level.column)} & set(needed)
        known = level.column in recorded.rows or (level.column in MOTION and quantity.name in OUTCOMES)
        if not known or not (moves or free):
            usable = [str(c) for c in recorded.rows if {str(c), *recorded.followers(str(c))} & set(needed)]
            which = first_of(usable, SETTINGS.listed) or "none"
            expected = f"a column that {quantity.name} depends on here: {which}"
            formulas = [recorded.formulas[q] for q in responses_of(quantity.name, recorded)]
            remedy = f'The formula is "{formulas[0]}". {_near(level.column, usable)}'
            yield level.wrong(expected, remedy)
        elif level.value is None:
            if level.column not in recorded.named:
                yield level.wrong(f"{level.column}=number, since it has no levels")
        elif _is_number(level.column, recorded):
            yield from _of_number(level)
        else:
            levels = recorded.levels(level.column)
            drawn = [NEW] if recorded.may_be_new(level.column) else []
            if level.value not in (*levels, *drawn):
                yield _strange(level, [*levels, *drawn])


def _of_number(level: Level) -> Iterator[QuestionError]:
    try:
        value = float(str(level.value))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        yield level.wrong_value(f"a number after {level.column}=")
    elif level.column in _ABOVE_ZERO and value <= 0:
        yield level.wrong_value(_ABOVE_ZERO[level.column])


def _is_number(column: str, recorded: Recorded) -> bool:
    """Whether a value of this column is a number: a group's levels are names, also where they are numbers."""
    return column not in recorded.named and (column in recorded.rows or column in MOTION)


def _strange(level: Level, levels: Sequence[str]) -> QuestionError:
    expected = f"a level of {level.column}: {first_of(levels, SETTINGS.listed) or 'none'}"
    return level.wrong_value(expected, _near(str(level.value), levels))


def _near(name: str, names: Sequence[str]) -> str:
    small = {one.casefold(): one for one in reversed(names)}
    matches = [small[one] for one in difflib.get_close_matches(name[:100].casefold(), small, n=3, cutoff=0.5)]
    return f"Near: {', '.join(matches)}." if matches else ""


_OPERATORS: dict[str, Callable[..., Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "^": np.power,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "and": operator.and_,
    "or": operator.or_,
    "not": operator.invert,
    "between": lambda middle, low, high: (middle >= low) & (middle <= high),
    "abs": abs,
    "exp": np.exp,
    "log": np.log,
}
# Whence what is no finite number comes.
_WHY = {
    "/": "a division by 0",
    "log": "the log of 0 or of a negative number",
    "^": "a root of a negative number",
}
_REDUCED: dict[str, Callable[..., Any]] = {"max": np.maximum, "min": np.minimum, "mean": operator.add}


def draws_of(node: Node, study: Study) -> xr.DataArray:
    """True or false, or a number, in each draw: [chain, draw].

    Args:
        node: a question without mistakes: see `bayestissue.inference.answers.meaning.mistakes`.
        study: of which, by posterior or prior.

    Raises:
        KeyError: its draws lack a variable.
        QuestionError: a number is none in some draws, as the log of a negative one.
    """
    node = as_recorded(node, study.recorded, study.draws)
    with np.errstate(all="ignore"):
        return _in_each(node, study)


def _in_each(node: Node, study: Study) -> xr.DataArray:
    """The value in each draw, also where it is the same in all."""
    value = _value(node, study)
    blank = xr.zeros_like(study.draws[DRAWN[0]] * study.draws[DRAWN[1]])
    return (value | blank.astype(bool)) if claims(node) else value + blank


def _value(node: Node, study: Study) -> xr.DataArray:
    if isinstance(node, Number):
        return xr.DataArray(node.value)
    if isinstance(node, Quantity):
        return _quantity_draws(node, study)
    if isinstance(node, Critical):
        return _critical_draws(node, study)
    values = [_value(operand, study) for operand in node.operands]
    value = _over_levels(node.symbol, values) if node.symbol in OF_MANY else _OPERATORS[node.symbol](*values)
    if not node.claims and (wrong := int((~np.isfinite(value)).sum())):
        what = "no number" if np.isnan(value).any() else "too large a number"
        where = f"{what} in {wrong} of {value.size} draws"
        remedy = f"As of {_WHY[node.symbol]}." if node.symbol in _WHY else ""
        raise QuestionError(node.position, where, "a finite number in every draw", remedy)
    return value


def _critical_draws(node: Critical, study: Study) -> xr.DataArray:
    outcome = next(quantity for quantity in quantities(node) if quantity.name in OUTCOMES)
    if not study.law.anywhere:
        raise outcome.wrong("a run with a law of force", str(NO_LAW))
    if node.column == DROP_HEIGHT and not study.law.gravity:
        expected = "velocity_m_s, since this dataset states no gravity along the motion"
        raise QuestionError(node.position, DROP_HEIGHT, expected)
    coords = {name: study.draws[name].to_numpy() for name in DRAWN}
    return xr.DataArray(critical_motion(node, study, _in_each), coords, DRAWN)


def _over_levels(symbol: str, values: list[xr.DataArray]) -> xr.DataArray:
    """The greatest, least or mean of all values, and of all levels within each."""
    if symbol != "mean":
        reduced = [getattr(array, symbol)([d for d in array.dims if d not in DRAWN]) for array in values]
        return reduce(_REDUCED[symbol], reduced)
    reduced = [array.mean([d for d in array.dims if d not in DRAWN]) for array in values]
    return reduce(_REDUCED[symbol], reduced) / len(reduced)


def _quantity_draws(quantity: Quantity, study: Study) -> xr.DataArray:
    if is_response(quantity, study.recorded):
        conditions = conditions_of(quantity, study.recorded)
        if quantity.name in OUTCOMES:
            require_motions(quantity, study, conditions)
        values = study.at([quantity.name], conditions)[quantity.name]
        free = open_columns(quantity, study.recorded, study.draws)
        if not free:
            return values.isel(condition=0)
        labels = [str(condition[free[0]]) for condition in conditions]
        return values.rename(condition=free[0]).assign_coords({free[0]: labels})
    array = study.draws[quantity.name]
    for level in quantity.levels:
        if level.value is not None:
            labels = array[level.column].astype(str).to_numpy().tolist()
            array = array.isel({level.column: labels.index(level.value)})
    return array.reset_coords(drop=True)


def require_motions(quantity: Quantity, study: Study, conditions: Sequence[Condition]) -> None:
    """Refuse an outcome in conditions where it has no value.

    Raises:
        QuestionError: there is no law, no velocity, or a height without gravity; or what hits is no headform.
    """
    law = study.law
    if not law.anywhere:
        raise quantity.wrong("a run with a law of force", str(NO_LAW))
    if beyond_law := [condition for condition in conditions if not study.holds(condition)]:
        expected = f"levels at which a law of force holds: {study.held(beyond_law[0])}"
        raise quantity.wrong(expected, str(NO_LAW))
    if expected := unfit_height(study.recorded, conditions[0], law.gravity):
        raise QuestionError(quantity.position, DROP_HEIGHT, expected)
    if not (study.motion(conditions)["velocity_m_s"] > 0).all():
        raise quantity.wrong("velocity_m_s=number in its brackets")
    if quantity.name in LONGEST and not law.headform:
        raise quantity.wrong("a run whose dataset.toml says headform = true in the table [impactor]")
