"""Where the tables and model files that come with the program lie."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

from bayestissue.errors import InputError

Serves = Callable[[dict[str, Any]], bool]


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


def model_file(model: str | Path, serves: Serves) -> Path:
    """The model file that a name or a path stands for.

    The name of a model that comes with the program, such as ``"impact"``, means that one, also where a file
    or folder of that name lies in the working folder; ``"./impact"`` is the path of the latter.

    Args:
        model: the name as text, or a path.
        serves: whether the content of a model file is for the command that asks.

    Raises:
        InputError: there is neither such a model nor such a file; the right names are listed, the nearest
            first.
    """
    contents = {
        path.stem: tomllib.loads(path.read_text("utf-8")) for path in sorted(shared("models").glob("*.toml"))
    }
    names = [name for name, content in contents.items() if serves(content)]
    if isinstance(model, str) and model in names:
        return shared("models", f"{model}.toml")
    path = Path(model)
    if path.is_file():
        return path
    near = difflib.get_close_matches(path.stem.lower(), names, n=len(names), cutoff=0.5)
    listed = ", ".join(dict.fromkeys([*near, *names]))
    kind = "a folder" if path.is_dir() else "no such model or file"
    key, name = ("no-model.near", near[0]) if near else ("no-model.none", "")
    key, name = ("no-model.program", path.stem) if path.stem in names else (key, name)
    raise InputError.stated(key, str(model), value=kind, listed=listed, name=name)
