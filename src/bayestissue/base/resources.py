"""Where the tables and model files that come with the program lie."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, MutableMapping
from importlib.resources import files
from itertools import takewhile
from pathlib import Path
from typing import Any

from bayestissue.base.errors import InputError, Problem, path_argument
from bayestissue.base.settings import parse_toml, read_text, row_of

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
    contents = {path.stem: model_content(path) for path in sorted(shared("models").glob("*.toml"))}
    names = [name for name, content in contents.items() if serves(content)]
    if isinstance(model, str) and model in names:
        return shared("models", f"{model}.toml")
    path = path_argument("model", model, "a model's name, or the path of a model file")
    if path.is_file():
        return path
    if gone := Problem.of_retired("model", str(model), str(model)):
        raise InputError(gone)
    near = difflib.get_close_matches(path.stem.lower(), names, n=len(names), cutoff=0.5)
    listed = ", ".join(dict.fromkeys([*near, *names]))
    kind = "a folder" if path.is_dir() else "no such model or file"
    key, name = ("no-model.near", near[0]) if near else ("no-model.none", "")
    key, name = ("no-model.program", path.stem) if path.stem in names else (key, name)
    raise InputError.stated(key, str(model), value=kind, listed=listed, name=name)


# A model file's key: the name or the path of the model that it differs from.
LIKE = "like"


def model_content(path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """What a model file says, and what the one that it is ``like`` says besides: see `with_base`.

    Args:
        path: of the file; one without ``name`` has the file's.
        above: files that are like this one.

    Raises:
        InputError: it or the other can't be read or is not TOML, or there is no such other.
    """
    text = read_text(path, str(path))
    content = parse_toml(text, str(path))
    return {"name": path.stem, **with_base(content, str(path), text, above=(*above, path))}


def with_base(
    content: Mapping[str, Any], source: str, text: str = "", *, above: tuple[Path, ...] = ()
) -> dict[str, Any]:
    """A model's content, with what the one that it is ``like`` says besides.

    Tables are joined key by key, but a distribution is taken whole. Name and description are its own.

    Args:
        content: of its file or dict.
        source: what messages call it.
        text: of its file, whose rows messages then name.
        above: its file, and those that are like it.
    """
    if LIKE not in content:
        return dict(content)
    base = model_content(_base(content[LIKE], source, text, above), above)
    joined = {key: value for key, value in base.items() if key not in ("name", "description")}
    _join(joined, {key: value for key, value in content.items() if key != LIKE})
    return joined


def model_text(path: Path) -> str:
    """A file that says all of `model_content`, with the comments of the one that it is ``like``.

    Raises:
        InputError: as of `model_content`.
    """
    import tomlkit

    text = read_text(path, str(path))
    changes = tomlkit.parse(text)
    if LIKE not in changes:
        return text
    document = tomlkit.parse(model_text(_base(changes.pop(LIKE), str(path), text, (path,))))
    document |= {"name": path.stem, "description": ""}
    _join(document, changes)
    head = takewhile(lambda line: line.startswith("#"), text.splitlines(keepends=True))
    return f"{''.join(head)}\n{document.as_string()}"


def _base(like: Any, source: str, text: str, above: tuple[Path, ...]) -> Path:
    """The file of the model that another is ``like``: a name of the program's, or a path from its folder."""
    names = {file.stem: file for file in sorted(shared("models").glob("*.toml"))}
    if isinstance(like, str):
        base = names.get(like, (above[-1].parent if above else Path()) / like)
        if base.is_file() and base not in above:
            return base
    row, listed = row_of(text, (LIKE,)), ", ".join(names)
    if gone := Problem.of_retired("model", str(like), source, row, LIKE, like):
        raise InputError(gone)
    raise InputError.stated("no-model.like", source, row, LIKE, like, listed=listed)


def _join(base: MutableMapping[str, Any], changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        is_table = isinstance(value, Mapping) and "distribution" not in value
        if is_table and isinstance(base.get(key), MutableMapping):
            _join(base[key], value)
        else:
            base[key] = value
