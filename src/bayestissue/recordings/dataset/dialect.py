"""How a text table is written: encoding, marks between cells and within numbers, lines above them.

A spreadsheet writes CSV files as its country does: ``0,5;1.234,5`` in Germany, ``0.5,"1,234.5"`` in Britain.
What is found here is what every reader of text tables goes by.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, zip_longest
from typing import Annotated, Literal

from pydantic import Field

from bayestissue.base.errors import InputError, Problem
from bayestissue.base.settings import TomlTable
from bayestissue.recordings.dataset.source_files import (
    FILES,
    Source,
    as_utf8,
    is_workbook,
    require_lines,
    sheet_text,
)
from bayestissue.recordings.dataset.units import dimension_of

Encoding = Literal["utf-8", "utf-16", "cp1252"]
Delimiter = Literal["comma", "semicolon", "tab", "pipe", "space"]
Decimal = Literal["point", "comma"]
Thousands = Literal["none", "point", "comma", "space", "apostrophe"]
Row = Annotated[int, Field(ge=0)]

DELIMITERS: dict[Delimiter, str] = {"semicolon": ";", "tab": "\t", "pipe": "|", "comma": ",", "space": " "}
DECIMALS: dict[Decimal, str] = {"point": ".", "comma": ","}
# Of spaces and apostrophes, those that typesetters use too.
THOUSANDS: dict[Thousands, str] = {
    "none": "", "point": ".", "comma": ",", "space": " \u00a0\u202f", "apostrophe": "'\u2019",
}  # fmt: skip
_ENCODINGS = {"utf-8": "UTF-8", "utf-8-sig": "UTF-8 with a mark", "utf-16": "UTF-16", "cp1252": "cp1252"}
_EXPONENT = r"([eE][+-]?\d+)?"
# A number in any country's spelling; a date such as 24.11.2026 is none.
_ANY_NUMBER = re.compile(
    rf"[+-]?(\d+[.,]?\d*|[.,]\d+|\d{{1,3}}([.,'\u2019 \u00a0\u202f]\d{{3}})+([.,]\d*)?){_EXPONENT}", re.ASCII
)
# Its mark may stand before decimals or between thousands, before which stands no 0.
OPEN = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}", re.ASCII)
_OTHER = {".": ",", ",": "."}
# Columns of names, where "1,5" is no number.
NAMES = ("impact", "subject", "trial", "trace", "file")
# A number with a unit behind it.
_VALUE = re.compile(r"[+-]?\d")
# What a row of units may be called in its first cell.
_CALLED_UNITS = re.compile(r"(\w+ )?(units?|einheit(en)?|eu|sequence):?", re.IGNORECASE)
# Besides those of times, accelerations and lengths.
_FURTHER_UNITS = frozenset([
    "V", "mV", "Volt", "Volts", "N", "kN", "lbf", "Nm", "N-m", "N.m", "N·m", "N*m", "kg", "Hz", "%", "°C",
    "Pa", "kPa", "MPa", "deg", "°", "deg/s", "°/s", "rad/s",
])  # fmt: skip
_RUN = re.compile(r"\s(Run|Trial) ?#?\d+$|^(Run|Trial|Data Set) ?#?\d+: *", re.IGNORECASE)
# What an oscilloscope calls the first time and the step, which stand in the first row or that of units.
CLOCK = ("start", "increment")


class Stated(TomlTable, strict=True):
    """How recordings that are text tables are written, in ``[signal]`` where that is not to be found.

    Where nobody said so it is None, and found.

    Attributes:
        encoding: of text files: utf-8, utf-16 or cp1252. Found if left out, as the next five.
        delimiter: between cells: comma, semicolon, tab, pipe or space.
        decimal: the decimal mark: point or comma.
        thousands: between thousands: none, point, comma, space or apostrophe.
        header_row: the row with the names of columns; 0 where there are none, which makes them column 1,
            column 2 ...
        units_row: the row with their units; 0 where there is none.
    """

    encoding: Encoding | None = None
    delimiter: Delimiter | None = None
    decimal: Decimal | None = None
    thousands: Thousands | None = None
    header_row: Row | None = None
    units_row: Row | None = None


@dataclass(frozen=True)
class Dialect:
    """How a text table is written.

    Attributes:
        encoding: as `as_utf8` names it.
        delimiter: between cells; ``" "`` stands for any run of spaces and tabs.
        decimal: the decimal mark.
        thousands: the marks that may stand between groups of three digits; empty if none do.
        header_row: the row with the names of columns; 0 if there is none.
        units_row: the row with their units; 0 if there is none.
        first_row: the row of the first record.
        sheet: of a workbook, whose cells need no marks; empty of a text.
    """

    encoding: str = "utf-8"
    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    header_row: int = 1
    units_row: int = 0
    first_row: int = 2
    sheet: str = ""

    def __str__(self) -> str:
        between, decimal = _word(DELIMITERS, self.delimiter), _word(DECIMALS, self.decimal)
        thousands = f"a {_word(THOUSANDS, self.thousands)} between thousands" if self.thousands else ""
        marks = [_ENCODINGS[self.encoding], f"a {between} between cells", f"a decimal {decimal}", thousands]
        parts = [f"the sheet {self.sheet}"] if self.sheet else list(filter(None, marks))
        parts += [f"names in row {self.header_row}" if self.header_row else "no names of columns"]
        parts += [f"units in row {self.units_row}"] if self.units_row else []
        return ", ".join(parts)

    @cached_property
    def number(self) -> str:
        """An expression, for Python and for RE2, that a whole cell fits if it holds a number."""
        mark = re.escape(self.decimal)
        grouped = rf"|\d{{1,3}}([{self.thousands}]\d{{3}})+({mark}\d*)?" if self.thousands else ""
        return rf"^\s*[+-]?(\d+({mark}\d*)?|{mark}\d+{grouped}){_EXPONENT}\s*$"

    def plain(self, cell: str) -> str:
        """A number with a decimal point and nothing between thousands; other text as it is."""
        if (self.decimal == "." and not self.thousands) or not re.match(self.number, cell, re.ASCII):
            return cell
        return cell.translate(dict.fromkeys(map(ord, self.thousands))).replace(self.decimal, ".")


@dataclass(frozen=True, eq=False)
class TextTable:
    """A text table, read as far as its names.

    Attributes:
        dialect: how it is written.
        names: of the columns, without the spaces around them.
        units: of the columns, as a line below the names states them; empty texts where none does.
        body: the records, UTF-8.
        delimiter: between the cells of ``body``.
        clock: the first time and the step in s, where columns of the names Start and Increment state them.
    """

    dialect: Dialect
    names: list[str]
    units: list[str]
    body: memoryview
    delimiter: str
    clock: tuple[float, float] | None = None


@dataclass(frozen=True)
class _Record:
    """A line of cells that is not empty: its row, and the row below it."""

    row: int
    below: int
    cells: list[str]

    @cached_property
    def bare(self) -> list[str]:
        """The cells without the spaces around them."""
        return [cell.strip() for cell in self.cells]

    @property
    def has_number(self) -> bool:
        """Whether a cell holds a number."""
        return any(map(_is_number, self.cells))

    @property
    def is_setting(self) -> bool:
        """Whether it is a setting of each channel, such as ``Range=`` before ``10.000 V`` and ``5.000 V``."""
        first, *others = self.bare
        return first.endswith(("=", ":")) and all(_VALUE.match(cell) for cell in others if cell)

    @cached_property
    def has_units(self) -> bool:
        """Whether each cell is a unit or says that there is none, and one of them is a unit of a recording.

        The first cell may say that these are units; a first time and a step may stand among them.
        """
        called = _CALLED_UNITS.fullmatch(self.bare[0])
        known = {_is_unit(cell) for cell in self.bare[1 if called else 0 :]}
        return True in known and False not in known


@dataclass(frozen=True)
class _Lines:
    """The first lines of a table, cut at one delimiter."""

    delimiter: str
    records: list[_Record]

    @classmethod
    def cut(cls, text: str, delimiter: str) -> _Lines:
        return cls(delimiter, list(islice(_records(text, delimiter), FILES.lines)))

    @property
    def lower(self) -> list[_Record]:
        """The lower half, in which there is no header."""
        return self.records[len(self.records) // 2 :]

    @cached_property
    def width(self) -> int:
        """How many cells most lines have; the lower half decides where several numbers are as frequent."""
        count = Counter(len(record.cells) for record in [*self.records, *self.lower])
        return count.most_common(1)[0][0] if count else 0

    @property
    def share(self) -> float:
        """The share of lines with as many cells as most lines have; 0 where that is one cell."""
        usual = sum(len(record.cells) == self.width for record in self.records)
        return usual / len(self.records) if self.width > 1 else 0.0

    @cached_property
    def number_columns(self) -> list[int]:
        """The columns that hold numbers in most cells of the lower half that are filled."""
        lines = [record.bare for record in self.lower if len(record.cells) == self.width]
        filled = [[cells[at] for cells in lines if cells[at]] for at in range(self.width)]
        return [at for at, column in enumerate(filled) if 2 * sum(map(_is_number, column)) > len(column)]

    def is_data(self, record: _Record) -> bool:
        """Whether most of the columns of numbers hold one in a record."""
        return 2 * sum(map(_is_number, self._in_number_columns(record))) > len(self.number_columns)

    @cached_property
    def begin(self) -> int:
        """Where the data begin: at a time and numbers, without words in any of the columns of numbers.

        Lines above it may hold numbers too, such as the sensitivity of each channel.
        """
        data = [at for at, record in enumerate(self.records) if self.is_data(record)]
        for at in data:
            first, *others = self._in_number_columns(self.records[at])
            if _is_number(first) and all(_is_number(cell) for cell in others if cell):
                return at
        return data[0] if data else 0

    def _in_number_columns(self, record: _Record) -> list[str]:
        return [record.bare[at] for at in self.number_columns if at < len(record.cells)]

    def names(self, wanted: Sequence[str], *, named: bool) -> _Record | None:
        """The record with the names of the columns; None where there is none."""

        def hits(record: _Record | None) -> int:
            titles = self.titles(record) if record else []
            return len({*wanted} & {*titles, *_by_place(titles)})

        return max([self._names_above_numbers(named=named), *self.records], key=hits)

    def titles(self, record: _Record) -> list[str]:
        """The names in a record; of the coordinates of markers, whose names stand above, ``marker.X1``."""
        number = self.records.index(record)
        names, above = record.bare, self.records[number - 1].bare if number else []
        if names[0] or not above or not above[0]:
            return names
        titles, marker = [], ""
        for name, title in zip_longest(names, above, fillvalue=""):
            marker = title or marker
            titles.append(f"{marker}.{name}" if name else title)
        return titles

    def _names_above_numbers(self, *, named: bool) -> _Record | None:
        if named or not self.number_columns:
            return self.records[0] if self.records else None
        # Above commas a line of one cell may be the name of a single column of numbers with decimal commas,
        # which then don't fit below it.
        above = [
            record
            for record in self.records[: self.begin]
            if not self._is_remark(record) or (self.delimiter == "," and len(record.cells) == 1)
        ]
        above = [record for record in above if not record.has_number] or above
        above = [record for record in above if not record.is_setting] or above
        while len(above) > 1 and above[-1].has_units:
            above.pop()
        if above:
            return above[-1]
        # The numbers of the columns, as pandas writes them over an array that has no names.
        counted = [str(number) for number in range(self.width)]
        return self.records[0] if len(self.records) > 1 and self.records[0].cells == counted else None

    def _is_remark(self, record: _Record) -> bool:
        """Whether a line says something of the table: it has one cell, or too few for the columns."""
        filled = sum(map(bool, record.bare))
        return self.width > 1 and (filled < 2 or 2 * filled < len(self.number_columns))

    def units(self, names: _Record | None) -> _Record | None:
        """The record of units below that of the names, or one above it that is called so; None without."""
        if names is None:
            return None
        below = next((record for record in self.records if record.row >= names.below), None)
        if below and not self.is_data(below) and below.has_units:
            return below
        above = (record for record in self.records if record.row < names.row)
        called = (record for record in above if _CALLED_UNITS.fullmatch(record.bare[0]))
        return next((record for record in called if record.has_units), None)

    def stated(self, key: str, stated: Stated, label: str, otherwise: _Record | None) -> _Record | None:
        """The record that somebody named by its row, None for the row 0; ``otherwise`` where nobody did."""
        if (row := getattr(stated, key)) is None:
            return otherwise
        record = next((candidate for candidate in self.records if candidate.row == row), None)
        if row and record is None:
            count = len(self.records)
            raise InputError.stated("cells-in-a-row.stated-row", label, None, key, row, count=count)
        return record

    def first_row(self, above: _Record | None, *, named: bool) -> int:
        """The row of the first record below the names, units and remarks."""
        if above is None:
            return self.records[self.begin].row if self.records else 1
        # An empty line of a single column is an empty cell, and in a table with names one may be a row.
        if self.width == 1 or named:
            return above.below
        data = self.records[self.begin].row
        for record in (record for record in self.records if record.row >= above.below):
            remark = self._is_remark(record) and not record.has_number
            if record.row >= data or not (remark or record.has_units or record.is_setting):
                return record.row
        return above.below

    def clock(self, names: _Record | None) -> tuple[float, float] | None:
        """The first time and the step, of a table with columns for them, as oscilloscopes write."""
        titles = [cell.casefold() for cell in names.bare] if names else []
        if names is None or not {*CLOCK} <= {*titles}:
            return None
        first = [record.cells for record in self.records if record.row >= names.below][:2]
        for cells in first:
            stated = [cells[at] if at < len(cells) else "" for at in map(titles.index, CLOCK)]
            if all(map(_is_number, stated)):
                start, step = (float(cell.replace(",", ".")) for cell in stated)
                return start, step
        return None


def text_table(data: bytes, source: Source, *, wanted: Sequence[str] = (), named: bool = False) -> TextTable:
    """Find how a text table is written, and read the names of its columns.

    The delimiter is the one that cuts most lines into equally many cells, at least two; the decimal mark the
    one in most numbers that tell it. A mark between thousands is taken for one only where a number leaves no
    doubt, as ``1.234,5`` and ``1,234,567`` do and ``1.234`` does not. Where every mark of the table stands as
    there, which a point between cells that commas separate does not, it is stated or refused. The line of
    names is the one with most of the
    ``wanted`` ones; else the last one above the numbers that holds no number itself. A name that stands
    there twice gets the number of its column: ``Fx (column 2)``.

    Args:
        data: the file: a text, or an Excel workbook, of which one sheet is the table: the first with cells
            unless the ``source`` is one.
        source: of the data. What is stated of it is not looked for; of a ``named`` table it was stated of the
            recordings beside it, and decides only what the table's own marks leave open.
        wanted: names of columns that should be there.
        named: whether the table must name its columns; one that may not calls them ``column 1`` and so on.

    Raises:
        InputError: it is no text and no workbook, or its marks can be read in two ways.
    """
    label, sheet, marks = source.label, source.part, source.stated or Stated()
    stated = Stated() if named else marks
    if sheet and not is_workbook(data):
        raise InputError.stated("no-channel.part", label, value=f"#{sheet}")
    if is_workbook(data):
        sheet, data = sheet_text(data, label, sheet)
        stated = stated.model_copy(update={"encoding": "utf-8", "delimiter": "comma"})
    data, encoding = as_utf8(data, label, stated.encoding)
    require_lines(data, label)
    head = data if len(data) <= FILES.head else data[: data.rfind(b"\n", 0, FILES.head) + 1 or FILES.head]
    text = head.decode("utf-8", "ignore")
    lines = _Lines.cut(text, DELIMITERS[stated.delimiter]) if stated.delimiter else _cut(text)
    header = lines.stated("header_row", stated, label, lines.names(wanted, named=named))
    below = lines.stated("units_row", stated, label, lines.units(header))
    last = max(filter(None, (header, below)), key=lambda record: record.row, default=None)
    first_row = lines.first_row(last, named=named)
    body = memoryview(data)[sum(map(len, head.splitlines(keepends=True)[: first_row - 1])) :]
    cells = [record.cells for record in lines.records if record.row >= first_row]
    columns = [f"column {number}" for number in range(1, lines.width + 1)]
    names = _fitted(lines.titles(header) if header else columns, cells)
    names = names if named else _by_place(_without_run(names, wanted))
    decimal, unsure = _decimal(lines, body, first_row, [named and name in NAMES for name in names])
    if unsure and not (marks.decimal or marks.thousands):
        row, column, cell = unsure
        raise InputError(open_mark(label, row, names[column], cell))
    mark = "" if unsure is None else re.sub(r"[^.,]", "", unsure[2])
    decimal, thousands = _settled(decimal, mark, marks, named=named)
    thousands = _thousands(body, lines.delimiter, decimal) if thousands is None else thousands
    rows = (header.row if header else 0, below.row if below else 0, first_row)
    dialect = Dialect(encoding, lines.delimiter, decimal, thousands, *rows, sheet)
    first, *others = map(_bare, below.cells) if below else [""]
    units = ["" if _CALLED_UNITS.fullmatch(first) else first, *others, *[""] * len(names)][: len(names)]
    clock = None if named else lines.clock(header)
    if lines.delimiter != " ":
        return TextTable(dialect, names, units, body, lines.delimiter, clock)
    tabbed = b"".join(b"\t".join(line.split()) + b"\n" for line in body.tobytes().splitlines())
    return TextTable(dialect, names, units, memoryview(tabbed), "\t", clock)


def open_mark(file: str, row: int | None, column: str, cell: str) -> Problem:
    """That the mark of a number, as `OPEN` has them, may stand before decimals or between thousands."""
    words = {"whole": re.sub("[.,]", "", cell), "decimals": cell.replace(",", ".")}
    return Problem.stated("open-mark", file, row, column, cell, **words)


def _without_run(names: list[str], wanted: Sequence[str]) -> list[str]:
    """The names without ``Run #7`` where all have it: in another file they have another number."""
    runs = {match[0] if (match := _RUN.search(name)) else "" for name in names if name}
    if len(runs) != 1 or "" in runs or sum(map(bool, names)) < 2 or set(wanted) & set(names):
        return names
    return [_RUN.sub("", name).strip() for name in names]


