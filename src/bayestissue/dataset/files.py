"""The bytes and text of a file that somebody else wrote."""

from __future__ import annotations

import gzip
import os
import stat
import zlib
from pathlib import Path

from bayestissue.errors import InputError, Problem

LIMIT = "BAYESTISSUE_LARGEST_FILE_MB"
_LARGEST_MB = 1000.0
_CHUNK = 1 << 20
_LONGEST_LINE = 1 << 16


def largest() -> float:
    """How many bytes a file may have once it is unpacked, and the recordings of a dataset together.

    A few kilobytes can unpack to more than any memory holds. 1000 MB, or what the environment variable
    ``BAYESTISSUE_LARGEST_FILE_MB`` says.

    Raises:
        InputError: the variable holds no number above 0.
    """
    said = os.environ.get(LIMIT, "")
    try:
        megabytes = float(said) if said.strip() else _LARGEST_MB
    except ValueError:
        megabytes = float("nan")
    if not megabytes > 0:
        raise InputError(
            Problem(
                LIMIT,
                "a number of megabytes above 0",
                "Correct or unset it.",
                value=said,
                code="file-too-large",
            )
        )
    return megabytes * 1e6


def require_small(size: float, label: str, *, share: float = 1.0, known: bool = True) -> None:
    """Refuse what would unpack to more than `largest` bytes.

    Args:
        size: in bytes.
        label: what to call the file in a message.
        share: of these bytes, for what takes many times its size once it is taken apart.
        known: whether ``size`` is the whole, or only how far anybody has looked.

    Raises:
        InputError: it is larger.
    """
    if size > (limit := share * largest()):
        raise InputError(
            Problem(
                label,
                f"at most {limit / 1e6:.6g} MB once unpacked",
                f"If the file is what it should be, set the environment variable {LIMIT} to more.",
                value=f"{'' if known else 'more than '}{size / 1e6:.4g} MB",
                code="file-too-large",
            )
        )


def read_bytes(path: Path, label: str, remedy: str, *, share: float = 1.0) -> bytes:
    """The content of a file, unpacked if its name ends in ``.gz``.

    Args:
        path: where it lies.
        label: what to call it in a message.
        remedy: what to do if it is not there.
        share: of the bytes that a file may have; see `require_small`.

    Raises:
        InputError: it is missing, no regular file, unreadable, empty, too large, or a broken archive.
    """
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            found = "a folder" if stat.S_ISDIR(about.st_mode) else "a device, a pipe or the like"
            raise InputError(
                Problem(label, "a readable, regular file", remedy, value=found, code="unreadable-file")
            )
        require_small(about.st_size, label, share=share)
        data = _unpacked(path, label) if path.suffix == ".gz" and about.st_size else path.read_bytes()
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(Problem(label, "a file", remedy, value="no such file", code="no-file")) from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(
            Problem(
                label,
                "a whole gzip file",
                "Pack the file anew or copy it again.",
                value=str(error),
                code="damaged-file",
            )
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(
            Problem(
                label,
                "a readable file",
                "Check its name and permissions.",
                value=str(error),
                code="unreadable-file",
            )
        ) from None
    if not data or data.isspace():
        raise InputError(
            Problem(
                label, "a header and data", "Export the file anew.", value="an empty file", code="no-rows"
            )
        )
    return data


def _unpacked(path: Path, label: str) -> bytes:
    # Counted before any of it is kept, so that what is too large takes no memory.
    size = 0
    with gzip.open(path) as packed:
        while chunk := packed.read(_CHUNK):
            if not size:
                first_line(chunk, label)
            size += len(chunk)
            require_small(size, label, known=False)
    with gzip.open(path) as packed:
        return packed.read(size)


def unpacked_size(packed: bytes, label: str, *, before: int = 0) -> int:
    """How many bytes a zlib stream unpacks to, counted before any of it is kept: counting takes no memory.

    Args:
        packed: the stream.
        label: what to call the file in a message.
        before: bytes that the same file has unpacked to so far; they are added.

    Raises:
        InputError: they are too many; see `require_small`.
    """
    unpacking, size, rest = zlib.decompressobj(), before, packed
    while chunk := unpacking.decompress(rest, _CHUNK):
        size, rest = size + len(chunk), unpacking.unconsumed_tail
        require_small(size, label, known=False)
    return size


def first_line(data: bytes, label: str) -> bytes:
    """The first line of a text file, without its end and without a byte order mark.

    Raises:
        InputError: it is longer than any line of column names.
    """
    start = data[:_LONGEST_LINE].removeprefix(b"\xef\xbb\xbf")
    line = start.split(b"\n", 1)[0].split(b"\r", 1)[0]
    if len(line) == len(start) < len(data) - 3:
        raise InputError(
            Problem(
                label,
                f"a first line of column names, at most {_LONGEST_LINE} characters long",
                "Export the file anew, as text with line ends.",
                row=1,
                value=line[:60].decode("utf-8", "replace"),
                code="not-text",
            )
        )
    return line


def require_utf8(data: bytes, label: str) -> None:
    """Refuse text that is not UTF-8, naming the row of the first wrong byte.

    Raises:
        InputError: the text is encoded otherwise, or holds bytes that are 0, as UTF-16 and damaged files do.
    """
    if (zero := data.find(b"\0")) >= 0:
        raise InputError(
            Problem(
                label,
                "text encoded as UTF-8",
                'Save the file as "CSV UTF-8", or export it anew.',
                row=data.count(b"\n", 0, zero) + 1,
                value="a byte that is 0",
                code="not-text",
            )
        )
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
                code="not-text",
            )
        ) from None
