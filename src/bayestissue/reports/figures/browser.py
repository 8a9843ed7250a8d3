"""What a page carries so that a browser draws its figures from the file alone: library and packed data."""

from __future__ import annotations

import base64
import gzip
import json
import math
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from typing import Any

from bayestissue.base.results.files import whole_file

# Digits of a number, and of the range of its column, that a figure holds: a pixel shows no more.
DIGITS = 4


def packed(content: bytes) -> str:
    """``content`` compressed, as text; the same content is the same text."""
    return _as_text(gzip.compress(content, 9, mtime=0))


def _as_text(data: bytes) -> str:
    """Four bytes as five letters, none of which means anything in HTML."""
    return base64.b85encode(data).decode().translate(str.maketrans("<>&", ",:."))


def figure_json(specification: dict[str, Any]) -> str:
    """A figure as a page holds it: JSON, each of its tables by column, no tag in it."""
    tables = {name: by_column(rows) for name, rows in specification["datasets"].items()}
    content = _rounded(specification | {"datasets": tables})
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def by_column(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """A table's columns in place of its rows, which pack worse, its numbers `_shortened`."""
    return {name: _shortened([row[name] for row in rows]) for name in (rows[0] if rows else ())}


def _shortened(column: list[Any]) -> list[Any]:
    """Numbers with `DIGITS` digits, or with those of the column's range where these are more."""
    numbers = [value for value in column if isinstance(value, float) and math.isfinite(value)]
    spread = max(numbers, default=0.0) - min(numbers, default=0.0)

    def shortened(value: Any) -> Any:
        if not isinstance(value, float) or not math.isfinite(value):
            return value
        sizes = [math.floor(math.log10(size)) for size in (abs(value), spread) if size]
        return round(value, DIGITS - 1 - min(sizes, default=0))

    return [shortened(value) for value in column]


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


@cache
def library() -> str:
    """Vega, Vega-Lite and Vega-Embed, as `packed` has it."""
    return _as_text(_compressed_library())


def library_script() -> str:
    """The same as a script."""
    return gzip.decompress(_compressed_library()).decode()


@cache
def _compressed_library() -> bytes:
    """Bundling takes two seconds, so that it is kept in the user's cache folder, by version."""
    from platformdirs import user_cache_path

    path = user_cache_path("bayestissue") / f"vega-{version('vl-convert-python')}.js.gz"
    with suppress(OSError):
        return path.read_bytes()
    import vl_convert

    # Its type says that a snippet is required, its documentation and code that none is.
    script = gzip.compress(vl_convert.javascript_bundle().encode(), 9, mtime=0)  # type: ignore[call-arg]
    with suppress(OSError), whole_file(path) as staging:
        staging.write_bytes(script)
    return script