def _by_place(names: Sequence[str]) -> list[str]:
    """The names, those that stand there twice with the number of their column."""
    count = Counter(names)
    return [f"{name} (column {at})" if name and count[name] > 1 else name for at, name in enumerate(names, 1)]


def _word[Word: str](words: dict[Word, str], mark: str) -> str:
    return next(word for word, sign in words.items() if sign == mark)


def _records(text: str, delimiter: str) -> Iterator[_Record]:
    lines = io.StringIO(text, newline="")
    if delimiter == " ":
        for row, line in enumerate(lines, 1):
            if cells := line.removeprefix("#").split():
                yield _Record(row, row + 1, cells)
        return
    reader = csv.reader(lines, delimiter=delimiter)
    row = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield _Record(row, reader.line_num + 1, cells)
            row = reader.line_num + 1
    except csv.Error:
        # Quotes that do not match: whoever reads the table says where.
        return


def _cut(text: str) -> _Lines:
    """The lines cut by the mark that makes most of them equally long; by a comma where none does."""
    *marked, by_comma, spaced = (_Lines.cut(text, mark) for mark in DELIMITERS.values())
    best = max(*marked, by_comma, key=lambda lines: lines.share)
    if best.share and best is not by_comma:
        return best
    # Between words stand spaces too: they separate cells where nothing but numbers stands between them.
    cells = [cell for record in spaced.lower for cell in record.cells]
    numbers = all(_is_number(cell) and cell[-1] != "," for cell in cells)
    return spaced if cells and numbers and spaced.share > 0.5 else by_comma


