"""The size of each room of src beside its budget: python tools/house.py; --lower brings that down to it.

A room is a folder of src/bayestissue; "top" is what stands beside them. The budget is ``[tool.house]`` of
pyproject.toml, which ``tests/test_house.py`` holds the rooms to. ``--lower`` never raises a number: who needs
more room writes it by hand, with the reason in the commit.
"""

from __future__ import annotations

import argparse
import ast
import tomllib
from collections import Counter, defaultdict
from pathlib import Path

import tomlkit

ROOT = Path(__file__).parents[1]
PROJECT = ROOT / "pyproject.toml"
SOURCE = ROOT / "src" / "bayestissue"

WHAT = ("lines", "modules", "functions", "nodes")
Sizes = dict[str, dict[str, int]]


def sizes(source: Path = SOURCE) -> Sizes:
    """Of each room its lines of code, modules, functions and nodes of the syntax tree.

    Lines of code are those that are no docstring, comment, import or blank line. Nodes are counted without
    docstrings, so that no formatting changes them.
    """
    rooms: dict[str, Counter[str]] = defaultdict(Counter)
    for path in sorted(source.rglob("*.py")):
        parts = path.relative_to(source).parts
        rooms[parts[0] if len(parts) > 1 else "top"] += _sizes_of(path.read_text(encoding="utf-8"))
    return {room: {what: counted[what] for what in WHAT} for room, counted in sorted(rooms.items())}


def budget() -> Sizes:
    """The most that each room may have."""
    stated: Sizes = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["tool"]["house"]
    return stated


def excesses(now: Sizes, most: Sizes) -> list[str]:
    """What each room has above its budget, in words."""
    return [
        f"{room} has {number} {what}, {number - most.get(room, {}).get(what, 0)} above its budget"
        for room, counted in now.items()
        for what, number in counted.items()
        if number > most.get(room, {}).get(what, 0)
    ]


def _sizes_of(text: str) -> Counter[str]:
    tree = ast.parse(text)
    documented = [
        node.body[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and ast.get_docstring(node) is not None
    ]
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    apart = {
        row for node in [*documented, *imports] for row in range(node.lineno, (node.end_lineno or 0) + 1)
    }
    return Counter(
        lines=sum(
            row not in apart and bool(line.strip()) and line.strip()[0] != "#"
            for row, line in enumerate(text.splitlines(), start=1)
        ),
        modules=1,
        functions=sum(isinstance(node, ast.FunctionDef) for node in ast.walk(tree)),
        nodes=sum(1 for _ in ast.walk(tree)) - sum(1 for node in documented for _ in ast.walk(node)),
    )


def lower() -> None:
    """Write the present sizes into the budget where they are smaller, and take out rooms that are gone."""
    document = tomlkit.parse(PROJECT.read_text(encoding="utf-8"))
    stated, now = document["tool"]["house"], sizes()
    for room in list(stated):
        if room not in now:
            del stated[room]
            continue
        for what, number in now[room].items():
            stated[room][what] = min(number, stated[room][what])
    PROJECT.write_text(document.as_string(), encoding="utf-8")


def main() -> None:
    """Print each room's size and budget."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lower", action="store_true", help="bring the budget down to the present sizes")
    if parser.parse_args().lower:
        lower()
    most, now = budget(), sizes()
    print(f"{'room':14}" + "".join(f"{what:>11}{'budget':>9}" for what in WHAT))
    rows = {**now, "all": {what: sum(counted[what] for counted in now.values()) for what in WHAT}}
    most["all"] = {what: sum(counted[what] for counted in most.values()) for what in WHAT}
    for room, counted in rows.items():
        cells = (f"{counted[what]:11}{most.get(room, {}).get(what, 0):9}" for what in WHAT)
        print(f"{room:14}" + "".join(cells))


if __name__ == "__main__":
    main()
