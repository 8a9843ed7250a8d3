"""A dataset from tables and arrays at hand, by every check that a folder gets."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.declarations import taking
from bayestissue.base.errors import InputError, all_of, along_with, refuse
from bayestissue.recordings.dataset.cells import FILE as IMPACTS
from bayestissue.recordings.dataset.cells import Records, column_problems
from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
from bayestissue.recordings.dataset.dataset_file import (
    PLACES,
    ChannelSettings,
    Settings,
    SignalSettings,
    arguments,
    content_of,
    parse_settings,
    plain_value,
    reworded,
)
from bayestissue.recordings.dataset.formats.channel import Channel, Contents, Labels
from bayestissue.recordings.dataset.impact_table import ImpactTable, impact_table, required_columns
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.dataset.ragged_traces import Trace
from bayestissue.recordings.dataset.read import checked_dataset, in_words
from bayestissue.recordings.dataset.recorders import clocks_beside, long_recordings
from bayestissue.recordings.dataset.recordings import Recordings
from bayestissue.recordings.dataset.source_files import plain_text

# What messages call the tables, and the keys in them.
_LONG, _SINGLE = "traces (rows from 0)", "traces (samples from 0)"
_CALLED = {IMPACTS: "impacts (rows from 0)", SETTINGS: "arguments", _LONG: _LONG, _SINGLE: _SINGLE}
_NAMES = {
    **{f" {where} {SETTINGS}": "" for where in ("in", "to", "of", "than")},
    **{key: name for name, key in PLACES.items()},
    **{"channel.0": "channels", "[[channel]]": "channel in channels", IMPACTS: "the table impacts"},
    **{"the key ": "the argument ", "a table with": "a dictionary with"},
}


@taking({name: declared for name, declared in arguments().items() if name != "name"})
def dataset(
    impacts: pd.DataFrame | Mapping[str, Any] | Sequence[Mapping[str, Any]],
    traces: pd.DataFrame | Mapping[Any, Any] | Sequence[Any],
    *,
    channels: Mapping[str, Mapping[str, Any]] | Sequence[Mapping[str, Any]] | None = None,
    name: str = "from arrays",
    skip_bad: bool = False,
    **stated: Any,
) -> Dataset:
    """A dataset from pandas tables or arrays, checked as `read_dataset` checks a folder.

    Args:
        impacts: one row per impact, with the columns of ``impacts.csv``: ``impact``, ``subject``, ``trial``,
            ``mass_kg``, ``velocity_m_s`` (not needed of a displacement), and
            covariates. A table, columns by name, or records. A column ``trace`` is left out: recordings are
            ``traces``.
        traces: the recordings: one long table with a column ``impact`` beside the time and the value column;
            or by the impact's name, or in the order of ``impacts``, each a table of these two columns, a
            pair (time, value), an array of two rows or two columns, times first, or a `Trace`. What a masked
            array hides is left out at either end of a recording, and refused between.
        channels: a further channel of the same impacts, by its name: a dictionary with the keys of a table
            ``[[channel]]`` (``quantity``, ``place``, ``unit`` ...) and ``traces``, its recordings in any form
            that ``traces`` may have; without it ``value_column`` is its column in the long table ``traces``.
            A list of such dictionaries with a ``name`` each is taken too.
        name: of the dataset.
        skip_bad: leave out impacts with something wrong, and say so in ``left_out``.
        **stated: keys of ``dataset.toml``, its tables as dictionaries.

    Raises:
        InputError: everything that is wrong, each with its table, row (counted from 0), column and value,
            what was expected and how to mend it.
    """

    def checked() -> Dataset:
        """By the names of files and keys, whose checks they are."""
        content, by_name = content_of({"name": name, **stated}), _by_name(channels)
        if by_name:
            value_column = stated.get("value_column", SignalSettings.model_fields["value_column"].default)
            content["channel"] = _stated_channels(by_name, value_column)
        settings = parse_settings(content)
        signal, needs_velocity = settings.signal, settings.needs_velocity
        required = required_columns(needs_velocity=needs_velocity)
        names, body = _texts(impacts)
        cells, rows = Records(names, body, range(len(body))).cells(required)
        table = impact_table(cells, rows, needs_velocity=needs_velocity)
        with along_with(table.problems):
            recorded = _columns(traces, table, signal)
            further = [_further(one, by_name, traces, table, settings) for one in settings.channel]
        recordings = [long_recordings(*recorded, table, settings, None), *further]
        data = checked_dataset(table, recordings, skip_bad=skip_bad)
        return replace(data, input_hash=_hash(settings, cells, recordings))

    return in_words(checked, partial(reworded, files=_CALLED, names=_NAMES), _CALLED[IMPACTS])


def _by_name(channels: Any) -> Any:
    """Tables with a ``name`` each, as ``dataset.toml`` has them, as a dictionary; anything else as it is."""
    listed = channels if isinstance(channels, list | tuple) else ()
    if not listed or not all(isinstance(said, Mapping) and "name" in said for said in listed):
        return channels
    return {said["name"]: {key: said[key] for key in said if key != "name"} for said in listed}


def _stated_channels(channels: Any, value_column: str) -> Any:
    """The tables ``[[channel]]``; what is no dictionary is left for the settings to refuse.

    Raises:
        InputError: one names a file, which arrays have not.
    """
    if not isinstance(channels, Mapping):
        return channels
    for said in channels.values():
        if isinstance(said, Mapping) and "file" in said:
            allowed = ", ".join(["traces", *(key for key in ChannelSettings.model_fields if key != "file")])
            where = SETTINGS, None, "channel.0.file", said["file"]
            raise InputError.stated("unknown-key", *where, allowed=allowed)
    return [
        {"name": str(name), **{key: value for key, value in plain_value(said).items() if key != "traces"}}
        | ({"value_column": said.get("value_column", value_column)} if "traces" in said else {})
        if isinstance(said, Mapping)
        else said
        for name, said in channels.items()
    ]


def _further(
    channel: ChannelSettings, channels: Any, traces: Any, table: ImpactTable, settings: Settings
) -> Recordings:
    """A further channel's recordings, its own or those in the long table of the first."""
    signal, first = settings.signal_of(channel)
    channel_traces, suffix = channels[channel.name].get("traces"), f" of the channel {channel.name}"
    if channel_traces is None and not isinstance(traces, pd.DataFrame):
        raise InputError.stated("array-shape.channel", _SINGLE, value="no traces", name=channel.name)
    if channel_traces is None:
        return long_recordings(*_columns(traces, table, signal, first), table, settings, channel)
    try:
        label, columns = _columns(channel_traces, table, signal)
    except InputError as error:
        raise InputError(replace(problem, file=problem.file + suffix) for problem in error.problems) from None
    return long_recordings(label + suffix, columns, table, settings, channel)


