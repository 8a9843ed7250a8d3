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
        key = repr(list(given.arguments.items())[1:])
        original = _originals() / f"{make.__name__}-{sha256(key.encode()).hexdigest()[:16]}"
        if not original.exists():
            _in_one_step(make, original, options)
        shutil.copytree(original, folder, dirs_exist_ok=True)
        return folder

    return copied


def _in_one_step(make: Maker, original: Path, options: dict[str, Any]) -> None:
    """Another process sees the original whole or not at all."""
    mine = original.with_name(f".{original.name}.{os.getpid()}")
    make(mine, **options)
    try:
        mine.rename(original)
    except OSError:
        # Another process was faster.
        shutil.rmtree(mine)
