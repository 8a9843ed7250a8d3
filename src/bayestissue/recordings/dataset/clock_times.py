"""Times of day in the cells of a table, such as ``2020-11-11 13:25:24.320``, as seconds."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float64

# For RE2: a date of digits, hours, minutes, seconds with decimals, half of the day, zone.
_CELL = (
    r"^\s*(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[ T,]+)?"
    r"(?:(?P<h>\d{1,2}):)?(?P<m>\d{1,2}):(?P<s>\d{1,2}(?:[.,]\d*)?)"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?:Z|UTC|[+-]\d{2}:?\d{2})?\s*$"
)
DAY_S, _HOUR_S = 86_400, 3_600.0


def seconds(cells: pa.Array) -> tuple[Float64[np.ndarray, " row"], float] | None:
    """The time of each cell since the first one, s, and of the first one; not a number where a cell has none.

    A new day is where the time of day runs back, not where the date changes, which countries write in other
    orders; a new hour likewise where only minutes and seconds stand there.
    None where most cells hold no time of day.

    Args:
        cells: texts, of which missing ones are null.
    """
    first = next((text for text in (cell.as_py() for cell in cells[:100]) if text), "")
    if ":" not in first:
        return None
    parts = pc.extract_regex(cells, _CELL)
    filled = len(cells) - cells.null_count
    if not filled or 2 * (len(parts) - parts.null_count) <= filled:
        return None
    hour, minute, second = (_numbers(pc.struct_field(parts, name)) for name in ("h", "m", "s"))
    half = pc.utf8_lower(pc.struct_field(parts, "half")).to_numpy(zero_copy_only=False)
    has_hours = bool(np.isfinite(hour).any())
    # Twelve o'clock is the hour 0 of each half.
    hour = np.where(np.isin(half, ["am", "pm"]), hour % 12 + 12 * (half == "pm"), hour)
    time = (_HOUR_S * hour if has_hours else 0.0) + 60 * minute + second
    period = DAY_S if has_hours else _HOUR_S
    known = np.flatnonzero(np.isfinite(time))
    start = float(time[known[0]])
    turns = np.cumsum(np.diff(time[known], prepend=time[known[:1]]) < -period / 2)
    time[known] += period * turns - start
    return time, start


def within_a_day(later: float) -> float:
    """By what one time of day is behind another, s: of two days, of which one began between, too.

    Args:
        later: the one less the other, s; each since the beginning of its day.
    """
    return (later + DAY_S / 2) % DAY_S - DAY_S / 2


def _numbers(cells: pa.Array) -> np.ndarray:
    plain = pc.replace_substring(cells, ",", ".")
    plain = pc.if_else(pc.equal(plain, ""), None, plain)
    return plain.cast(pa.float64()).to_numpy(zero_copy_only=False).astype(np.float64)
