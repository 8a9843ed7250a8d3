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
from collections import ChainMap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import xarray as xr

from bayestissue.base.errors import Coded
from bayestissue.base.outcome_table import HEADFORM_OUTCOMES as OUTCOMES
from bayestissue.base.outline import first_of
from bayestissue.inference.answers.grammar import (
    OF_MANY,
    Choice,
    Critical,
    Level,
    Node,
    Operation,
    Quantity,
    QuestionError,
)
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import DROP_HEIGHT, MOTION, NO_LAW, beyond, unfit_height
from bayestissue.inference.answers.study import DRAWN, Study
from bayestissue.inference.results.labels import variables
from bayestissue.mechanics.elements.head_injury import LONGEST
from bayestissue.model.hierarchy.levels import NEW
from bayestissue.model.hierarchy.recorded import Condition, Recorded
from bayestissue.recordings.dataset.cells import ignoring_case, in_whatever_case

# The columns of the motion that a claim may be followed along.
ALONG = (DROP_HEIGHT, "velocity_m_s")
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


def open_levels(quantity: Quantity, study: Study) -> dict[str, list[str]]:
    """The columns or dimensions that it gives no level of, with all levels that it has of each.

    Of a variable there are none before there are draws.
    """
    if is_response(quantity, study.recorded):
        conditions = conditions_of(quantity, study.recorded)
        return {one.column: [str(at[one.column]) for at in conditions] for one in quantity.free}
    dims = study.draws[quantity.name].dims if study.draws else ()
    left = [str(name) for name in dims if name not in (*DRAWN, *quantity.given)]
    return {name: _labels(study.draws, name) for name in left}


def condition_of(quantity: Quantity, recorded: Recorded) -> dict[str, str | float]:
    """What is given in the brackets of a response."""
    levels = quantity.given.items()
    return {column: float(value) if takes_number(column, recorded) else value for column, value in levels}


def conditions_of(quantity: Quantity, recorded: Recorded) -> list[Condition]:
    """The condition of a response, or one for each level of its open column that was recorded so."""
    condition = condition_of(quantity, recorded)
    if not quantity.free:
        return [condition]
    # What the response does not depend on chooses among what was recorded.
    moved, column = _columns_of(quantity.name, recorded), quantity.free[0].column
    named = {k: v for k, v in condition.items() if v != NEW and (isinstance(v, str) or k not in moved)}
    return [condition | {column: level} for level in recorded.levels(column, named)]


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
        return MOTION[node.column][1]
    if not (isinstance(node, Choice) or node.symbol in _KEEP_UNIT):
        return ""
    units = {unit_of(operand, posterior) for operand in node.operands}
    return units.pop() if len(units) == 1 else ""


def mistakes(node: Node, study: Study, *, within: bool = False) -> Iterator[QuestionError]:
    """What can't be answered in a question, from left to right.

    Args:
        node: the question.
        study: of which; before it has draws only responses can be judged.
        within: whether a quantity may have a value for each level.
    """
    if isinstance(node, Quantity):
        errors = list(_of_quantity(node, study))
        yield from errors
        if not errors and not within and (free := open_levels(node, study)):
            column = next(iter(free))
            expected = f"one level of {column}, or {node.name} within {'(), '.join(OF_MANY)}()"
            such = f"Such as {node.name}[{column}=...] or mean({node.name}[{column}])."
            yield QuestionError(node.position, f"{node.name} of every {column}", expected, such)
    elif isinstance(node, Choice):
        yield from _of_choice(node, study)
    else:
        if isinstance(node, Critical):
            yield from _of_critical(node, study.recorded)
        many = node.symbol in OF_MANY
        within = (within or many) and not isinstance(node, Critical)
        for operand in node.operands:
            yield from mistakes(operand, study, within=within)
        if many:
            yield from _of_several(node.operands, study, node.position, node.symbol)


