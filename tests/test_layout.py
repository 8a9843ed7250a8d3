"""The house: imports of a folder go round in no circle, and those between rooms go one way."""

from __future__ import annotations

import ast
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import bayestissue

SOURCE = Path(bayestissue.__file__).parent
LARGE = ("inference", "model.hierarchy", "model.likelihood")
# The rooms of inference, floor by floor: each may import those of the floors before its own.
ROOMS = (
    ("execution",),
    ("samplers", "points"),
    ("factors",),
    ("chain",),
    ("quantities",),
    ("results",),
    ("checking",),
    ("single",),
    ("answers",),
    ("model_comparison", "published", "fit"),
)


def modules(package: str) -> dict[str, Path]:
    found = {}
    for path in sorted((SOURCE / package.replace(".", "/")).rglob("*.py")):
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


def test_a_name_is_one_module_s_and_one_class_s() -> None:
    paths = [path for path in SOURCE.rglob("*.py") if not path.stem.startswith("__")]
    bodies = [node for path in paths for node in ast.parse(path.read_text(encoding="utf-8")).body]
    classes = [node.name for node in bodies if isinstance(node, ast.ClassDef)]
    for names in ([path.stem for path in paths], classes):
        assert [name for name, count in Counter(names).items() if count > 1] == []


@pytest.mark.parametrize("package", LARGE)
def test_imports_go_round_in_no_circle(package: str) -> None:
    # A circle is an error here, which names it.
    TopologicalSorter(graph(package)).prepare()


def test_rooms_of_inference_import_those_below_them() -> None:
    floor = {room: number for number, rooms in enumerate(ROOMS) for room in rooms}
    edges = [(a, b) for a, below in graph("inference").items() for b in below if "." in a and "." in b]
    rooms = [(a.split(".")[1], b.split(".")[1]) for a, b in edges]
    assert {(a, b) for a, b in rooms if a != b and floor[a] <= floor[b]} == set()
