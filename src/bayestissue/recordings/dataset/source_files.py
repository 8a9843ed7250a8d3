"""The bytes and text of a file that somebody else wrote."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import os
import re
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import InputError

if TYPE_CHECKING:
    from python_calamine import CalamineWorkbook

    from bayestissue.recordings.dataset.dialect import Stated

LIMIT = "BAYESTISSUE_LARGEST_FILE_MB"
_UTF8_MARK = codecs.BOM_UTF8


@dataclass(frozen=True)
class FileSettings:
    """How much of a file is looked at, in bytes where nothing else is said.

    Attributes:
        largest_mb: a file once it is unpacked, and all recordings of a dataset, MB: see `largest`.
        longest_line: more than any line of column names has.
        head: of a text, in which its marks and names are looked for,
        lines: and so many lines with cells.
    """

    largest_mb: float = 1000.0
    longest_line: int = 1 << 16
    head: int = 1 << 18
    lines: int = 200


FILES = FileSettings()
# Texts that may be LabVIEW's have blocks with numbers, as workbooks have sheets with names.
_PART = re.compile(r"(.+\.xlsx)#(.+)|(.+\.(?:lvm|txt|dat|asc|csv|tsv))#(\d+)", re.IGNORECASE | re.DOTALL)


def largest() -> float:
    """How many bytes a file may have once it is unpacked, and the recordings of a dataset together.

    A few kilobytes can unpack to more than any memory holds. 1000 MB, or what the environment variable
    ``BAYESTISSUE_LARGEST_FILE_MB`` says.

    Raises:
        InputError: the variable holds no number above 0.
    """
    said = os.environ.get(LIMIT, "")
    try:
        megabytes = float(said) if said.strip() else FILES.largest_mb
    except ValueError:
        megabytes = float("nan")
    if not megabytes > 0:
        raise InputError.stated("file-too-large.limit", LIMIT, value=said)
    return megabytes * 1e6


def require_small(size: float, label: str, *, share: float = 1.0) -> None:
    """Refuse what would take more than `largest` bytes.

    Args:
        size: in bytes.
        label: what to call the file in a message.
        share: of these bytes, for what takes many times its size once it is taken apart.

    Raises:
        InputError: it is larger.
    """
    if size > (limit := share * largest()):
        value = f"{size / 1e6:.4g} MB"
        key, words = "file-too-large.unpacked", {"limit": limit / 1e6, "variable": LIMIT}
        raise InputError.stated(key, label, value=value, **words)


@dataclass(frozen=True)
class Source:
    """A file that somebody else wrote, or a part of one, and what to say of it.

    Attributes:
        path: where the file lies.
        name: what to call the file in a message.
        part: of a workbook the sheet, of LabVIEW's text the number of the block; empty of the whole.
        remedy: what to do if it is not there.
        stated: how a text is written, as far as somebody said so.
    """

    path: Path
    name: str
    part: str = ""
    remedy: str = "Put the file there."
    stated: Stated | None = None

    @classmethod
    def at(cls, path: Path, name: str = "", **further: Any) -> Source:
        """What a path names: ``p1.xlsx#left`` and ``p1.lvm#2`` a part, unless a file is called so.

        Args:
            path: of a file, or of a part of one.
            name: what to call it in a message; the last part of the path if empty.
            further: other attributes.
        """
        name, match = name or path.name, _PART.fullmatch(str(path))
        if not match or os.path.exists(path):  # noqa: PTH110
            return cls(path, name, **further)
        part = match[2] or match[4]
        return cls(Path(match[1] or match[3]), name.removesuffix(f"#{part}"), part, **further)

    @property
    def label(self) -> str:
        """What to call it, with its part, in a message."""
        return f"{self.name}#{self.part}" if self.part else self.name

    @property
    def suffix(self) -> str:
        """What the file's name says of its format."""
        return suffix_of(self.path)

    @property
    def stem(self) -> str:
        """The file's name without its ending."""
        return self.name[: len(self.name) - len(self.suffix)]

    @property
    def is_sheet(self) -> bool:
        """Whether a part of the file is a sheet; otherwise it is a block."""
        return self.suffix == ".xlsx"

    def read(self, *, share: float = 1.0) -> bytes:
        """The content of the whole file, unpacked if its name ends in ``.gz``.

        Args:
            share: of the bytes that a file may have; see `require_small`.

        Raises:
            InputError: it is missing, no regular file, unreadable, empty, too large, or a broken archive.
        """
        path, label = self.path, self.label
        try:
            size = path.stat().st_size
            if not path.is_file():
                kind = "a folder" if path.is_dir() else "a device, a pipe or the like"
                raise InputError.stated("unreadable-file.kind", label, value=kind, remedy=self.remedy)
            require_small(size, label, share=share)
            if path.suffix == ".gz" and size:
                with gzip.open(path) as packed:
                    data = packed.read(int(largest()) + 1)
                require_small(len(data), label)
            else:
                data = path.read_bytes()
        except InputError:
            raise
        except FileNotFoundError:
            key = "no-file.recording"
            raise InputError.stated(key, label, value="no such file", remedy=self.remedy) from None
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            raise InputError.stated("damaged-file.gzip", label, value=str(error)) from None
        except (OSError, ValueError) as error:
            raise InputError.stated("unreadable-file.permissions", label, value=str(error)) from None
        if not data or data.isspace():
            raise InputError.stated("no-rows.file", label, value="an empty file")
        return data


