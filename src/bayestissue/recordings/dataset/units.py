"""Units as people write them, turned into the factor that leads to SI."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import pint

Dimension = Literal["acceleration", "length", "force", "time"]

EXAMPLES: dict[Dimension, str] = {
    "acceleration": 'a unit of acceleration, such as "m/s^2", "g" or "mm/s^2"',
    "length": 'a unit of length, such as "m", "mm" or "µm"',
    "force": 'a unit of force, such as "N", "kN" or "lbf"',
    "time": 'a unit of time, such as "s", "ms" or "µs"',
}
_SI: dict[Dimension, str] = {"acceleration": "m/s^2", "length": "m", "force": "N", "time": "s"}
# Reading the definitions of all units takes a second: these need none.
COMMON: dict[Dimension, dict[str, float]] = {
    "acceleration": {"m/s^2": 1.0, "m/s**2": 1.0, "mm/s^2": 1e-3, "g": 9.80665, "g_0": 9.80665},
    "length": {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "um": 1e-6},
    "force": {"N": 1.0, "kN": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "us": 1e-6},
}

# A power of a power, or a long number, could keep the parser busy for ever and is no unit anyway.
_ABSURD = re.compile(r"\d\d|(\^|\*\*)[^/*]*(\^|\*\*)")


def to_si(unit: str, dimension: Dimension) -> float:
    """The number of SI units in one ``unit``; a bare ``"g"`` as an acceleration is standard gravity.

    Args:
        unit: as written, such as ``"mm"``, ``"m/s^2"`` or ``"g_0"``.
        dimension: what it must measure.

    Raises:
        ValueError: the unit is unknown, or measures something else.
    """
    if (known := COMMON[dimension].get(unit.strip())) is not None:
        return known
    import pint

    if not unit.strip() or len(unit) > 40 or _ABSURD.search(unit):
        raise ValueError(f"{unit!r} is not a unit")
    try:
        return float(_registry().Quantity(1, _registry().parse_units(unit)).m_as(_SI[dimension]))
    except pint.errors.DimensionalityError as error:
        raise ValueError(f"{unit!r} does not measure {dimension}") from error
    except Exception as error:
        # The parser raises whatever its tokenizer and operators happen to raise on nonsense.
        raise ValueError(f"{unit!r} is not a unit") from error


def dimension_of(unit: str, dimensions: Iterable[Dimension] = EXAMPLES) -> Dimension | None:
    """Which of ``dimensions`` a unit measures; None where it measures none of them."""
    for dimension in dimensions:
        with suppress(ValueError):
            to_si(unit, dimension)
            return dimension
    return None


@cache
def _registry() -> pint.UnitRegistry:
    import pint

    return pint.UnitRegistry()
