"""The draws of a question: what its tree is worth in each draw of the posterior, or of the prior."""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
import xarray as xr

from bayestissue.hierarchy.levels import Recorded, log_at_levels
from bayestissue.inference.answers.grammar import OF_MANY, Node, Number, Quantity, QuestionError, claims
from bayestissue.inference.answers.meaning import conditions_of, is_response, open_columns

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
_DRAWN = ("chain", "draw")


def draws_of(node: Node, draws: xr.Dataset, recorded: Recorded) -> xr.DataArray:
    """True or false, or a number, in each draw: [chain, draw].

    Args:
        node: a question without mistakes: see `bayestissue.inference.answers.meaning.mistakes`.
        draws: the group posterior or prior.
        recorded: of the run.

    Raises:
        KeyError: these draws lack a variable.
        QuestionError: a number is none in some draws, as the log of a negative one.
    """
    with np.errstate(all="ignore"):
        value = _value(node, draws, recorded)
        blank = xr.zeros_like(draws[_DRAWN[0]] * draws[_DRAWN[1]])
        return (value | blank.astype(bool)) if claims(node) else value + blank


def _value(node: Node, draws: xr.Dataset, recorded: Recorded) -> xr.DataArray:
    if isinstance(node, Number):
        return xr.DataArray(node.value)
    if isinstance(node, Quantity):
        return _of_quantity(node, draws, recorded)
    values = [_value(operand, draws, recorded) for operand in node.operands]
    value = _of_several(node.symbol, values) if node.symbol in OF_MANY else _OPERATORS[node.symbol](*values)
    if not node.claims and (wrong := int((~np.isfinite(value)).sum())):
        what = "no number" if np.isnan(value).any() else "too large a number"
        where = f"{what} in {wrong} of {value.size} draws"
        remedy = f"As of {_WHY[node.symbol]}." if node.symbol in _WHY else ""
        raise QuestionError(node.position, where, "a finite number in every draw", remedy)
    return value


def _of_several(symbol: str, values: list[xr.DataArray]) -> xr.DataArray:
    """The greatest, least or mean of all values, and of all levels within each."""
    if symbol != "mean":
        reduced = [getattr(array, symbol)([d for d in array.dims if d not in _DRAWN]) for array in values]
        return reduce(_REDUCED[symbol], reduced)
    reduced = [array.mean([d for d in array.dims if d not in _DRAWN]) for array in values]
    return reduce(_REDUCED[symbol], reduced) / len(reduced)


def _of_quantity(quantity: Quantity, draws: xr.Dataset, recorded: Recorded) -> xr.DataArray:
    if is_response(quantity, recorded):
        conditions = conditions_of(quantity, recorded)
        values = np.exp(log_at_levels(draws, recorded, quantity.name, conditions))
        free = open_columns(quantity, recorded, draws)
        coords = {name: draws[name].to_numpy() for name in _DRAWN}
        if not free:
            return xr.DataArray(values[..., 0], coords, _DRAWN)
        labels = [str(condition[free[0]]) for condition in conditions]
        return xr.DataArray(values, {**coords, free[0]: labels}, (*_DRAWN, free[0]))
    array = draws[quantity.name]
    for level in quantity.levels:
        if level.value is not None:
            labels = array[level.column].astype(str).to_numpy().tolist()
            array = array.isel({level.column: labels.index(level.value)})
    return array.reset_coords(drop=True)
