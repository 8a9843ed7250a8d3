"""Where the tables and model files that come with the program lie."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path


def shared(*parts: str) -> Path:
    """The path of a file or folder that comes with the program, such as ``shared("models")``.

    An installed wheel carries copies; a checkout uses the top-level folders themselves.

    Raises:
        FileNotFoundError: nothing of that name comes with the program.
    """
    package = Path(str(files("bayestissue")))
    for root in (package / "_shared", package.parents[1]):
        path = root.joinpath(*parts)
        if path.exists():
            return path
    raise FileNotFoundError(f"{'/'.join(parts)} does not come with this installation")
