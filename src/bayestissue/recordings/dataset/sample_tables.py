"""Columns of numbers out of text, Excel and Parquet files, with the place of every cell that is no number."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from bayestissue.base.errors import InputError, Problem, refuse
from bayestissue.base.results.tables import as_written
from bayestissue.recordings.dataset import clock_times
from bayestissue.recordings.dataset.cells import column_problems, ragged_problem
from bayestissue.recordings.dataset.dialect import CLOCK, Dialect, TextTable, text_table
from bayestissue.recordings.dataset.formats.channel import Channel, Contents, Labels, even_clock, unit_in_name
from bayestissue.recordings.dataset.source_files import Source, decoded, error_line, require_small

TABLE_SUFFIXES = (".csv", ".csv.gz", ".tsv", ".xlsx", ".parquet")
# What else may be a table, or a note to the reader.
TEXT_SUFFIXES = (".txt", ".dat", ".asc")
# The row of the first record below names in the first one, as a spreadsheet counts.
FIRST_ROW = 2
# How recorders write what is beyond their range.
BEYOND_LIMIT = {"∞": np.inf, "+∞": np.inf, "-∞": -np.inf}


def read_table(
    source: Source,
    *,
    numbers: Sequence[str] | None,
    labels: Sequence[str] = (),
    optional: Callable[[Sequence[str]], Sequence[str]] = lambda names: (),
) -> Contents:
    """Columns of a text (also packed), Excel or Parquet file.

    Args:
        source: the file.
        numbers: columns that hold numbers; if None, all in which at least half of the filled cells do, each
            with the unit that its name has, and as far as it is filled.
        labels: columns that hold names.
        optional: which further columns of numbers are read where they are there, by the names of all; of no
            names, those by which the line of names is found.

    Raises:
        InputError: the file can't be read, lacks a column or names it twice, or has rows of the wrong length.
    """
    data, label, wanted = source.read(), source.label, numbers or ()
    parse: Callable[[Sequence[str], Sequence[str]], Contents]
    if source.suffix == ".parquet":
        with decoded("parquet", label):
            schema = pq.read_schema(pa.BufferReader(data))
        present, able = schema.names, [field.name for field in schema if _numeric(field.type)]
        parse = partial(_parse_parquet, data, schema, label)
    else:
        text = text_table(data, source, wanted=[*labels, *optional(()), *wanted])
        present = text.names
        able = [name for name in present if name and not (text.clock and name.casefold() in CLOCK)]
        parse = partial(_parse_text, text, label, whole=numbers is not None)
    further = [name for name in optional(present) if name in present]
    names = able if numbers is None else list(dict.fromkeys([*further, *wanted]))
    table = replace(parse(names, labels), columns=tuple(present))
    if numbers is not None:
        return table
    columns = {}
    for name, column in table.channels.items():
        known = np.flatnonzero(np.isfinite(column.values))
        if not known.size or known.size < sum(bool(text.strip()) for text in column.text.values()):
            continue
        # Where other columns of the table are longer, empty cells stand behind the end of this one.
        count, unit = int(known[-1]) + 1, column.unit or unit_in_name(name)
        clock = None if column.clock is None else column.clock[:count]
        columns[name] = replace(column, values=column.values[:count], clock=clock, unit=unit)
    return replace(table, channels=columns)


def _parse_text(
    text: TextTable, label: str, numbers: Sequence[str], labels: Sequence[str], *, whole: bool = True
) -> Contents:
    """The columns of a text; where it need not be ``whole``, a row may end before the last of them."""
    wanted = [*labels, *numbers]
    refuse(column_problems(label, text.names, wanted, text.dialect.header_row, stated=True))
    if re.search(rb"\S", text.body) is None:
        raise InputError.stated("no-rows.table", label, value="no rows")
    lines = int(np.count_nonzero(np.frombuffer(text.body, np.uint8) == ord("\n")))
    require_small(8 * lines * len(wanted), label)
    types: dict[str, pa.DataType] = dict.fromkeys(labels, pa.dictionary(pa.int32(), pa.string()))
    least = max(map(text.names.index, wanted), default=0) + 1 if whole else 1
    try:
        table = _parse(text, label, types | dict.fromkeys(numbers, pa.float64()), least)
        columns = {name: Channel(_floats(table[name])) for name in numbers}
    except pa.ArrowInvalid:
        # Some cell is no number: read the cells as text, to say which.
        try:
            table = _parse(text, label, types | dict.fromkeys(numbers, pa.string()), least)
        except pa.ArrowInvalid as error:
            raise InputError.stated("cells-in-a-row.table", label, value=error_line(error)) from error
        columns = {name: _sifted(table[name].combine_chunks(), text.dialect) for name in numbers}
    if not table.num_rows:
        raise InputError.stated("no-rows.table", label, value="no rows")
    units = dict(zip(text.names, text.units, strict=True))
    start, step = text.clock or (0.0, 0.0)
    clock = even_clock(step, start, table.num_rows)
    return Contents(
        {name: replace(c, clock=clock, unit=units[name] or c.unit) for name, c in columns.items()},
        text.dialect.first_row,
        labels={name: _labels(table[name], as_written) for name in labels},
        dialect=text.dialect,
    )


def _parse(text: TextTable, label: str, types: dict[str, pa.DataType], least: int) -> pa.Table:
    """The columns of a text whose rows have the ``least`` cells or more, without empty rows at the end.

    Cells that a row lacks are empty.
    """
    ragged: list[tuple[int, int, str]] = []
    dialect = text.dialect

    def note(row: pa_csv.InvalidRow) -> str:
        ragged.append((row.number - 1 + dialect.first_row, row.actual_columns, row.text))
        return "skip"

    table = pa_csv.read_csv(
        pa.BufferReader(pa.py_buffer(text.body)),
        # Threads would lose the row numbers of what is wrong.
        read_options=pa_csv.ReadOptions(column_names=text.names, use_threads=False),
        parse_options=pa_csv.ParseOptions(
            delimiter=text.delimiter, ignore_empty_lines=False, invalid_row_handler=note
        ),
        convert_options=pa_csv.ConvertOptions(
            column_types=types, include_columns=list(types), null_values=[""], decimal_point=dialect.decimal
        ),
    )
    if wrong := [row for row in ragged if not least <= row[1] < len(text.names)]:
        header = dialect.header_row
        raise InputError(ragged_problem(label, len(text.names), wrong, text.delimiter, header))
    if ragged:
        return _parse(_filled_up(text), label, types, len(text.names))
    rows = table.num_rows
    while rows and all(column[rows - 1].as_py() in (None, "") for column in table.columns):
        rows -= 1
    return table.slice(0, rows)


def _filled_up(text: TextTable) -> TextTable:
    """The text with an empty cell in place of each that is missing at the end of a row."""
    reader = csv.reader(io.StringIO(text.body.tobytes().decode(), newline=""), delimiter=text.delimiter)
    filled = io.StringIO(newline="")
    csv.writer(filled, delimiter=text.delimiter, lineterminator="\n").writerows(
        cells + [""] * (len(text.names) - len(cells)) for cells in reader
    )
    return replace(text, body=memoryview(filled.getvalue().encode()))


def _sifted(cells: pa.Array, dialect: Dialect) -> Channel:
    if (times := clock_times.seconds(cells)) is not None:
        bad = np.flatnonzero(np.isnan(times[0]))
        text = {int(i): cells[int(i)].as_py() or "" for i in bad}
        return Channel(times[0], unit="s", text=text, since=times[1])
    good = pc.match_substring_regex(cells, dialect.number)
    plain = pc.utf8_trim_whitespace(pc.if_else(good, cells, None))
    for mark, instead in (*((mark, "") for mark in dialect.thousands), (dialect.decimal, ".")):
        plain = pc.replace_substring(plain, mark, instead)
    values = _floats(pa.chunked_array([plain]).cast(pa.float64())).copy()
    bad = np.flatnonzero(~np.asarray(good.fill_null(False), dtype=bool))
    text = {int(index): cells[int(index)].as_py() or "" for index in bad}
    beyond = {index: BEYOND_LIMIT.get(words.strip(), np.nan) for index, words in text.items()}
    values[list(beyond)] = list(beyond.values())
    return Channel(values, text=text)


def _parse_parquet(
    data: bytes, schema: pa.Schema, label: str, numbers: Sequence[str], labels: Sequence[str]
) -> Contents:
    wanted = [*labels, *numbers]
    missing = column_problems(label, schema.names, wanted)
    types = dict(zip(schema.names, schema.types, strict=True))
    unfit = [
        Problem.stated(f"column-type.{key}", label, column=name, value=str(types[name]))
        for key, names, fits in (("numbers", numbers, _numeric), ("names", labels, _of_names))
        for name in filter(types.get, names)
        if not fits(types[name])
    ]
    refuse([*missing, *unfit])
    # A name that stands in many rows is kept once: otherwise a small file could fill any memory.
    once = [name for name in labels if _is_text(schema.field(name).type)]
    with decoded("parquet", label):
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True, read_dictionary=once)
        require_small(8.0 * file.metadata.num_rows * len(wanted), label)
        table = file.read(columns=wanted)
        table.validate(full=True)
        _require_whole(file.metadata, wanted)
    if not table.num_rows:
        raise InputError.stated("no-rows.table", label, value="no rows")
    channels = {name: _parquet_numbers(table[name]) for name in numbers}
    return Contents(channels, FIRST_ROW, labels={name: _labels(table[name]) for name in labels})


def _is_text(kind: pa.DataType) -> bool:
    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def _of_names(kind: pa.DataType) -> bool:
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return _is_text(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind)


def _require_whole(metadata: pq.FileMetaData, wanted: list[str]) -> None:
    """Refuse counts of rows that contradict each other; asked before a row is read, they end the process."""
    leaves = [at for at in range(len(metadata.schema)) if metadata.schema.column(at).path in wanted]
    groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
    values = [group.column(at).num_values - group.num_rows for group in groups for at in leaves]
    if any(values) or sum(group.num_rows for group in groups) != metadata.num_rows:
        raise ValueError("row groups whose columns have other numbers of rows")


def _numeric(kind: pa.DataType) -> bool:
    numbers = pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind)
    return numbers or _of_time(kind)


def _of_time(kind: pa.DataType) -> bool:
    return pa.types.is_timestamp(kind) or pa.types.is_time(kind) or pa.types.is_duration(kind)


def _parquet_numbers(column: pa.ChunkedArray) -> Channel:
    if not _of_time(column.type):
        return Channel(_floats(column))
    counts = column.cast(pa.int64() if column.type.bit_width == 64 else pa.int32()).cast(pa.int64())
    # As whole numbers, of which a float would not hold all digits.
    first = counts.drop_null()[0].as_py() if counts.null_count < len(counts) else 0
    per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[column.type.unit]
    start = first % (clock_times.DAY_S * per_second) / per_second
    return Channel(_floats(pc.subtract(counts, first)) / per_second, unit="s", since=start)


def _floats(column: pa.ChunkedArray) -> np.ndarray:
    return column.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy().astype(np.float64, copy=False)


def _labels(column: pa.ChunkedArray, spelling: Callable[[str], str] = str) -> Labels:
    if not pa.types.is_dictionary(column.type):
        column = column.cast(pa.string()).dictionary_encode()
    single = column.unify_dictionaries().combine_chunks()
    single = single.chunk(0) if isinstance(single, pa.ChunkedArray) else single
    names = [spelling((name or "").strip()) for name in single.dictionary.to_pylist()]
    codes = single.indices.fill_null(len(names)).to_numpy(zero_copy_only=False)
    return Labels(codes, [*names, ""])
