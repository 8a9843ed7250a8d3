"""Fingerprints of files, which differ where the program or a setting does, and not where only words do."""

from __future__ import annotations

import ast
import hashlib
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from evidence.registry import SHOWN

ABSENT = "absent"
# What a folder's fingerprint is made of: source, settings and tables.
SUFFIXES = {".py", ".toml", ".csv", ".lark"}


def of_file(path: Path) -> str:
    """16 hexadecimal digits, or "absent".

    Of Python the syntax tree counts, without docstrings and the words of errors; of TOML the values. Comments
    and layout count in neither.
    """
    if not path.is_file():
        return ABSENT
    about = path.stat()
    return _of_content(path, about.st_mtime_ns, about.st_size)


@cache
def _of_content(path: Path, changed_ns: int, size: int) -> str:
    content = path.read_bytes()
    if path.suffix == ".py":
        content = repr(_tree(ast.parse(content))).encode()
    elif path.suffix == ".toml":
        content = repr(tomllib.loads(content.decode())).encode()
    return _digest([content.replace(b"\r\n", b"\n")])


def of_parts(root: Path, parts: Iterable[str]) -> dict[str, str]:
    """The fingerprint of each part by its path, and of a folder that of every folder in it.

    ``FOLDER/*`` is the folder without those in it.
    """
    found = {}
    for part in parts:
        folder = root / part.removesuffix("/*")
        if not folder.is_dir():
            found[part] = of_file(root / part)
            continue
        listed = folder.iterdir() if part.endswith("/*") else folder.rglob("*")
        inside = sorted(path for path in listed if path.suffix in SUFFIXES and path != SHOWN)
        for parent in sorted({path.parent for path in inside}):
            names = [f"{path.name} {of_file(path)}\n".encode() for path in inside if path.parent == parent]
            found[parent.relative_to(root).as_posix()] = _digest(names)
    return found


def changed(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """The parts that are not what they were, or are new, or gone."""
    return sorted(part for part in before.keys() | now.keys() if before.get(part) != now.get(part))


def _digest(contents: Iterable[bytes]) -> str:
    made = hashlib.sha256()
    for each in contents:
        made.update(each)
    return made.hexdigest()[:16]


def _tree(node: Any) -> Any:
    """The syntax tree as nested lists; empty fields are left out, since Python's versions differ in them."""
    if isinstance(node, list):
        return [_tree(each) for each in node]
    if isinstance(node, ast.Raise):
        return "raise"
    if not isinstance(node, ast.AST):
        return node
    fields = dict(ast.iter_fields(node))
    if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        fields["body"] = node.body[ast.get_docstring(node, clean=False) is not None :]
    told = [(name, _tree(value)) for name, value in fields.items() if value is not None and value != []]
    return [type(node).__name__, *told]