def suffix_of(path: Path) -> str:
    """What a file's name says of its format: how it ends, in small letters."""
    return "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()


def error_line(error: BaseException) -> str:
    """What a library says of a damaged file, in one line."""
    return (str(error).splitlines() or [""])[0] or type(error).__name__


@contextmanager
def decoded(
    kind: str, label: str, *, spared: type[BaseException] = InputError, **words: str
) -> Iterator[None]:
    """A block that takes a file apart, in which damaged bytes can fail anywhere.

    Args:
        kind: of the file, as the message ``damaged-file`` has it.
        label: what to call it.
        spared: what is no sign of damage, besides what always is none.
        words: in the message.

    Raises:
        InputError: whatever failed. A decoder may be another language's and panic, which is no `Exception`.
    """
    try:
        yield
    except (InputError, KeyboardInterrupt, SystemExit, spared):
        raise
    except BaseException as error:
        raise InputError.stated(f"damaged-file.{kind}", label, value=error_line(error), **words) from error


def require_lines(data: bytes, label: str) -> None:
    """Refuse a text of UTF-8 whose first line is longer than any line of column names."""
    line, longest = re.split(rb"[\r\n]", data[: FILES.longest_line], maxsplit=1)[0], FILES.longest_line
    if len(line) == longest < len(data) - 3:
        value = line[:60].decode("utf-8", "replace")
        raise InputError.stated("not-text.first-line", label, row=1, value=value, longest=longest)


def as_utf8(data: bytes, label: str, encoding: str | None = None) -> tuple[bytes, str]:
    """A text as UTF-8 without a mark, and how it was encoded.

    A mark says what it is; without one, text in which every other byte is 0 is UTF-16, what decodes as UTF-8
    is UTF-8, and the rest is cp1252, the code page of western Windows, unless parts of it are UTF-8.

    Args:
        data: of the file.
        label: what to call it in a message.
        encoding: ``"utf-8"``, ``"utf-16"`` or ``"cp1252"``; found if None.

    Returns:
        The text, and ``"utf-8"``, ``"utf-8-sig"`` (with a mark), ``"utf-16"`` or ``"cp1252"``.

    Raises:
        InputError: it is no such text, with the row of the first wrong byte.
    """
    encoding = encoding or _encoding(data)
    if encoding == "utf-16":
        return _require(data, label, _utf16(data) or encoding), encoding
    if encoding == "utf-8" and data.startswith(_UTF8_MARK):
        return _require(data.removeprefix(_UTF8_MARK), label, encoding), "utf-8-sig"
    return _require(data, label, encoding), encoding


def _encoding(data: bytes) -> str:
    if _utf16(data):
        return "utf-16"
    if data.isascii():
        return "utf-8"
    with suppress(UnicodeDecodeError):
        data.decode("utf-8")
        return "utf-8"
    # A text of which parts are UTF-8 is a damaged one.
    return "cp1252" if data.decode("utf-8", "ignore").isascii() else "utf-8"


def _utf16(data: bytes) -> str:
    """The order of bytes of UTF-16 text; empty where it is none."""
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    start = data[: FILES.longest_line]
    zeros = {order: start[first::2].count(0) for order, first in (("utf-16-le", 1), ("utf-16-be", 0))}
    order = max(zeros, key=lambda candidate: zeros[candidate])
    # Of each pair one byte is 0 in nearly all text of numbers, and never the other.
    return order if zeros[order] > 0.4 * len(start) and sum(zeros.values()) == zeros[order] else ""


def _require(data: bytes, label: str, encoding: str) -> bytes:
    """The text as UTF-8.

    Raises:
        InputError: it is not in this encoding, or holds characters that are 0, as damaged files do.
    """
    if encoding == "utf-8" and data.isascii() and b"\0" not in data:
        return data
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        slip: object = data[error.start : error.start + 1]
        row = data[: error.start].count(b"\n") + 1
    else:
        if "\0" not in text:
            return data if encoding == "utf-8" else text.encode()
        slip, row = "a byte that is 0", text.count("\n", 0, text.index("\0")) + 1
    raise InputError.stated("not-text.encoding", label, row=row, value=slip) from None


