"""The value of a question in each draw.

Where a claim ends to hold, f(V) is the difference of its two sides, below 0 where it holds: each draw has the
V of f(V) = 0, the greatest velocity up to which the claim holds in it. A drop height is h = V² / (2 g). The
lower end of the 90 % interval is where the claim holds with 95 % probability: the limit with a guard band of
JCGM 106:2012.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from scipy.optimize import elementwise

from bayestissue.base.impact_arrays import PerDraw
from bayestissue.base.outcome_table import HEADFORM_OUTCOMES as OUTCOMES
from bayestissue.inference.answers.grammar import OF_MANY, Critical, Node, Number, Quantity, QuestionError
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import DROP_HEIGHT, NO_LAW, fall_height
from bayestissue.inference.answers.meaning import (
    as_recorded,
    conditions_of,
    is_response,
    open_levels,
    outcomes_in,
    require_motions,
)
from bayestissue.inference.answers.study import DRAWN, Study

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
# In place of an infinite difference of two sides.
_INFINITE = 1e100
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
    node = as_recorded(node, study)
    with np.errstate(all="ignore"):
        return _in_each(node, study)


def _in_each(node: Node, study: Study) -> xr.DataArray:
    """The value in each draw, also where it is the same in all."""
    value = _value(node, study)
    blank = xr.zeros_like(study.draws[DRAWN[0]] * study.draws[DRAWN[1]])
    return (value | blank.astype(bool)) if node.claims else value + blank


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


def _over_levels(symbol: str, values: list[xr.DataArray]) -> xr.DataArray:
    """The greatest, least or mean of all values, and of all levels within each."""
    reduced = [getattr(array, symbol)([d for d in array.dims if d not in DRAWN]) for array in values]
    total = reduce(_REDUCED[symbol], reduced)
    return total / len(reduced) if symbol == "mean" else total


def _quantity_draws(quantity: Quantity, study: Study) -> xr.DataArray:
    if not is_response(quantity, study.recorded):
        array = study.draws[quantity.name]
        labels = {column: array[column].astype(str) for column in quantity.given}
        return array.assign_coords(labels).sel(quantity.given).reset_coords(drop=True)
    conditions = conditions_of(quantity, study.recorded)
    if quantity.name in OUTCOMES:
        require_motions(quantity, study, conditions)
    values = study.at([quantity.name], conditions)[quantity.name]
    if not quantity.free:
        return values.isel(condition=0)
    return values.rename(condition=quantity.free[0].column).assign_coords(open_levels(quantity, study))


def _critical_draws(node: Critical, study: Study) -> xr.DataArray:
    """The greatest value of the column up to which the claim holds, [chain, draw]."""
    if not study.law.anywhere:
        raise outcomes_in(node, study.recorded)[0].wrong("a run with a law of force", str(NO_LAW))
    if node.column == DROP_HEIGHT and not study.law.gravity:
        expected = "velocity_m_s, since this dataset states no gravity along the motion"
        raise QuestionError(node.position, DROP_HEIGHT, expected)
    V = _critical_velocities(node, study)
    coords = {name: study.draws[name].to_numpy() for name in DRAWN}
    return xr.DataArray(fall_height(V) if node.column == DROP_HEIGHT else V, coords, DRAWN)


def _critical_velocities(node: Critical, study: Study) -> PerDraw:
    """The greatest velocity up to which the claim holds [m/s].

    The claim is judged at velocities from `AnswerSettings.slowest` to `AnswerSettings.fastest` in some draws,
    closer and closer about its end in them. There the end is solved for in all draws, by the method of
    Chandrupatla (1997, doi:10.1016/S0965-9978(96)00051-8), and from all of these velocities where it is
    elsewhere. It is 0 where the claim holds at no velocity, infinite where it holds at all of them.

    Raises:
        QuestionError: the claim holds again at a greater velocity, or has no number at one.
    """
    (claim,) = node.operands
    sign = 1.0 if claim.symbol in ("<", "<=") else -1.0
    chains, length = (study.draws.sizes[name] for name in DRAWN)
    # As one chain, of which any draws can be chosen; of single impacts only what is asked.
    needed = study.draws.drop_dims("kept_draw", errors="ignore")
    named = {quantity.name for quantity in claim.quantities()}
    needed = needed[[name for name in needed if name in named or "impact" not in needed[name].dims]]
    draws = needed.stack(number=DRAWN).reset_index("number")
    draws = draws.drop_vars(DRAWN).rename(number="draw").expand_dims("chain").transpose(*DRAWN, ...)

    def difference(velocity: Float[np.ndarray, " draw"], numbers: Int[np.ndarray, " draw"]) -> np.ndarray:
        """Below 0 where the claim holds, above where a side is no number; finite, to be solved for."""
        moved = replace(study, draws=draws.isel(draw=numbers), velocity_m_s=velocity[None])
        left, right = (_in_each(side, moved).to_numpy()[0] for side in claim.operands)
        return np.nan_to_num(sign * (left - right), nan=_INFINITE, posinf=_INFINITE, neginf=-_INFINITE)

    def bracketed(low: float, high: float, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The two velocities about the claim's end in some draws, and the differences there, [side, draw]."""
        ends = np.geomspace(low, high, SETTINGS.velocities)
        of_all = difference(np.repeat(ends, len(numbers)), np.tile(numbers, len(ends))).reshape(len(ends), -1)
        holds = of_all < 0
        if (holds[1:] & ~holds[:-1]).any():
            expected = f"a claim that holds up to one {node.column} and no longer above it"
            raise QuestionError(node.position, node.column, expected)
        last = holds.sum(axis=0) - 1
        sides = np.clip([last, last + 1], 0, len(ends) - 1)
        return ends[sides], np.take_along_axis(of_all, sides, axis=0)

    low, high = slowest, fastest = SETTINGS.slowest, SETTINGS.fastest
    tried = np.unique(np.linspace(0, length - 1, max(SETTINGS.tried // chains, 1)).astype(int))
    for _ in range(3):
        sides, _ = bracketed(low, high, np.add.outer(length * np.arange(chains), tried).ravel())
        low, high = float(sides.min()), float(sides.max())
        # As far to either side again: other draws end beyond these.
        low, high = max(low * low / high, slowest), min(high * high / low, fastest)
    index = np.arange(chains * length)
    sides = np.stack([np.full(len(index), end) for end in (low, high)])
    f = np.stack([difference(velocity, index) for velocity in sides])
    elsewhere = np.flatnonzero((~(f[0] < 0) & (low > slowest)) | ((f[1] < 0) & (high < fastest)))
    if len(elsewhere):
        sides[:, elsewhere], f[:, elsewhere] = bracketed(slowest, fastest, elsewhere)
    V = np.where(f[0] < 0, np.inf, 0.0)
    solved = np.flatnonzero((f[0] < 0) & ~(f[1] < 0))
    if len(solved):
        V[solved] = elementwise.find_root(
            difference, tuple(sides[:, solved]), args=(solved,), tolerances={"xrtol": SETTINGS.of_velocity}
        ).x
    return V.reshape(chains, length)
