"""Where a result comes from: what a script writes into results/ when it has measured."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from evidence.fingerprint import changed, of_parts
from evidence.references import digest_of
from evidence.registry import ROOT, Piece, pieces

# A row, or any number of them.
type Table = Mapping[str, Any] | pd.DataFrame | Iterable[Mapping[str, Any]]
PACKAGES = ("numpy", "scipy", "jax", "numpyro", "arviz")
AS_CSV: Any = {"index": False, "float_format": "%.5g", "lineterminator": "\n"}
# A variable that says how many units one call measures, for a trial.
TRIAL = "EVIDENCE_UNITS"
# Seconds between two lines on what is left.
TELL_S = 20.0


@dataclass
class Record:
    """A measurement that is being made: its raw results, a unit (a campaign, a case) after the other."""

    piece: Piece
    # Writes what is known of the measurement so far, so that a run that is killed has told how long it took.
    keep: Callable[[], None]
    # What is left to do, in words; empty when all is measured.
    left: str = ""

    def missing[Unit](self, units: Iterable[Unit]) -> Iterator[Unit]:
        """Those of ``units`` whose rows the table has not, with a line now and then on what is left."""
        units, rows = list(units), self.piece.rows()
        known = set() if rows.empty else set(rows["unit"].astype(str))
        waiting = [unit for unit in units if str(unit) not in known]
        most, start, said = int(os.environ.get(TRIAL, len(waiting))), time.monotonic(), 0.0
        for number, unit in enumerate(waiting[:most]):
            self.left = f"{len(waiting) - number} of {len(units)} left"
            yield unit
            spent = time.monotonic() - start
            if spent - said > TELL_S:
                said, minutes = spent, spent / (number + 1) * (len(waiting) - number - 1) / 60
                print(f"{self.piece.name}: {self.left}, about {minutes:.0f} min", flush=True)
                self.keep()
        self.left = f"{len(waiting) - most} of {len(units)} left" if len(waiting) > most else ""

    def add(self, unit: object, rows: Table) -> None:
        """Add the rows of a unit, in one write; one that has none is there as a row of its own."""
        frame = pd.DataFrame([rows] if isinstance(rows, Mapping) else rows)
        frame = (frame if len(frame) else pd.DataFrame([{}])).assign(unit=unit)
        self.piece.path.parent.mkdir(exist_ok=True)
        columns = list(pd.read_csv(self.piece.path, nrows=0)) if self.piece.path.is_file() else []
        if columns and set(frame) <= set(columns):
            text = frame.reindex(columns=columns).to_csv(header=False, **AS_CSV)
            with self.piece.path.open("a", encoding="utf-8") as file:
                file.write(text)
        else:
            self.write(pd.concat([pd.read_csv(self.piece.path) if columns else None, frame]))

    def write(self, rows: Table) -> None:
        """Take these rows as all that there are."""
        self.piece.path.parent.mkdir(exist_ok=True)
        pd.DataFrame(rows).to_csv(self.piece.path, **AS_CSV)


def measure[Unit](
    name: str, units: Mapping[str, Unit] | Iterable[Unit], rows_of: Callable[[Unit], Table]
) -> pd.DataFrame:
    """Measure the units of a piece that are not there yet; the rows of all that are.

    Args:
        name: of the piece in evidence.toml.
        units: what is measured one after the other, by its name if it has one.
        rows_of: of a unit its rows.
    """
    from bayestissue.base import runtime

    runtime.configure()
    with recorded(name) as record:
        for unit in record.missing(units):
            record.add(unit, rows_of(units[unit] if isinstance(units, Mapping) else unit))
    return record.piece.rows()


@contextmanager
def recorded(name: str) -> Iterator[Record]:
    """Run what measures a piece, and write results/NAME.json when it is done.

    A piece goes on where it stopped if nothing that it speaks of has changed since; otherwise its rows are
    dropped here, before anything is measured. A run that ends early leaves word in ``left``.

    Args:
        name: of the piece in evidence.toml.
    """
    piece = pieces()[name]
    parts, before = of_parts(ROOT, piece.parts()), read(piece)
    spent, processor, start, worked = 0.0, 0.0, time.monotonic(), _processor_seconds()
    about = {
        "piece": name,
        "command": piece.command_line,
        "commit": head(),
        # Whether a part differs from it.
        "dirty": bool(_git("status", "--porcelain", "--", *piece.parts())),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "machine": machine(),
        "versions": {"python": platform.python_version()} | {name: version(name) for name in PACKAGES},
    }
    rests_on = {"references": references_of(piece), "parts": parts}
    if before is not None and all(before.get(key) == value for key, value in rests_on.items()):
        if piece.path.is_file():
            spent, processor = before["seconds"] or 0.0, before.get("processor_s", 0.0)
    elif dropped := piece.forget():
        print(f"{name}: {dropped} rows of another version, or of an unknown one, are dropped", flush=True)

    def write() -> None:
        seconds = {
            "seconds": round(spent + time.monotonic() - start),
            "processor_s": round(processor + _processor_seconds() - worked),
            "left": record.left,
        }
        moved = {"changed_meanwhile": changed(parts, of_parts(ROOT, piece.parts()))}
        content = about | seconds | {"rows": digest(piece.rows())} | moved | rests_on
        piece.path.parent.mkdir(exist_ok=True)
        piece.path.with_suffix(".json").write_text(
            f"{json.dumps(content, indent=1, ensure_ascii=False)}\n", encoding="utf-8"
        )

    # From now on what is in the table is of this version.
    record = Record(piece, write, left="interrupted")
    write()
    try:
        record.left = ""
        yield record
    except BaseException:
        record.left = record.left or "interrupted"
        raise
    finally:
        write()


def _processor_seconds() -> float:
    """Of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def references_of(piece: Piece) -> dict[str, str]:
    """The digest of each set of reference results that a piece rests on."""
    return {name: digest_of(name) for name in piece.references}


def read(piece: Piece) -> dict[str, Any] | None:
    """The provenance of a piece; None where none was kept."""
    path = piece.path.with_suffix(".json")
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def digest(rows: pd.DataFrame) -> str:
    """Of a piece's rows by their values, however they are written; empty without rows."""
    if rows.empty:
        return ""
    plain = rows.astype(object).map(_plain).to_dict("records")
    told = [sorted((name, str(value)) for name, value in row.items() if not pd.isna(value)) for row in plain]
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


def head() -> str:
    """The commit that is checked out."""
    return _git("rev-parse", "--short", "HEAD") or "unknown"


def _git(*arguments: str) -> str:
    """What git answers; nothing where there is no git, or no repository."""
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)  # noqa: S603, S607
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