_ZIP = b"PK\x03\x04"


def is_workbook(data: bytes) -> bool:
    """Whether a file is a workbook, whatever it is called."""
    return data.startswith(_ZIP)


def sheet_names(data: bytes, label: str) -> tuple[list[str], list[str]]:
    """The names of the sheets of cells that a workbook shows, and of those that it hides.

    Raises:
        InputError: it is no whole workbook, too large once unpacked, or protected.
    """
    with _opened(data, label) as (_, shown, hidden):
        return shown, hidden


def sheet_text(data: bytes, label: str, sheet: str = "") -> tuple[str, bytes]:
    """A sheet: its name, and its cells as CSV with commas, a row for each row.

    Without a name the first that is shown and not empty; where none is, the first of those that are hidden.
    Numbers have the digits that give them back exactly, whatever the sheet shows.

    Raises:
        InputError: it is no whole workbook, too large once unpacked, protected or empty, or lacks the sheet.
    """
    with _opened(data, label) as (book, shown, hidden):
        if sheet and sheet not in (*shown, *hidden):
            names = ", ".join(shown)
            raise InputError.stated("no-channel.sheet", label, value=sheet, names=names)
        for name in [sheet] if sheet else [*shown, *hidden]:
            rows: list[list[Any]] = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            if any(isinstance(cell, _TIMES) for row in rows for cell in row):
                rows = _with_all_digits(rows, data, label, name)
            if any(cell != "" for row in rows for cell in row):
                return name, _csv(rows)
    raise InputError.stated("no-rows.sheets", label, value="empty sheets")


@contextmanager
def _opened(data: bytes, label: str) -> Iterator[tuple[CalamineWorkbook, list[str], list[str]]]:
    """A workbook, and the names of its sheets of cells, those that it shows and those that it hides."""
    from python_calamine import CalamineWorkbook, SheetTypeEnum, SheetVisibleEnum

    with decoded("workbook", label, spared=MemoryError):
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            size = sum(member.file_size for member in packed.infolist())
            if "xl/workbook.xml" not in packed.namelist():
                raise ValueError("no workbook of the kind .xlsx in it")
        require_small(size, label, share=0.5)
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        of_cells = [sheet for sheet in book.sheets_metadata if sheet.typ == SheetTypeEnum.WorkSheet]
        shown = [sheet.name for sheet in of_cells if sheet.visible == SheetVisibleEnum.Visible]
        yield book, shown, [sheet.name for sheet in of_cells if sheet.name not in shown]


_TIMES = (datetime, time, timedelta)


def _with_all_digits(rows: list[list[Any]], data: bytes, label: str, name: str) -> list[list[Any]]:
    """The rows with times as they are stored, of which the decoder keeps thousandths of a second.

    Without styles no cell is a time, and each is the number of days that it is.
    """
    bare = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as packed, zipfile.ZipFile(bare, "w") as unpacked:
        for member in packed.namelist():
            if member != "xl/styles.xml":
                unpacked.writestr(member, packed.read(member))
    with _opened(bare.getvalue(), label) as (book, *_):
        days = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
    return [list(map(_time_of, *pair)) for pair in zip(rows, days, strict=True)]


def _time_of(cell: Any, days: object) -> Any:
    if not isinstance(cell, _TIMES) or not isinstance(days, float | int):
        return cell
    lasts = isinstance(cell, timedelta)
    seconds = 86_400 * (days if lasts else days % 1)
    minutes, remainder = divmod(seconds, 60)
    clock = f"{int(minutes // 60):02}:{int(minutes % 60):02}:{remainder:012.9f}"
    whole = not lasts and abs(seconds - round(seconds)) < 1e-6
    return cell if whole else f"{cell.date()} {clock}" if isinstance(cell, datetime) else clock


def _csv(rows: Sequence[Sequence[object]]) -> bytes:
    text = io.StringIO(newline="")
    # A cell of several lines would make the numbers of rows other ones than those of the sheet.
    lines = [[" ".join(plain_text(cell).split()) for cell in row] for row in rows]
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue().encode()


def plain_text(value: Any) -> str:
    """A cell as a file has it: every digit of a number, nothing where one is missing."""
    value = value.item() if isinstance(value, np.generic) else value
    # Only what is no number differs from itself.
    if value is None or value is pd.NA or value is pd.NaT or value != value:
        return ""
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return str(value).strip()
