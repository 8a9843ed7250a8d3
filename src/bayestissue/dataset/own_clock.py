"""The times of a further channel, where the file has a clock for each."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bayestissue.dataset.clock_times import within_a_day
from bayestissue.dataset.formats import unit_in_name
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import Columns, Numbers
from bayestissue.dataset.units import dimension_of, to_si
from bayestissue.errors import InputError

_NAMED = re.compile(
    r"(?:^|[\W_])(?:time|timestamp|elapsed|zeit|uhrzeit|temps|tiempo|tempo|t)(?:[\W_\d]|$)", re.IGNORECASE
)
# Of a sampling interval: times that differ by less are alike.
_ALIKE = 0.25


def clocks_among(names: Sequence[str]) -> list[str]:
    """The names that say time, and state no unit of anything else."""
    units = {name: unit_in_name(name) for name in names if _NAMED.search(name)}
    return [name for name, unit in units.items() if dimension_of(unit) in (None, "time")]


def own_clock(
    names: Sequence[str],
    columns: Mapping[str, Numbers],
    signal: SignalSettings,
    first: SignalSettings,
    label: str,
) -> tuple[str, Numbers | None]:
    """The name and the times of a channel, in the unit and since the beginning of the first one's.

    Where the values of each channel stand behind times of their own, these are the nearest before them. Where
    the places do not tell, the first channel's times, if no others contradict them.

    Args:
        names: of all columns, in the order of the file.
        columns: those of `clocks_among`, and both channels' times.
        signal: the settings of the channel.
        first: those of the first one; of itself where there is one channel.
        label: what to call the file in a message.

    Raises:
        InputError: times that differ could all be the channel's.
    """
    shared = columns.get(first.time_column)
    if signal.time_column != first.time_column or shared is None:
        times = columns.get(signal.time_column)
        return signal.time_column, times if times is None else _as_beside(
            times, signal.time_column, shared, first
        )
    named = [name for name in names if name in {*clocks_among(names), first.time_column}]
    clocks = [name for name in named if name in columns and _rises(columns[name], shared)]

    def before(value: str) -> str | None:
        above = names[: names.index(value)] if value in names else ()
        return next((name for name in reversed(above) if name in clocks), None)

    own, of_first = before(signal.value_column), before(first.value_column)
    if own is not None and own != of_first == first.time_column:
        return own, _as_beside(columns[own], own, shared, first)
    # Times that no column of values stands behind.
    alone = {name for name, behind in pairwise([*names, first.time_column]) if behind in clocks}
    for name in clocks:
        times = _as_beside(columns[name], name, shared, first)
        if name in alone | {own, of_first} and _contradict(shared.array, times.array):
            listed = ", ".join(clocks)
            raise InputError.stated(
                "clock-and-channel.which", label, value=listed, channel=signal.value_column
            )
    return first.time_column, shared


def with_own_clock(
    read: Callable[..., Columns], signal: SignalSettings, first: SignalSettings | None, label: str
) -> tuple[Columns, SignalSettings]:
    """A table, a further channel's times by `own_clock`; and the settings with their name.

    Args:
        read: reads the channel's columns, and ``optional`` further ones.
        signal: the settings of the channel.
        first: those of the first channel; None where this is the first, or has a table of its own.
        label: what to call the file in a message.
    """
    table = read()
    others = {*clocks_among(table.names), signal.time_column} - {first.time_column if first else ""}
    if first is None or not others or first.time_column not in table.names:
        return table, signal
    table = read(optional=list({*clocks_among(table.names), first.time_column, signal.time_column}))
    name, times = own_clock(table.names, table.numbers, signal, first, label)
    if times is None:
        return table, signal
    return replace(table, numbers=table.numbers | {name: times}), signal.model_copy(
        update={"time_column": name}
    )


def _rises(times: Numbers, like: Numbers) -> bool:
    known = times.array[np.isfinite(times.array)]
    return times.seconds == like.seconds and known.size > 1 and bool(known[-1] > known[0])


def _as_beside(times: Numbers, name: str, shared: Numbers | None, first: SignalSettings) -> Numbers:
    """Times in the unit of others; times of day since the beginning of these."""
    if shared is None:
        return times
    if times.seconds and shared.seconds:
        return replace(times, array=times.array + within_a_day(times.start - shared.start))
    units = (times.unit or unit_in_name(name), shared.unit or unit_in_name(first.time_column))
    if units[0] == units[1] or {dimension_of(unit, ["time"]) for unit in units} != {"time"}:
        return times
    return replace(times, array=times.array * (to_si(units[0], "time") / to_si(units[1], "time")))


def _contradict(times: np.ndarray, others: np.ndarray) -> bool:
    """Whether two clocks ran at the same time, and show other times for the same rows."""
    times, others = (each[np.isfinite(each)] for each in (times, others))
    together = max(times.min(), others.min()) < min(times.max(), others.max())
    step = np.ptp(times) / (times.size - 1)
    return bool(together and (times.size != others.size or np.abs(times - others).max() > _ALIKE * step))
