"""How much the tests notice: the program is broken in 200 places, one at a time, and its tests are run.

    PYTHONPATH=src:tests python tests/power/breaks.py map build/breaks
    PYTHONPATH=src:tests python tests/power/breaks.py try build/breaks --number 200

`map` runs the quick tests and keeps which lines of src each file of tests runs, and how long it takes.
`try` draws places by a seed, as many of each of the `KINDS` of breaks, each kind over the whole program. A
break is found if a test fails that runs its line; the files that run the fewest lines are tried first. It
writes a row a break, and goes on where it stopped. It needs a copy of the repository that nobody else works
in: src is changed there, and put back.
"""

from __future__ import annotations

import argparse
import ast
import csv
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

OPERATORS: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
BOUNDS: dict[type, type] = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
OPPOSITE: dict[type, type] = {ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is}
KINDS = ("operator", "sign", "index", "bound", "refusal")
SECONDS_A_FILE = 600
FIELDS = ["number", "kind", "file", "line", "before", "after", "found", "by", "seconds"]


class Break(NamedTuple):
    """One place, and what stands there instead.

    Attributes:
        kind: one of `KINDS`.
        file: below the repository's root.
        line: from 1.
        begin: where it begins in the file, as a number of bytes.
        end: where it ends.
        after: what stands there instead.
    """

    kind: str
    file: str
    line: int
    begin: int
    end: int
    after: str