def _texts(impacts: Any) -> tuple[list[str], list[list[str]]]:
    """The table of impacts as the cells of a file: names and records."""
    try:
        table = pd.DataFrame(impacts).drop(columns="trace", errors="ignore")
    except (TypeError, ValueError) as error:
        raise InputError.stated("array-shape.impacts", IMPACTS, value=str(error)) from None
    columns = [[plain_text(value) for value in table.iloc[:, column]] for column in range(table.shape[1])]
    body = [list(record) for record in zip(*columns, strict=True)]
    return [str(name).strip() for name in table.columns], body


def _columns(
    traces: Any, table: ImpactTable, signal: SignalSettings, first: SignalSettings | None = None
) -> tuple[str, Contents]:
    """What messages call the recordings, and all samples under one another.

    Of a further channel in a table with the ``first`` one, also numeric times of `clocks_beside`.
    """
    columns, impacts = (signal.time_column, signal.value_column), table.table["impact"].tolist()
    if isinstance(traces, pd.DataFrame):
        refuse(column_problems(_LONG, [str(name) for name in traces], ["impact", *columns]))
        codes, names = pd.factorize(traces["impact"], use_na_sentinel=False)
        labels = Labels(codes, list(map(plain_text, names)))
        able = traces.select_dtypes("number").columns.tolist()
        all_names = tuple(map(str, traces))
        further = [name for name in clocks_beside(signal, first, all_names) if able.count(name) == 1]
        numbers = {name: _numbers(traces[name], _LONG, name, None) for name in {*columns, *further}}
        if not len(codes):
            raise InputError.stated("no-rows.samples", _LONG, value="no rows")
        return _LONG, Contents(numbers, 0, labels={"impact": labels}, columns=all_names)
    if isinstance(traces, Mapping):
        named = [(plain_text(name), trace) for name, trace in traces.items()]
    elif isinstance(traces, Sequence) and not isinstance(traces, str) and len(traces) == len(impacts):
        named = list(zip(impacts, traces, strict=True))
    else:
        kind = f"{len(traces)} recordings" if isinstance(traces, Sequence) else type(traces).__name__
        raise InputError.stated("array-shape.recordings", _SINGLE, value=kind, count=len(impacts))
    pairs = all_of(lambda item: _pair(item[1], item[0], columns), named)
    count = [len(times.values) for times, _ in pairs]
    labels = Labels(np.repeat(np.arange(len(named)), count), [name for name, _ in named])
    numbers = {name: Channel.joined([pair[at] for pair in pairs]) for at, name in enumerate(columns)}
    return _SINGLE, Contents(numbers, labels={"impact": labels})


