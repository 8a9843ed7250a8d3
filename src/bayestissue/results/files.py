"""The files of a result folder: JSON, netCDF and tables, each whole under its name or not there."""

from __future__ import annotations

import errno
import json
import locale
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bayestissue import stopping

if TYPE_CHECKING:
    import pandas as pd

# Of what HDF5 adds to the numbers themselves.
_MARGIN, _OVERHEAD = 1.05, 500_000


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write an indented JSON file as people read it."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_tree(tree: Any, path: Path) -> None:
    """Write an xarray DataTree as netCDF; what has less than double precision, predictions say, is packed.

    Raises:
        OSError: it can't be written, the disk being full, say.
    """
    # HDF5 has been seen to end the process by a segmentation fault where the disk is full.
    require_room(path, int(_MARGIN * tree.nbytes) + _OVERHEAD)
    try:
        tree.to_netcdf(path, engine="h5netcdf", encoding=_packing(tree))
    except RuntimeError as error:
        # What HDF5 raises where it notices on closing.
        raise OSError(errno.EIO, f"can't be written: {error}", str(path)) from error


def _packing(tree: Any) -> dict[str, dict[str, dict[str, Any]]]:
    """How variables are compressed: double precision is little smaller so, and takes twice as long."""
    return {
        group.path: {
            name: {"compression": "gzip", "compression_opts": 1, "shuffle": True}
            for name, variable in group.data_vars.items()
            if variable.dtype == "float32"
        }
        for group in tree.subtree
    }


def require_room(path: Path, size: int) -> None:
    """Raise an OSError unless a file of so many bytes can be written at ``path``, where there is none yet."""
    if not hasattr(os, "posix_fallocate"):
        if shutil.disk_usage(path.parent).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return
    try:
        with path.open("xb") as file:
            os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        error.filename = str(path)
        raise
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path that takes the name ``path`` when the block ends without an error."""
    path = Path(path).absolute()
    path.parent.mkdir(parents=True, exist_ok=True)
    staging = path.parent / f".{path.name}.partial-{secrets.token_hex(4)}{path.suffix}"
    with passing(staging):
        os.close(os.open(staging, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644))
        yield staging
        staging.replace(path)


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder for the length of a block, among the machine's temporary ones."""
    folder = Path(tempfile.gettempdir()) / f"bayestissue-{secrets.token_hex(8)}"
    with passing(folder):
        folder.mkdir(mode=0o700)
        yield folder


@contextmanager
def passing(path: Path) -> Iterator[None]:
    """What the block makes at ``path`` is gone after it, also where the process is asked to stop."""

    def end() -> str:
        _remove(path)
        return ""

    # Known before it is there, so that no moment of interruption leaves it behind.
    with stopping.explained(end):
        try:
            yield
        finally:
            _remove(path)


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)
    try:
        path.unlink(missing_ok=True)
    except OSError:
        return


# The decimal mark of the spreadsheet; "auto" stands for that of the machine's language and country.
Excel = Literal["auto", "comma", "point"]
_MARK = "\ufeff"
_WITH_COMMA = r"([+-]?\d+(,\d+)?([eE][+-]?\d+)?|nan|[+-]?inf)?"


def write_table(table: pd.DataFrame, path: Path, excel: Excel | None = None) -> None:
    """Write a CSV file.

    Args:
        table: without its index.
        path: of the file.
        excel: None for programs: UTF-8, commas, decimal points. Else as a spreadsheet with this decimal mark
            opens it by itself: UTF-8 with a mark, and between cells semicolons beside decimal commas.
    """
    if excel is None:
        table.to_csv(path, index=False)
        return
    decimal = {"comma": ",", "point": "."}.get(excel) or _decimal_here()
    separator = ";" if decimal == "," else ","
    table.to_csv(
        path, index=False, encoding="utf-8-sig", sep=separator, decimal=decimal, lineterminator="\r\n"
    )


def read_table(path: Path) -> pd.DataFrame:
    """The cells of a table that `write_table` wrote, as text, numbers with a decimal point.

    Raises:
        OSError, UnicodeDecodeError, ParserError, EmptyDataError: it can't be read, as of pandas.
    """
    import pandas as pd

    with path.open(encoding="utf-8") as file:
        first = file.readline()
    # No name of a column has a semicolon.
    commas = first.startswith(_MARK) and ";" in first
    table = pd.read_csv(
        path, dtype=str, keep_default_na=False, encoding="utf-8-sig", sep=";" if commas else ","
    )
    if not commas:
        return table
    numbers = [name for name in table if table[name].str.fullmatch(_WITH_COMMA).all()]
    return table.assign(**{str(name): table[name].str.replace(",", ".", regex=False) for name in numbers})


def _decimal_here() -> str:
    """The decimal mark of the machine's language and country."""
    before = locale.setlocale(locale.LC_NUMERIC)
    try:
        locale.setlocale(locale.LC_NUMERIC, "")
        return str(locale.localeconv()["decimal_point"])
    except locale.Error:
        return "."
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