def breaks_of(root: Path, path: Path) -> Iterator[Break]:
    """Every place of a module that can be broken."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    tree = ast.parse(source)
    passed_over = {id(part) for node in ast.walk(tree) for part in _types(node)}

    def broken(kind: str, node: Any, after: ast.AST | str) -> Break:
        text = after if isinstance(after, str) else f"({ast.unparse(after)})"
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[node.end_lineno - 1] + node.end_col_offset
        return Break(kind, str(path.relative_to(root)), node.lineno, begin, end, text)

    for node in ast.walk(tree):
        if id(node) in passed_over:
            continue
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            yield broken("operator", node, ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right))
        elif isinstance(node, ast.BoolOp):
            yield broken("operator", node, ast.BoolOp(OPERATORS[type(node.op)](), node.values))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            yield broken("sign", node, node.operand)
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            (way,) = node.ops
            for kind, table in (("bound", BOUNDS), ("sign", OPPOSITE)):
                if type(way) in table:
                    yield broken(kind, node, ast.Compare(node.left, [table[type(way)]()], node.comparators))
        elif isinstance(node, ast.Subscript) and _whole(node.slice):
            further = ast.BinOp(node.slice, ast.Add(), ast.Constant(1))
            yield broken("index", node, ast.Subscript(node.value, further, ast.Load()))
        elif isinstance(node, ast.Raise) or (
            isinstance(node, ast.Expr) and ast.unparse(node).startswith(("problems.append(", "require_"))
        ):
            yield broken("refusal", node, "pass")


def _whole(node: ast.expr) -> bool:
    value = node.operand if isinstance(node, ast.UnaryOp) else node
    return isinstance(value, ast.Constant) and type(value.value) is int


def _types(node: ast.AST) -> Iterator[ast.AST]:
    """What says types alone, or runs for types alone."""
    stated = [getattr(node, name, None) for name in ("annotation", "returns")]
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        stated += node.body
    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
        stated.append(node)
    for part in stated:
        if part is not None:
            yield from ast.walk(part)


def drawn(root: Path, number: int, seed: int) -> list[Break]:
    """So many places, as many of each kind."""
    places = [place for path in sorted((root / "src").rglob("*.py")) for place in breaks_of(root, path)]
    rng, each = random.Random(seed), number // len(KINDS)  # noqa: S311
    return [place for kind in KINDS for place in rng.sample([p for p in places if p.kind == kind], each)]


class LinesRun:
    """A plugin of pytest: which lines of src the tests of each file run, and how long they take."""

    def __init__(self, root: Path, out: Path) -> None:
        self._root, self._out = f"{root}/src/", out
        self._lines: dict[str, set[int]] = {}
        self._file, self._begun = "", 0.0
        monitor = sys.monitoring
        monitor.use_tool_id(monitor.COVERAGE_ID, "breaks")
        monitor.register_callback(monitor.COVERAGE_ID, monitor.events.LINE, self._run)
        monitor.set_events(monitor.COVERAGE_ID, monitor.events.LINE)

    def _run(self, code: Any, line: int) -> object:
        if code.co_filename.startswith(self._root):
            self._lines.setdefault(code.co_filename.removeprefix(self._root), set()).add(line)
        return sys.monitoring.DISABLE

    def pytest_runtest_protocol(self, item: Any) -> None:
        """Of another file: what the last one ran is written, and compiled functions are traced anew."""
        if (file := item.nodeid.split("::")[0]) != self._file:
            self.pytest_sessionfinish()
            import jax

            jax.clear_caches()
            self._file, self._begun, self._lines = file, time.perf_counter(), {}
            sys.monitoring.restart_events()

    def pytest_sessionfinish(self) -> None:
        """Write what the last file ran."""
        if self._file:
            row = {"seconds": time.perf_counter() - self._begun}
            lines = {name: sorted(numbers) for name, numbers in self._lines.items()}
            path = self._out / f"{self._file.replace('/', '-')}.json"
            path.write_text(json.dumps({"file": self._file, **row, "lines": lines}), encoding="utf-8")


def write_map(root: Path, out: Path) -> int:
    """Run the quick tests of a repository and keep which lines each file runs."""
    import pytest

    out.mkdir(parents=True, exist_ok=True)
    return pytest.main(["-q", "-n", "0", str(root / "tests")], plugins=[LinesRun(root, out)])


def try_breaks(root: Path, out: Path, *, number: int, seed: int, seconds: float) -> None:
    """Break the program in so many places and write which are found, going on from an earlier call."""
    files = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*.json"))]
    files.sort(key=lambda one: sum(map(len, one["lines"].values())))
    table = out / f"breaks-{seed}.csv"
    if not table.exists():
        table.write_text(",".join(FIELDS) + "\n", encoding="utf-8")
    with table.open(newline="", encoding="utf-8") as stream:
        done = {int(row["number"]) for row in csv.DictReader(stream)}
    for turn, place in enumerate(drawn(root, number, seed)):
        if turn in done:
            continue
        name = place.file.removeprefix("src/")
        tests = [one for one in files if place.line in one["lines"].get(name, ())]
        begun = time.perf_counter()
        before, found_by = _tried(root, place, [one["file"] for one in tests], seconds)
        took = f"{time.perf_counter() - begun:.0f}"
        row = [turn, place.kind, place.file, place.line, before, place.after]
        with table.open("a", newline="", encoding="utf-8") as stream:
            csv.writer(stream).writerow([*row, bool(found_by), found_by or f"{len(tests)} files", took])


def _tried(root: Path, place: Break, tests: list[str], seconds: float) -> tuple[str, str]:
    """What stood there, and the file of tests that fails with the other, if one does in time."""
    path, until = root / place.file, time.perf_counter() + seconds
    source = path.read_bytes()
    path.write_bytes(source[: place.begin] + place.after.encode() + source[place.end :])
    try:
        for file in tests:
            if time.perf_counter() > until:
                break
            command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", file]
            try:
                run = subprocess.run(  # noqa: S603
                    command, cwd=root, capture_output=True, timeout=SECONDS_A_FILE, env=dict(os.environ)
                )
            except subprocess.TimeoutExpired:
                return source[place.begin : place.end].decode(), f"{file} (no end)"
            if run.returncode in (1, 2, 3, 4):
                return source[place.begin : place.end].decode(), file
        return source[place.begin : place.end].decode(), ""
    finally:
        path.write_bytes(source)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("action", choices=["map", "try"])
    parser.add_argument("out", type=Path)
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0, help="after which no further file is run")
    options = parser.parse_args()
    root = Path.cwd()
    if options.action == "map":
        sys.exit(write_map(root, options.out.resolve()))
    chosen = {name: getattr(options, name) for name in ("number", "seed", "seconds")}
    try_breaks(root, options.out.resolve(), **chosen)


if __name__ == "__main__":
    main()