def _pair(trace: Any, impact: str, columns: tuple[str, str]) -> tuple[Channel, Channel]:
    """The times and values from the first sample that is not hidden to the last such one."""
    if isinstance(trace, Trace):
        trace = trace.time_s, trace.value
    elif isinstance(trace, pd.DataFrame):
        problems = column_problems(_SINGLE, [str(name) for name in trace], columns)
        refuse(replace(problem, impact=impact) for problem in problems)
        trace = trace[columns[0]], trace[columns[1]]
    elif isinstance(trace, np.ndarray) and trace.ndim == 2 and min(trace.shape) == 2 < max(trace.shape):
        # As `numpy.loadtxt` has it, with or without ``unpack``: which axis is the samples' is no question.
        trace = tuple(trace if trace.shape[0] == 2 else trace.T)
    if not isinstance(trace, tuple | list) or len(trace) != len(columns):
        kind = type(trace).__name__ + (f" of shape {trace.shape}" if isinstance(trace, np.ndarray) else "")
        names = {"times": columns[0], "values": columns[1]}
        raise InputError.stated("array-shape.pair", _SINGLE, value=kind, impact=impact, **names)
    times, readings = (
        _numbers(part, _SINGLE, name, impact) for part, name in zip(trace, columns, strict=True)
    )
    if len(times.values) != len(readings.values):
        counts = f"{len(times.values)} times and {len(readings.values)} values"
        raise InputError.stated("array-shape.lengths", _SINGLE, value=counts, impact=impact)
    masks = [np.ma.getmaskarray(part) for part in trace if isinstance(part, np.ma.MaskedArray)]
    if not np.any(masks):
        return times, readings
    hidden = np.any(masks, axis=0)
    shown = np.flatnonzero(~hidden)
    first, stop = (shown[0], shown[-1] + 1) if len(shown) else (0, 0)
    return _stretch(times, hidden, first, stop), _stretch(readings, hidden, first, stop)


def _stretch(numbers: Channel, hidden: np.ndarray, first: int, stop: int) -> Channel:
    text = {index - first: words for index, words in numbers.text.items() if first <= index < stop}
    values = np.where(hidden, np.nan, numbers.values)[first:stop]
    return Channel(values, rows=np.arange(first, stop), text=text)


def _numbers(values: Any, label: str, column: str, impact: str | None) -> Channel:
    if np.ndim(values) == 1:
        series = pd.Series(values).reset_index(drop=True)
        if pd.api.types.is_numeric_dtype(series) and not pd.api.types.is_complex_dtype(series):
            return Channel(series.to_numpy(np.float64, na_value=np.nan))
        if series.dtype == object or pd.api.types.is_string_dtype(series):
            array = pd.to_numeric(series, errors="coerce").to_numpy(np.float64, na_value=np.nan)
            bad = np.flatnonzero(np.isnan(array) & series.notna().to_numpy())
            return Channel(array, text={int(index): str(series.iloc[index]) for index in bad})
    shape = f"an array of shape {np.shape(values)} of {getattr(values, 'dtype', type(values).__name__)}"
    raise InputError.stated("array-shape.numbers", label, column=column, value=shape, impact=impact)


def _hash(settings: Settings, cells: pd.DataFrame, recordings: Sequence[Recordings]) -> str:
    digest = hashlib.sha256(json.dumps(settings.model_dump(exclude_defaults=True), sort_keys=True).encode())
    digest.update(cells.to_csv(index=False).encode())
    for one in recordings:
        for array in (one.position, one.start, one.time_s, one.value):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
