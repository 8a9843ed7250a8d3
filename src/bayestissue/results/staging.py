"""What has no name of its own yet: it takes its name when it is whole, and vanishes otherwise."""

from __future__ import annotations

import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayestissue import stopping


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
