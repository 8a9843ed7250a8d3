"""The bytes and text of a file that somebody else wrote."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

from bayestissue.errors import InputError, Problem


def read_bytes(path: Path, label: str, remedy: str) -> bytes:
    """The content of a file, unpacked if its name ends in ``.gz``.

    Args:
        path: where it lies.
        label: what to call it in a message.
        remedy: what to do if it is not there.

    Raises:
        InputError: it is missing, a folder, unreadable, empty, or a broken archive.
    """
    try:
        data = path.read_bytes()
        data = gzip.decompress(data) if path.suffix == ".gz" and data else data
    except FileNotFoundError:
        raise InputError(Problem(label, "a file", remedy, value="no such file")) from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(
            Problem(label, "a whole gzip file", "Pack the file anew or copy it again.", value=str(error))
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(
            Problem(label, "a readable file", "Check its name and permissions.", value=str(error))
        ) from None
    if not data or data.isspace():
        raise InputError(Problem(label, "a header and data", "Export the file anew.", value="an empty file"))
    return data


def require_utf8(data: bytes, label: str) -> None:
    """Refuse text that is not UTF-8, naming the row of the first wrong byte.

    Raises:
        InputError: the text is encoded otherwise.
    """
    if data.isascii():
        return
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            Problem(
                label,
                "text encoded as UTF-8",
                'Save the file as "CSV UTF-8".',
                row=data[: error.start].count(b"\n") + 1,
                value=data[error.start : error.start + 1],
            )
        ) from None
