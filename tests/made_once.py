"""What a test writes from options alone is written once, and copied for every other test."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable
from functools import wraps
from hashlib import sha256
from inspect import signature
from pathlib import Path
from typing import Any

Maker = Callable[..., Path]
_kept: list[Path] = []


def keep_in(folder: Path) -> None:
    """Keep the originals in ``folder``, which this process may share with others."""
    folder.mkdir(parents=True, exist_ok=True)
    _kept[:] = [folder]


def _originals() -> Path:
    """That folder, or one that lasts as long as this process."""
    if not _kept:
        keep_in(Path(tempfile.mkdtemp(prefix="made-once-")))
        atexit.register(shutil.rmtree, _kept[0], ignore_errors=True)
    return _kept[0]


def made_once(make: Maker) -> Maker:
    """``make(folder, **options)``, called once for the same options: the others get a copy."""

    @wraps(make)
    def copied(folder: Path, **options: Any) -> Path:
        given = signature(make).bind(folder, **options)
        given.apply_defaults()
        key = sha256(repr(list(given.arguments.items())[1:]).encode()).hexdigest()[:16]
        original = once(f"{make.__name__}-{key}", lambda path: make(path, **options))
        shutil.copytree(original, folder, dirs_exist_ok=True)
        return folder

    return copied


def once(name: str, make: Callable[[Path], Any]) -> Path:
    """The file or folder of this name that ``make`` writes; another process sees it whole or not at all."""
    original = _originals() / name
    if not original.exists():
        mine = original.with_name(f".{name}.{os.getpid()}")
        make(mine)
        try:
            mine.rename(original)
        except OSError:
            # Another process was faster.
            shutil.rmtree(mine)
    return original