def as_recorded(node: Node, study: Study) -> Node:
    """The question with its columns and levels as they were recorded, in whatever case it names them."""
    recorded, draws = study.recorded, study.draws
    columns = list(dict.fromkeys([*map(str, recorded.rows), *MOTION, *map(str, draws.dims)]))

    def named(level: Level, arrays: str) -> Level:
        column, labels = in_whatever_case(level.column, columns), []
        if column in recorded.named:
            labels = [*recorded.levels(column), NEW]
        elif arrays in draws and column in draws[arrays].dims:
            labels = _labels(draws, column)
        value = None if level.value is None else ignoring_case(level.value, labels)
        return replace(level, column=column, value=value)

    def changed(part: Node) -> Node:
        if isinstance(part, Quantity):
            return replace(part, levels=tuple(named(level, part.name) for level in part.levels))
        if isinstance(part, Operation):
            part = replace(part, column=in_whatever_case(part.column, columns))
        return part.changed(changed)

    return changed(node)


def at_level(node: Node, column: str, value: str | None, position: int) -> Node:
    """A question in which every quantity that does not name a column has this level of it.

    Args:
        node: the question.
        column: which.
        value: the level; None for all of them.
        position: what messages point at.
    """
    if not isinstance(node, Quantity):
        return node.changed(lambda part: at_level(part, column, value, position))
    if any(level.column == column for level in node.levels):
        return node
    return replace(node, levels=(*node.levels, Level(column, value, position, position)))


def alternatives(node: Choice, study: Study) -> dict[str, Node]:
    """What a choice compares: each level of its column, and the operand there."""
    (operand,) = node.operands
    named = at_level(operand, node.column, None, node.position).quantities()
    levels = ChainMap(*(open_levels(quantity, study) for quantity in named)).get(node.column, [])
    return {label: at_level(operand, node.column, label, node.position) for label in levels}


def _labels(draws: xr.Dataset, dimension: str) -> list[str]:
    return draws[dimension].astype(str).to_numpy().tolist()


def _of_choice(node: Choice, study: Study) -> Iterator[QuestionError]:
    """What can't be answered in a choice: as of all its levels, of which there must be two."""
    (operand,) = node.operands
    if not operand.quantities():
        yield QuestionError(operand.position, "a number", "a quantity that levels may differ in")
        return
    of_all = at_level(operand, node.column, None, node.position)
    if set(operand.quantities()) <= set(of_all.quantities()):
        yield QuestionError(
            operand.position, "one number for all", f"a quantity of which levels of {node.column} may differ"
        )
        return
    errors = list(mistakes(of_all, study, within=True))
    errors = errors or list(_of_several([of_all], study, node.position, "best"))
    yield from errors
    if not errors and len(alternatives(node, study)) == 1:
        yield QuestionError(node.position, f"one level of {node.column}", "a column of two levels at least")


def _of_critical(node: Critical, recorded: Recorded) -> Iterator[QuestionError]:
    """What can't be answered in the search of a motion, beside the claim itself."""
    if node.column not in ALONG:
        wanted, near = f"one of {', '.join(ALONG)}", _near(node.column, [*ALONG])
        yield QuestionError(node.position, node.column, wanted, near)
        return
    named = outcomes_in(node, recorded)
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
    return {one for part in node.parts() if isinstance(part, Critical) for one in part.quantities()}


def outcomes_in(node: Node, recorded: Recorded) -> list[Quantity]:
    """The outcomes at given levels that a question names."""
    return [one for one in node.quantities() if one.name in OUTCOMES and is_response(one, recorded)]


def _of_several(
    operands: Sequence[Node], study: Study, position: int, symbol: str
) -> Iterator[QuestionError]:
    """What is averaged together must be of the same levels, which show once there are draws."""
    kinds = set()
    for quantity in (one for operand in operands for one in operand.quantities() if study.draws):
        if any(mistakes(quantity, study, within=True)):
            return
        kinds |= {(name, tuple(levels)) for name, levels in open_levels(quantity, study).items()}
    if len(kinds) > 1:
        actual = " and ".join(sorted(f"{len(levels)} of {name}" for name, levels in kinds))
        yield QuestionError(position, actual, f"the same levels throughout {symbol}()")


