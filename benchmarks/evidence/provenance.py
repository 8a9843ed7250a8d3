"""Where a result comes from: what a script writes into results/ when it has measured."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pandas as pd

from evidence.fingerprint import changed, of_parts
from evidence.references import digest_of
from evidence.registry import BENCHMARKS, ROOT, Piece, pieces

RESULTS = BENCHMARKS / "results"
PACKAGES = ("numpy", "scipy", "jax", "numpyro", "arviz")
# Options that say how far one call goes, and not what is measured.
OF_ONE_CALL = ("--seconds", "--lane", "--lanes")


@dataclass
class Record:
    """A measurement that is being made."""

    piece: Piece
    # What is left to do, in words; empty when all is measured.
    left: str = ""


@contextmanager
def recorded(name: str, command: str = "") -> Iterator[Record]:
    """Run what measures a piece, and write results/NAME.json when it is done.

    A piece that goes on where it stopped keeps its rows only if no part that it speaks of has changed since
    they were made; others are dropped here, before anything is measured. A run that ends early sets ``left``.

    Args:
        name: of the piece in evidence.toml.
        command: the script and its arguments, where this process was called for several pieces at once.
    """
    piece = pieces()[name]
    parts, commit = of_parts(ROOT, piece.parts()), _commit(piece)
    before, spent, begun = read(piece), 0.0, time.monotonic()
    record = Record(piece, left="interrupted")
    about = {
        "piece": name,
        "command": command or _typed(),
        **commit,
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "machine": machine(),
        "versions": _versions(),
    }
    rests_on = {"references": references_of(piece), "parts": parts}

    def write() -> None:
        seconds = {"seconds": round(spent + time.monotonic() - begun), "left": record.left}
        moved = {"changed_meanwhile": changed(parts, of_parts(ROOT, piece.parts()))}
        content = about | seconds | {"rows": digest(piece.rows())} | moved | rests_on
        RESULTS.mkdir(exist_ok=True)
        _path(piece).write_text(f"{json.dumps(content, indent=1, ensure_ascii=False)}\n", encoding="utf-8")

    if piece.resumes:
        if before is not None and all(before.get(key) == value for key, value in rests_on.items()):
            spent = before["seconds"] or 0.0
        elif dropped := piece.forget():
            print(f"{name}: {dropped} rows of another version, or of an unknown one, are dropped", flush=True)
        # From now on what is in the table is of this version.
        write()
    try:
        record.left = ""
        yield record
    except BaseException:
        record.left = record.left or "interrupted"
        if piece.resumes:
            write()
        raise
    write()
    fill_pages()


def references_of(piece: Piece) -> dict[str, str]:
    """The digest of each set of reference results that a piece rests on."""
    return {name: digest_of(name) for name in piece.references}


def fill_pages() -> None:
    """Write the figures into the pages, by this package as it is now: a run may take hours."""
    environment = os.environ | {"PYTHONPATH": str(BENCHMARKS)}
    subprocess.run([sys.executable, "-m", "evidence", "pages"], env=environment, check=False)


def read(piece: Piece) -> dict[str, Any] | None:
    """The provenance of a piece; None where none was kept."""
    path = _path(piece)
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def digest(rows: pd.DataFrame) -> str:
    """Of a piece's rows by their values, however they are written; empty without rows."""
    if rows.empty:
        return ""
    told = [sorted((name, str(value)) for name, value in row.items() if not pd.isna(value)) for row in
            rows.astype(object).map(_plain).to_dict("records")]  # fmt: skip
    return hashlib.sha256(repr(told).encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    # A column of whole numbers becomes one of floats when another row lacks it.
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def machine() -> str:
    """The processor and how many of its cores this process may use."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{models[0] if models else platform.machine()}, {usable} core{'s' * (usable != 1)}"


def without(arguments: list[str], options: tuple[str, ...] = OF_ONE_CALL) -> list[str]:
    """A command's arguments without these options and their values."""
    kept, skip = [], False
    for each in arguments:
        if not skip and each not in options:
            kept.append(each)
        skip = each in options
    return kept


def _typed() -> str:
    script = Path(sys.argv[0]).resolve()
    name = script.relative_to(ROOT).as_posix() if script.is_relative_to(ROOT) else script.name
    return " ".join(without([name, *sys.argv[1:]]))


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


def _commit(piece: Piece) -> dict[str, Any]:
    """The commit, and whether a part differs from it."""
    commit = _git("rev-parse", "--short", "HEAD")
    return {"commit": commit or "unknown", "dirty": bool(_git("status", "--porcelain", "--", *piece.parts()))}


def _git(*arguments: str) -> str:
    """What git answers; nothing where there is no git, or no repository."""
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)  # noqa: S603, S607
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _path(piece: Piece) -> Path:
    return RESULTS / f"{piece.name}.json"
