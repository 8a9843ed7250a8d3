"""What a test writes from options alone is written once, and copied for every other test."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any

Maker = Callable[..., Path]


@cache
def _originals() -> Path:
    """A folder that lasts as long as this process."""
    folder = tempfile.mkdtemp(prefix="made-once-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def made_once(make: Maker) -> Maker:
    """``make(folder, **options)``, called once for the same options: the others get a copy."""
    originals: dict[str, Path] = {}

    @wraps(make)
    def copied(folder: Path, **options: Any) -> Path:
        key = repr(sorted(options.items()))
        if key not in originals:
            originals[key] = make(_originals() / f"{make.__name__}-{len(originals)}", **options)
        shutil.copytree(originals[key], folder, dirs_exist_ok=True)
        return folder

    return copied