def _of_quantity(quantity: Quantity, study: Study) -> Iterator[QuestionError]:
    recorded, draws = study.recorded, study.draws
    if is_response(quantity, recorded):
        yield from _of_response(quantity, recorded)
    elif draws and quantity.name not in draws:
        names = list(dict.fromkeys([*recorded.formulas, *OUTCOMES, *map(str, draws.data_vars)]))
        yield quantity.wrong("a quantity of this run", _near(quantity.name, names))
    elif draws and "kept_draw" in draws[quantity.name].dims:
        expected = "a quantity whose draws were all kept; of so many impacts single ones were kept in part"
        yield quantity.wrong(expected)
    elif draws:
        dims = [str(name) for name in draws[quantity.name].dims if name not in DRAWN]
        of_it = f"of {quantity.name}: {', '.join(dims)}" if dims else ""
        for level in quantity.levels:
            if level.column not in dims:
                what = of_it or f"no brackets: {quantity.name} is one number"
                yield level.wrong(what, _near(level.column, dims))
            elif level.value not in (None, *(labels := _labels(draws, level.column))):
                yield _strange(level, labels)


def _of_response(quantity: Quantity, recorded: Recorded) -> list[QuestionError]:
    errors = list(_of_levels(quantity, recorded))
    if not errors and quantity.free and not conditions_of(quantity, recorded):
        (level,) = quantity.free
        errors = [level.wrong(f"a {level.column} that was recorded with the rest of these brackets")]
    return errors


def _of_levels(quantity: Quantity, recorded: Recorded) -> Iterator[QuestionError]:
    needed, of_outcome = set(_columns_of(quantity.name, recorded)), quantity.name in OUTCOMES
    for level in quantity.free[1:]:
        yield level.wrong("one column without a level at most")
    velocities = [level for level in quantity.levels if level.column in ("velocity_m_s", DROP_HEIGHT)]
    if of_outcome and len(velocities) > 1 and DROP_HEIGHT not in recorded.needed:
        first, second, *_ = velocities
        yield second.wrong(f"{first.column} alone")

    def moves(column: str) -> bool:
        return not needed.isdisjoint({column, *recorded.followers(column)})

    for level in quantity.levels:
        column, value = level.column, level.value
        known = column in recorded.rows or (column in MOTION and of_outcome)
        if not known or not (quantity.free or moves(column)):
            usable = list(filter(moves, map(str, recorded.rows)))
            which = first_of(usable, SETTINGS.listed) or "none"
            formula = recorded.formulas[responses_of(quantity.name, recorded)[0]]
            expected = f"a column that {quantity.name} depends on here: {which}"
            yield level.wrong(expected, f'The formula is "{formula}". {_near(column, usable)}')
        elif value is None:
            if column not in recorded.named:
                yield level.wrong(f"{column}=number, since it has no levels")
        elif takes_number(column, recorded):
            if not math.isfinite(number := as_number(value)):
                yield level.wrong_value(f"a number after {column}=")
            elif column in MOTION and number <= 0:
                yield level.wrong_value("a {} above 0 {}".format(*MOTION[column]))
        else:
            levels = [*recorded.levels(column), *([NEW] if recorded.may_be_new(column) else [])]
            if value not in levels:
                yield _strange(level, levels)


def takes_number(column: str, recorded: Recorded) -> bool:
    """Whether a value of this column is a number: a group's levels are names, also where they are numbers."""
    return column not in recorded.named and (column in recorded.rows or column in MOTION)


def as_number(text: str) -> float:
    """The number that a text is; NaN where it is none."""
    with suppress(ValueError):
        return float(text)
    return math.nan


def _strange(level: Level, levels: Sequence[str]) -> QuestionError:
    expected = f"a level of {level.column}: {first_of(levels, SETTINGS.listed) or 'none'}"
    return level.wrong_value(expected, _near(str(level.value), levels))


def _near(name: str, names: Sequence[str]) -> str:
    small = {one.casefold(): one for one in reversed(names)}
    matches = [small[one] for one in difflib.get_close_matches(name[:100].casefold(), small, n=3, cutoff=0.5)]
    return f"Near: {', '.join(matches)}." if matches else ""


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
