"""Running pieces of evidence one after the other, and saying what is left."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from evidence.registry import ROOT, Piece
from evidence.status import state_of


def left(waiting: list[Piece]) -> str:
    """What is left, in words."""
    if not waiting:
        return "All of it is of this version."
    minutes = sum(piece.minutes for piece in waiting)
    took = f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"
    return f"Left: {len(waiting)}, about {took}. The same command goes on."


def hindered(piece: Piece) -> str:
    """Why a piece can't be run here; empty where it can."""
    packages = [name for name in piece.packages if importlib.util.find_spec(name) is None]
    folders = [name for name in piece.folders if not Path(os.environ.get(name, " ")).is_dir()]
    reasons = [f"needs {', '.join(packages)}: `make evidence-peers`"] if packages else []
    reasons += [f"needs recordings: {name}=FOLDER, the folder of their dataset" for name in folders]
    return "; ".join(reasons)


def run_pieces(asked: Iterable[Piece], *, again: bool = False) -> int:
    """Run those that are not fresh, short ones first, and say what is left; the exit status.

    One that fails does not keep the others from being run.
    """
    asked, failed = list(asked), []
    waiting = [piece for piece in asked if again or state_of(piece).kind != "fresh"]
    here = sorted((piece for piece in waiting if not hindered(piece)), key=lambda piece: piece.minutes)
    print(f"{len(asked) - len(waiting)} of {len(asked)} are of this version and not run again.", flush=True)
    try:
        for number, piece in enumerate(here, 1):
            print(
                f"{piece.name}, {number} of {len(here)}, about {piece.minutes} min: {piece.asks}",
                flush=True,
            )
            begun = time.monotonic()
            if status := _run(piece):
                failed.append(piece.name)
            words = f"failed with status {status}" if status else "measured"
            print(f"{piece.name}: {words} in {(time.monotonic() - begun) / 60:.1f} min", flush=True)
    except KeyboardInterrupt:
        failed.append("interrupted")
    state_of.cache_clear()
    rest = [piece for piece in asked if state_of(piece).kind != "fresh"]
    for piece in rest:
        print(f"{piece.name}: {hindered(piece) or state_of(piece).why}")
    print(left(rest))
    return 1 if failed else 0


def _run(piece: Piece) -> int:
    """Its script in a process of its own, with the program of this checkout; the exit status."""
    paths = [str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = [sys.executable, *piece.command]
    return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode  # noqa: S603 - our own
