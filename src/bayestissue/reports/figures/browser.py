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


def packed(content: bytes) -> str:
    """``content`` compressed, as text; the same content is the same text."""
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


def packed_json(content: Any) -> str:
    """``content`` as JSON with six digits, `packed`."""
    text = json.dumps(_rounded(content), ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return packed(text.encode())


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
    """Vega, Vega-Lite and Vega-Embed, `packed`.

    Bundling takes two seconds, so that it is kept in the user's cache folder, by version.
    """
    from platformdirs import user_cache_path

    path = user_cache_path("bayestissue") / f"vega-{version('vl-convert-python')}.txt"
    with suppress(OSError):
        return path.read_text(encoding="ascii")
    import vl_convert

    # Its type says that a snippet is required, its documentation and code that none is.
    text = packed(vl_convert.javascript_bundle().encode())  # type: ignore[call-arg]
    with suppress(OSError), whole_file(path) as staging:
        staging.write_text(text, encoding="ascii")
    return text
