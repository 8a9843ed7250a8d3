"""The pieces of evidence that evidence.toml declares."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

BENCHMARKS = Path(__file__).resolve().parents[1]
ROOT = BENCHMARKS.parent
FILE = BENCHMARKS / "evidence.toml"
# The coverage that a fit's page shows: the evidence writes it, so that it is no part that evidence rests on.
SHOWN = ROOT / "src" / "bayestissue" / "reports" / "pages" / "fit" / "coverage.csv"


@dataclass(frozen=True, eq=False)
class Piece:
    """One measurement: what it asks, how it is made, what it speaks of."""

    name: str
    family: str
    asks: str
    # The script and its arguments, from the root of the project.
    command: tuple[str, ...]
    # Which of its family; empty where it is the only one.
    each: str
    # What it rests on, from the root of the project, without the scripts: files and folders.
    speaks_of: tuple[str, ...]
    # Processor minutes that it takes; of one that is measured alone, minutes of the clock.
    minutes: float
    # The sets of references.csv whose numbers it rests on too.
    references: tuple[str, ...] = ()
    alone: bool = False
    # Packages, and variables of the environment that name a folder, without which it can't be run.
    packages: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()

    @property
    def command_line(self) -> str:
        """As one would type it."""
        return " ".join(self.command)

    def scripts(self) -> tuple[str, ...]:
        """The script, those of this folder that it imports, and the TOML files of their names."""
        return _with_imported(BENCHMARKS / Path(self.command[0]).name)

    def parts(self) -> tuple[str, ...]:
        """The files whose content it rests on: the scripts, and what no reference stands for."""
        return (*self.speaks_of, *self.scripts())

    @property
    def path(self) -> Path:
        """The table of its raw results; beside it, as .json, stands where they come from."""
        return BENCHMARKS / "results" / f"{self.name}.csv"

    def rows(self) -> pd.DataFrame:
        """Its raw results; without any where there is no such file."""
        return _table(self.path, self.path.stat().st_mtime_ns) if self.path.is_file() else pd.DataFrame()

    def forget(self) -> int:
        """Remove the raw results; how many rows they had."""
        count = len(self.rows())
        self.path.unlink(missing_ok=True)
        return count


@cache
def _table(path: Path, _changed_ns: int) -> pd.DataFrame:
    return pd.read_csv(path)


@cache
def content() -> dict[str, Any]:
    """All that evidence.toml says."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


@cache
def pieces() -> dict[str, Piece]:
    """By name, in the order of the file."""
    made = [piece for family, table in content()["pieces"].items() for piece in _pieces(family, table)]
    return {piece.name: piece for piece in made}


def of_family(family: str) -> list[Piece]:
    """The pieces of one family."""
    return [piece for piece in pieces().values() if piece.family == family]


def _pieces(family: str, table: dict[str, Any]) -> Iterator[Piece]:
    parts = content()["parts"]
    for each in table.get("each", [""]):
        name = f"{family}-{each}" if each else family
        own = {key: _with_each(value, each) for key, value in table.items()}
        named = [part for name in own.pop("parts", ()) for part in parts.get(name, [name])]
        own |= {
            "each": each,
            "command": tuple(own["command"].split()),
            "speaks_of": tuple(dict.fromkeys(named)),
        }
        yield Piece(name=name, family=family, **own)


def _with_each(value: Any, each: str) -> Any:
    if isinstance(value, list):
        return tuple(_with_each(one, each) for one in value)
    return value.replace("{each}", each) if isinstance(value, str) else value


@cache
def _with_imported(script: Path) -> tuple[str, ...]:
    here = (script, script.with_suffix(".toml"))
    found = [path.relative_to(ROOT).as_posix() for path in here if path.is_file()]
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        names = [node.module] if isinstance(node, ast.ImportFrom) else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in names:
            if name and (other := BENCHMARKS / f"{name}.py").is_file():
                found += _with_imported(other)
    return tuple(dict.fromkeys(found))
