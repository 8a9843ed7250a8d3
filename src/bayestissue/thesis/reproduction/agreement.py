"""Whether a recomputed number agrees with the printed one, and if not, in which way it differs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd

# Far below any printed digit, far above the rounding error of a sum of ninety float64 numbers.
_FLOAT_ERROR = 1e-9


@dataclass(frozen=True)
class Recomputed:
    """A number that follows from the published tables.

    Attributes:
        value: the number, or None where it can't be derived.
        rounding: how far, at worst, the rounding of the printed inputs can have moved ``value``.
        note: said whether or not it agrees.
        hint: said first where it disagrees.
    """

    value: float | None
    rounding: float = 0.0
    note: str = ""
    hint: str = ""


class PublishedNumber(NamedTuple):
    """One published number beside the recomputed one: a row of ``reproduction.csv``."""

    table: str
    row: int
    quantity: str
    published: str
    reproduced: str
    agrees: bool | None
    note: str


def decimals(printed: str) -> int:
    """Digits after the decimal point of ``printed``."""
    return len(printed.partition(".")[2])


def half_unit(printed: str) -> float:
    """Half a unit of the last printed digit: the largest rounding error of ``printed``."""
    return 0.5 * 10.0 ** -decimals(printed)


def agrees(printed: str, value: float) -> bool:
    """Whether ``value``, rounded to the digits of ``printed``, is ``printed``.

    A value that lies exactly between two roundings agrees with both: which of them a program prints depends
    on its rule for halves, which the thesis doesn't state. Nothing looser is accepted.
    """
    slack = _FLOAT_ERROR * max(1.0, abs(value))
    return abs(value - float(printed)) <= half_unit(printed) + slack


type Rounded = tuple[float, float]
"""A number, and how far the rounding of what it follows from can have moved it."""


def difference(low: Rounded, high: Rounded) -> Rounded:
    """The range between two ends."""
    return high[0] - low[0], low[1] + high[1]


def ratio(low: Rounded, high: Rounded) -> Rounded:
    """The greater end over the smaller."""
    quotient = high[0] / low[0]
    return quotient, (high[1] + quotient * low[1]) / low[0]


def is_cut_off(printed: str, value: float) -> bool:
    """Whether ``printed`` is ``value`` with its further digits dropped instead of rounded."""
    scale = 10.0 ** decimals(printed)
    return abs(math.trunc(value * scale + math.copysign(_FLOAT_ERROR, value)) / scale - float(printed)) < (
        _FLOAT_ERROR
    )


def line(table: str, row: int, quantity: str, printed: str, recomputed: Recomputed) -> PublishedNumber:
    """Compare ``printed`` (empty where its cell is lost) with what was ``recomputed``."""
    value, agreed, notes = recomputed.value, None, [recomputed.note]
    if printed and value is not None:
        agreed = agrees(printed, value)
        if not agreed:
            notes = [recomputed.hint, _difference(printed, value, recomputed.rounding), recomputed.note]
    reproduced = "" if value is None else f"{value:.8g}"
    return PublishedNumber(table, row, quantity, printed, reproduced, agreed, "; ".join(filter(None, notes)))


def line_of(row: pd.Series, column: str, quantity: str, recomputed: Recomputed) -> PublishedNumber:
    """The `line` of the number that a ``row`` of a published table has in ``column``."""
    return line(row["table"], int(row["row"]), quantity, row[f"{column}_text"], recomputed)


def _difference(printed: str, value: float, rounding: float) -> str:
    number, difference = float(printed), float(printed) - value
    if is_cut_off(printed, value):
        return "cut off after the last printed digit instead of rounded"
    if abs(difference) <= rounding + half_unit(printed) + _FLOAT_ERROR:
        return "within what the rounding of the printed inputs allows"
    if "." in printed and any(
        abs(number * factor - value) <= 2 * factor * half_unit(printed) + _FLOAT_ERROR for factor in (10, 0.1)
    ):
        return "the decimal point stands one place off"
    if abs(difference) <= 2 * half_unit(printed) + _FLOAT_ERROR:
        return "one unit off in the last printed digit"
    return f"differs by {difference:+.3g}"
