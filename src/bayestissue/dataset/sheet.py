"""Excel workbooks, ``.xlsx``: their first sheet that holds anything, as text with a cell for each cell."""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Sequence

from bayestissue.dataset.files import require_small
from bayestissue.errors import InputError, Problem

_ZIP = b"PK\x03\x04"


def is_workbook(data: bytes) -> bool:
    """Whether a file is a workbook, whatever it is called."""
    return data.startswith(_ZIP)


def sheet_text(data: bytes, label: str) -> tuple[str, bytes]:
    """The first sheet that is not empty: its name, and its cells as CSV with commas, a row for each row.

    Numbers have the digits that give them back exactly, whatever the sheet shows.

    Raises:
        InputError: it is no whole workbook, too large once unpacked, protected, or empty.
    """
    from python_calamine import CalamineWorkbook

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            size = sum(each.file_size for each in packed.infolist())
        require_small(size, label, share=0.5)
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        for name in book.sheet_names:
            rows = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            if any(cell != "" for row in rows for cell in row):
                return name, _csv(rows)
    except InputError:
        raise
    except BaseException as error:
        # A damaged file can fail anywhere in the decoder, which is another language's and may panic.
        if isinstance(error, KeyboardInterrupt | SystemExit | MemoryError):
            raise
        found = (str(error).splitlines() or [type(error).__name__])[0]
        remedy = "Save the workbook anew, without a password."
        raise InputError(
            Problem(label, "a whole Excel workbook", remedy, value=found, code="damaged-file")
        ) from error
    raise InputError(
        Problem(label, "a sheet with cells", "Export the file anew.", value="empty sheets", code="no-rows")
    )


def _csv(rows: Sequence[Sequence[object]]) -> bytes:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([[_cell(cell) for cell in row] for row in rows])
    return text.getvalue().encode()


def _cell(cell: object) -> str:
    if isinstance(cell, float):
        return str(int(cell)) if cell.is_integer() and abs(cell) < 1e15 else repr(cell)
    # A cell of several lines would make the numbers of rows other ones than those of the sheet.
    return " ".join(str(cell).split())
