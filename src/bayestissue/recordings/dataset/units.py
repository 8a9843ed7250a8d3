"""Units as people write them, turned into the factor that leads to SI."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Literal, get_args

from bayestissue.base.declarations import declared

if TYPE_CHECKING:
    import pint

Dimension = Literal["acceleration", "length", "force", "time"]

DECLARED = declared(__package__, "units.toml")
EXAMPLES: dict[Dimension, str] = {name: DECLARED[name]["example"] for name in get_args(Dimension)}
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
    if (known := DECLARED[dimension]["common"].get(unit.strip())) is not None:
        return float(known)
    import pint

    if not unit.strip() or len(unit) > 40 or _ABSURD.search(unit):
        raise ValueError(f"{unit!r} is not a unit")
    try:
        return float(_registry().Quantity(1, _registry().parse_units(unit)).m_as(DECLARED[dimension]["si"]))
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
