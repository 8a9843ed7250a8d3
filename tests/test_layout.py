"""The house: few modules a folder, few floors, no circle. Where today's falls short, its figure may fall."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import bayestissue

SOURCE = Path(bayestissue.__file__).parent
LARGE = ("inference", "hierarchy", "likelihood")
MOST_MODULES = 12
# Modules on the longest way down by imports: today's number may fall and not rise.
MOST_FLOORS = {"inference": 8, "hierarchy": 8, "likelihood": 4}
# The rooms of inference, floor by floor: each may import those of the floors before its own.
ROOMS = (
    ("execution",),
    ("samplers", "points"),
    ("factors", "quantities"),
    ("posterior", "results"),
    ("comparing", "checking", "answers", "single"),
    ("published", "fit"),
)


def modules(package: str) -> dict[str, Path]:
    found = {}
    for path in sorted((SOURCE / package).rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def graph(package: str) -> dict[str, set[str]]:
    """What each module of a package imports of it, within functions and for types too."""
    known = modules(package)
    return {name: imported(path, known) - {name} for name, path in known.items()}


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            own = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [each.removeprefix("bayestissue.") for each in own]
            # Either a module of a package, or a name in a module.
            found |= {name if name in known else name.rpartition(".")[0] for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name.removeprefix("bayestissue.") for alias in node.names}
    return found & set(known)


@pytest.mark.parametrize("package", LARGE)
def test_a_folder_holds_a_dozen_modules_at_most(package: str) -> None:
    folders = [SOURCE / package, *(path for path in (SOURCE / package).rglob("*") if path.is_dir())]
    number = {
        folder: len([*folder.glob("*.py")]) - 1 for folder in folders if (folder / "__init__.py").is_file()
    }
    assert {f.name: n for f, n in number.items() if n > MOST_MODULES} == {}


@pytest.mark.parametrize("package", LARGE)
def test_imports_go_round_in_no_circle_and_down_few_floors(package: str) -> None:
    below = graph(package)
    floors: dict[str, int] = {}
    # A circle is an error here, which names it.
    for name in TopologicalSorter(below).static_order():
        floors[name] = 1 + max((floors[each] for each in below[name]), default=0)
    assert max(floors.values()) <= MOST_FLOORS[package], [
        n for n, f in floors.items() if f > MOST_FLOORS[package]
    ]


def test_rooms_of_inference_import_those_below_them() -> None:
    floor = {room: number for number, rooms in enumerate(ROOMS) for room in rooms}
    edges = [(a, b) for a, below in graph("inference").items() for b in below if "." in a and "." in b]
    rooms = [(a.split(".")[1], b.split(".")[1]) for a, b in edges]
    assert {(a, b) for a, b in rooms if a != b and floor[a] <= floor[b]} == set()
