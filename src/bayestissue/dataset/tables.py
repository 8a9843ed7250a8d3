"""Columns of numbers out of CSV and Parquet files, with the place of every cell that is no number."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from jaxtyping import Float64, Int

from bayestissue.dataset.files import read_bytes, require_small
from bayestissue.dataset.headers import column_problems, header
from bayestissue.errors import InputError, Problem

TABLE_SUFFIXES = (".csv", ".csv.gz", ".parquet")
_NUMBER = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*$"


@dataclass(frozen=True)
class Numbers:
    """A column of numbers; ``text`` keeps what stood in the cells that held something else.

    Attributes:
        array: not a number (nan) where the cell was empty or held no number.
        text: from the index of such a cell to what stood there.
    """

    array: Float64[np.ndarray, " row"]
    text: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Labels:
    """A column of names, each stored once.

    Attributes:
        codes: for every row the index into ``names``.
        names: the distinct names, in order of appearance.
    """

    codes: Int[np.ndarray, " row"]
    names: tuple[str, ...]


def read_table(
    path: Path, label: str, *, numbers: Sequence[str], labels: Sequence[str] = (), remedy: str
) -> tuple[dict[str, Numbers], dict[str, Labels]]:
    """Columns of a CSV (also packed) or Parquet file.

    Args:
        path: the file.
        label: what to call it in a message.
        numbers: columns that hold numbers.
        labels: columns that hold names.
        remedy: what to do if the file is not there.

    Raises:
        InputError: the file can't be read, lacks a column, or has rows of the wrong length.
    """
    data = read_bytes(path, label, remedy)
    if path.suffix == ".parquet":
        table = _parquet(data, label, numbers, labels)
        if unfit := [name for name in numbers if not _numeric(table[name].type)]:
            raise InputError(
                Problem(
                    label,
                    "numbers",
                    "Store the column as numbers.",
                    column=name,
                    value=str(table[name].type),
                    code="column-type",
                )
                for name in unfit
            )
        columns = {name: Numbers(_floats(table[name])) for name in numbers}
    else:
        table, columns = _csv(data, label, numbers, labels)
    if not table.num_rows:
        raise InputError(
            Problem(label, "rows below the header", "Export the file anew.", value="no rows", code="no-rows")
        )
    return columns, {name: _labels(table[name]) for name in labels}


def read_numbers(path: Path, label: str, *, remedy: str) -> dict[str, Numbers]:
    """Every column in which at least half of the cells that are filled hold a number.

    Args:
        path: a CSV (also packed) or Parquet file.
        label: what to call it in a message.
        remedy: what to do if the file is not there.

    Raises:
        InputError: the file can't be read, names a column twice, or has rows of the wrong length.
    """
    data = read_bytes(path, label, remedy)
    if path.suffix == ".parquet":
        names = [field.name for field in _schema(data, label) if _numeric(field.type)]
    else:
        names = [name for name in header(data, label) if name]
    columns, _ = read_table(path, label, numbers=names, remedy=remedy)
    return {
        name: column
        for name, column in columns.items()
        if 2 * np.count_nonzero(np.isfinite(column.array)) >= column.array.size - _empty(column) > 0
    }


def _empty(column: Numbers) -> int:
    return sum(not text.strip() for text in column.text.values())


def _csv(
    data: bytes, label: str, numbers: Sequence[str], labels: Sequence[str]
) -> tuple[pa.Table, dict[str, Numbers]]:
    names = header(data, label)
    if problems := column_problems(label, names, [*labels, *numbers]):
        raise InputError(problems)
    require_small(8 * data.count(b"\n") * len([*labels, *numbers]), label)
    name_type = pa.dictionary(pa.int32(), pa.string())
    types: dict[str, pa.DataType] = dict.fromkeys(labels, name_type) | dict.fromkeys(numbers, pa.float64())
    try:
        table = _parse(data, label, names, types)
        return table, {name: Numbers(_floats(table[name])) for name in numbers}
    except pa.ArrowInvalid:
        # Some cell is no number: read the cells as text, to say which.
        table = _as_text(data, label, names, types | dict.fromkeys(numbers, pa.string()))
        return table, {name: _sifted(table[name].combine_chunks()) for name in numbers}


def _as_text(data: bytes, label: str, names: list[str], types: dict[str, pa.DataType]) -> pa.Table:
    try:
        return _parse(data, label, names, types)
    except pa.ArrowInvalid as error:
        remedy = "Export the file anew."
        raise InputError(
            Problem(label, "a header and rows of cells", remedy, value=_words(error), code="cells-in-a-row")
        ) from error


def _parse(data: bytes, label: str, names: list[str], types: dict[str, pa.DataType]) -> pa.Table:
    ragged: list[Problem] = []

    def note(row: pa_csv.InvalidRow) -> str:
        if len(ragged) < 20:
            ragged.append(
                Problem(
                    label,
                    f"{row.expected_columns} cells as in the header",
                    "Put one cell under every column name; decimals need a point, not a comma.",
                    row=row.number,
                    value=f"{row.actual_columns} cells: {row.text}",
                    code="cells-in-a-row",
                )
            )
        return "skip"

    table = pa_csv.read_csv(
        io.BytesIO(data),
        # Threads would lose the row numbers of what is wrong.
        read_options=pa_csv.ReadOptions(column_names=names, skip_rows=1, use_threads=False),
        parse_options=pa_csv.ParseOptions(ignore_empty_lines=False, invalid_row_handler=note),
        convert_options=pa_csv.ConvertOptions(
            column_types=types, include_columns=list(types), null_values=[""]
        ),
    )
    if ragged:
        raise InputError(ragged)
    return _without_trailing_blanks(table)


def _without_trailing_blanks(table: pa.Table) -> pa.Table:
    rows = table.num_rows
    while rows and all(column[rows - 1].as_py() in (None, "") for column in table.columns):
        rows -= 1
    return table.slice(0, rows)


def _sifted(cells: pa.Array) -> Numbers:
    good = pc.match_substring_regex(cells, _NUMBER)
    values = _floats(
        pa.chunked_array([pc.utf8_trim_whitespace(pc.if_else(good, cells, None))]).cast(pa.float64())
    )
    bad = np.flatnonzero(~np.asarray(good.fill_null(False), dtype=bool))
    return Numbers(values, {int(index): cells[int(index)].as_py() or "" for index in bad})


def _parquet(data: bytes, label: str, numbers: Sequence[str], labels: Sequence[str]) -> pa.Table:
    wanted = [*labels, *numbers]
    schema = _schema(data, label)
    if problems := [*column_problems(label, schema.names, wanted), *_no_names(label, schema, labels)]:
        raise InputError(problems)
    try:
        # A name that stands in many rows is kept once: otherwise a small file could fill any memory.
        once = [name for name in labels if _is_text(schema.field(name).type)]
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True, read_dictionary=once)
        require_small(_read_size(file.metadata, wanted), label)
        table = file.read(columns=wanted)
        table.validate(full=True)
    except InputError:
        raise
    except Exception as error:
        raise _damaged(label, error) from error
    return table


def _schema(data: bytes, label: str) -> pa.Schema:
    try:
        return pq.read_schema(pa.BufferReader(data))
    except Exception as error:
        raise _damaged(label, error) from error


def _damaged(label: str, error: Exception) -> InputError:
    # A damaged file can fail anywhere in the decoder, with whatever that part raises.
    return InputError(
        Problem(
            label,
            "a whole Parquet file",
            "Copy or export the file anew.",
            value=_words(error),
            code="damaged-file",
        )
    )


def _is_text(kind: pa.DataType) -> bool:
    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def _no_names(label: str, schema: pa.Schema, labels: Sequence[str]) -> list[Problem]:
    """Columns of names that hold something else than text or whole numbers."""
    found = {name: schema.field(name).type for name in labels if schema.names.count(name) == 1}
    kinds = {n: kind.value_type if pa.types.is_dictionary(kind) else kind for n, kind in found.items()}
    return [
        Problem(
            label,
            "names, as text",
            "Store the column as text.",
            column=name,
            value=str(found[name]),
            code="column-type",
        )
        for name, kind in kinds.items()
        if not (_is_text(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind))
    ]


def _read_size(about: pq.FileMetaData, wanted: list[str]) -> int:
    """Bytes that the columns take: of each the pages unpacked, and at least 8 for every row."""
    pages = 0
    for group in (about.row_group(number) for number in range(about.num_row_groups)):
        columns = (group.column(number) for number in range(group.num_columns))
        pages += sum(c.total_uncompressed_size for c in columns if c.path_in_schema in wanted)
    return max(pages, 8 * about.num_rows * len(wanted))


def _words(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _numeric(kind: pa.DataType) -> bool:
    return pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind)


def _floats(column: pa.ChunkedArray) -> np.ndarray:
    return column.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy().astype(np.float64, copy=False)


def _labels(column: pa.ChunkedArray) -> Labels:
    if not pa.types.is_dictionary(column.type):
        column = column.cast(pa.string()).dictionary_encode()
    single = column.unify_dictionaries().combine_chunks()
    single = single.chunk(0) if isinstance(single, pa.ChunkedArray) else single
    names = [(name or "").strip() for name in single.dictionary.to_pylist()]
    codes = single.indices.fill_null(len(names)).to_numpy(zero_copy_only=False)
    distinct = tuple(dict.fromkeys([*names, ""]))
    place = {name: index for index, name in enumerate(distinct)}
    return Labels(np.array([place[name] for name in [*names, ""]])[codes], distinct)
