"""Running what is not fresh: two pieces side by side, each on a core of its own, then those that need all."""

from __future__ import annotations

import importlib.util
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from evidence.registry import BENCHMARKS, ROOT, Piece
from evidence.status import state_of

LANES = 2


def minutes_of(pieces: Iterable[Piece], lanes: int = LANES) -> float:
    """About how long these take, by the clock."""
    return sum(piece.minutes / (1 if piece.alone else lanes) for piece in pieces)


def left(waiting: list[Piece]) -> str:
    """What is left, in words."""
    if not waiting:
        return "All of it is of this version."
    minutes = minutes_of(waiting)
    time_left = f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"
    return f"Left: {len(waiting)}, about {time_left} on two cores. The same command goes on."


def hindered(piece: Piece) -> str:
    """Why a piece can't be run here; empty where it can."""
    packages = [name for name in piece.packages if importlib.util.find_spec(name) is None]
    folders = [name for name in piece.folders if not Path(os.environ.get(name, " ")).is_dir()]
    reasons = [f"needs {', '.join(packages)}: `make evidence-peers`"] if packages else []
    reasons += [f"needs recordings: {name}=FOLDER, in which their datasets lie" for name in folders]
    return "; ".join(reasons)


def run_pieces(chosen: Iterable[Piece], *, again: bool = False) -> int:
    """Measure those that are not fresh, with a line as each begins and ends; the exit status.

    Long ones first, so that both cores are busy until the end; those whose time is measured come last, one by
    one. One that fails does not keep the others from being measured.
    """
    chosen = list(chosen)
    waiting = [piece for piece in chosen if again or state_of(piece).kind != "fresh"]
    here = sorted((piece for piece in waiting if not hindered(piece)), key=lambda piece: -piece.minutes)
    fresh = f"{len(chosen) - len(waiting)} of {len(chosen)}"
    print(f"{fresh} are of this version and not measured again.", flush=True)
    if again:
        for piece in here:
            piece.forget()
    to_do, lock, failed = list(here), threading.Lock(), ["interrupted"]

    def measure(piece: Piece) -> str:
        with lock:
            to_do.remove(piece)
            number, minutes = f"{len(here) - len(to_do)} of {len(here)}", minutes_of([piece, *to_do])
        print(f"{piece.name}, {number}: {piece.asks}. All: {minutes:.0f} min left.", flush=True)
        start = time.monotonic()
        status = _run(piece)
        words = f"failed with status {status}" if status else "measured"
        print(f"{piece.name}: {words} in {(time.monotonic() - start) / 60:.1f} min", flush=True)
        return piece.name if status else ""

    try:
        shared, alone = ([piece for piece in here if piece.alone is value] for value in (False, True))
        failed = [name for name in (*_in_lanes(measure, shared), *map(measure, alone)) if name]
    except KeyboardInterrupt:
        print("stopped", flush=True)
    finally:
        fill_pages()
    state_of.cache_clear()
    remaining = [piece for piece in chosen if state_of(piece).kind != "fresh"]
    for piece in remaining:
        print(f"{piece.name}: {hindered(piece) or state_of(piece).why}")
    print(left(remaining))
    return 1 if failed else 0


def _in_lanes(measure: Callable[[Piece], str], pieces: list[Piece]) -> list[str]:
    """What ``measure`` gives of each, two at a time; each lane and its children keep to a core."""
    cores: queue.SimpleQueue[int] = queue.SimpleQueue()
    for core in sorted(os.sched_getaffinity(0))[:LANES] if hasattr(os, "sched_getaffinity") else ():
        cores.put(core)

    def bind() -> None:
        # What binds a thread binds the processes that it starts.
        if not cores.empty():
            os.sched_setaffinity(0, {cores.get()})

    pool = ThreadPoolExecutor(LANES, initializer=bind)
    try:
        return list(pool.map(measure, pieces))
    finally:
        pool.shutdown(cancel_futures=True)


def _run(piece: Piece) -> int:
    """Its script in a process of its own, with the program of this checkout; the exit status."""
    # Where in the program each operation stands costs a twentieth of a compilation, and nobody reads it here;
    # a piece that measures times is run as users run the program.
    return _python(*piece.command, **({} if piece.alone else {"JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0"}))


def fill_pages() -> None:
    """Write the figures into the pages, by this package as it is now: a run may take hours."""
    _python("-m", "evidence", "pages")


def _python(*arguments: str, **variables: str) -> int:
    from bayestissue.base import runtime

    paths = [str(ROOT / "src"), str(BENCHMARKS), os.environ.get("PYTHONPATH", "")]
    # What one piece has compiled is read by the next.
    runtime.keep_compiled()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))} | variables
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, env=environment, check=False).returncode  # noqa: S603 - our own