def _is_number(cell: str) -> bool:
    return _ANY_NUMBER.fullmatch(cell.strip()) is not None


def _is_unit(cell: str) -> bool | None:
    """Whether a cell is a unit; None of one that says that there is none."""
    unit = _bare(cell)
    # Names and numbers are no units, and looking them up would take long.
    may_be = unit[:1].isalpha() and len(unit) <= 10
    if unit in _FURTHER_UNITS or (may_be and dimension_of(unit) is not None):
        return True
    return None if unit in ("", "-") or unit != cell or _is_number(unit) else False


def _bare(unit: str) -> str:
    return unit.strip().strip("[]()").strip()


def _decimal(
    lines: _Lines, body: memoryview, first_row: int, of_names: Sequence[bool]
) -> tuple[str, tuple[int, int, str] | None]:
    """The mark before decimals in most numbers that tell it; a point where no number has decimals.

    Args:
        lines: the first ones, which decide if they can.
        body: the records, which decide else.
        first_row: the row of the first of them.
        of_names: of each column whether it holds names.

    Returns:
        The mark; and where no number of the table tells it and one may be read in two ways, the row, the
        column and the text of its cell.
    """
    counts: Counter[str] = Counter()
    unsure = None
    separated = lines.delimiter == ","
    first = sum(record.row >= first_row for record in lines.records)
    tells = re.search(rb'"' if separated else rb"\d[.,]\d", body)
    records = _records(body.tobytes().decode("utf-8", "ignore"), lines.delimiter)
    for number, record in enumerate(records):
        if number >= first and (counts or not tells):
            break
        for column, text in enumerate(record.cells):
            cell = text.strip()
            marks = re.findall("[.,]", cell) if _is_number(cell) else []
            if not marks or any(of_names[column : column + 1]):
                continue
            if OPEN.fullmatch(cell) and not (separated and marks == ["."]):
                unsure = unsure or (record.row + first_row - 1, column, cell)
            else:
                # Of two marks the last one stands before decimals; one that repeats stands between thousands.
                repeats = len(marks) > 1 and marks[-1] == marks[0]
                counts[_OTHER[marks[0]] if repeats else marks[-1]] += 1
    return ("," if counts[","] > counts["."] else "."), None if counts else unsure


