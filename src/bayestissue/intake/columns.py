"""From what names and tables say to the columns of `impacts.csv`: numbers, units, heights of fall."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial

from bayestissue.dataset.model import STANDARD_GRAVITY
from bayestissue.errors import InputError, Problem

_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def _times(factor: float, value: float) -> float:
    return factor * value


def _fallen(unit_m: float, height: float) -> float:
    """The speed v = √(2 g h), m/s, after a fall, of a pendulum too, of ``height`` times ``unit_m`` metres."""
    return math.sqrt(2 * STANDARD_GRAVITY * unit_m * height)


# Of each name the column that it fills, and how; a height of fall stays as a covariate too.
_FILLS: dict[str, tuple[str, Callable[[float], float]]] = {
    "mass_g": ("mass_kg", partial(_times, 1e-3)),
    "velocity_cm_s": ("velocity_m_s", partial(_times, 1e-2)),
    "velocity_mm_s": ("velocity_m_s", partial(_times, 1e-3)),
    "diameter_mm": ("diameter_m", partial(_times, 1e-3)),
    "drop_height_m": ("velocity_m_s", partial(_fallen, 1.0)),
    "drop_height_cm": ("velocity_m_s", partial(_fallen, 1e-2)),
    "drop_height_mm": ("velocity_m_s", partial(_fallen, 1e-3)),
}
_NUMBERS = {"mass_kg", "velocity_m_s", "sampling_rate_hz", "energy_J", "diameter_m", *_FILLS}


def is_number(name: str) -> bool:
    """Whether a field of this name holds a number."""
    return name in _NUMBERS


def is_height(name: str) -> bool:
    """Whether a field is a height of fall."""
    return name.startswith("drop_height")


def fills(name: str) -> str:
    """The column of ``impacts.csv`` that a field fills: ``velocity_m_s`` for a height of fall."""
    return _FILLS[name][0] if name in _FILLS else name


def columns(fields: dict[str, str], file: str) -> dict[str, str | float]:
    """The cells of ``impacts.csv`` that the fields of a file fill.

    Args:
        fields: text by name; decimals may have a comma.
        file: what to call the file in a message.

    Raises:
        InputError: a number is none, or a height or mass is not above 0.
    """
    cells: dict[str, str | float] = {}
    problems = []
    for name, text in fields.items():
        if not is_number(name):
            cells[name] = text
            continue
        plain = text.strip().replace(",", ".")
        value = float(plain) if _PLAIN.fullmatch(plain) else math.nan
        if not 0 < value < math.inf:
            remedy = f"Correct {name} in the name of the file, in the table or in --set."
            problems.append(
                Problem(file, "a number above 0", remedy, column=name, value=text, code="impossible-value")
            )
            continue
        column, fill = _FILLS.get(name, (name, partial(_times, 1.0)))
        # Twelve digits are more than anybody measured, and fewer than show how 0.07 is kept.
        cells[column] = float(f"{fill(value):.12g}")
        if is_height(name):
            cells[name] = value
    if problems:
        raise InputError(problems)
    return cells