def _settled(decimal: str, mark: str, stated: Stated, *, named: bool) -> tuple[str, str | None]:
    """The mark before decimals and those between thousands, None where these are to be found.

    Args:
        decimal: the one that was found.
        mark: that could be either; empty if none.
        stated: what somebody said.
        named: whether that counts only where the table leaves it open.
    """
    between = THOUSANDS[stated.thousands] if stated.thousands else None
    if stated.decimal and (mark or not named):
        decimal = DECIMALS[stated.decimal]
    elif mark:
        decimal = _OTHER[mark] if between == mark else mark
    if between is not None and decimal not in between:
        return decimal, between
    return decimal, mark if mark not in ("", decimal) else None


def _thousands(body: memoryview, delimiter: str, decimal: str) -> str:
    """The marks between thousands, where a number shows without doubt that there are any."""
    mark = re.escape(decimal)
    quoted = re.search(b'"', body) is not None
    for marks in THOUSANDS.values():
        within = delimiter in marks
        if not marks or decimal in marks or (within and not quoted):
            continue
        any_mark = f"(?:{'|'.join(map(re.escape, marks))})"
        before, after = ('"', '"') if within else (r"(?<![\d.,])", r"(?!\d)")
        groups = rf"[+-]?\d{{1,3}}(?:(?:{any_mark}\d{{3}})+{mark}\d|(?:{any_mark}\d{{3}}){{2,}}{after})"
        # The second search takes a second for 20 MB.
        three = rf"{any_mark}\d{{3}}".encode()
        if re.search(three, body) and re.search(f"{before}{groups}".encode(), body):
            return marks
    return ""


def _fitted(names: list[str], records: Sequence[Sequence[str]]) -> list[str]:
    """The names without those of columns that a mark at the end of each line makes, or with such."""
    width = max(map(len, records), default=len(names))
    unlike = any(names[width:]) or any(cell.strip() for cells in records for cell in cells[len(names) :])
    return names if unlike else [*names, *[""] * width][:width]
