"""The command `python -m evidence`: what is known, run what is not, fill the pages."""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import time
from pathlib import Path

from evidence.figures import figures
from evidence.pages import fill
from evidence.provenance import adopt
from evidence.registry import ROOT, Piece, pieces
from evidence.status import state_of


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m evidence", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("status", help="each piece: fresh, or what has changed since")
    run = commands.add_parser("run", help="run pieces that are not fresh, all unless named")
    run.add_argument("names", nargs="*", help="of pieces, or of families of pieces")
    run.add_argument("--again", action="store_true", help="run fresh ones too")
    commands.add_parser("pages", help="write the figures into the README and the manual")
    commands.add_parser("figures", help="list the names of all figures, and what they are now")
    kept = commands.add_parser(
        "adopt", help="keep provenance of results that a script made without writing it"
    )
    kept.add_argument("commit", help="at which they were made")
    kept.add_argument("names", nargs="+")
    asked = parser.parse_args()
    if asked.command == "run":
        sys.exit(run_pieces(chosen(asked.names), again=asked.again))
    if asked.command == "status":
        status()
    elif asked.command == "figures":
        for name, figure in figures().items():
            print(f"{name}: {'(table)' if figure.block else figure.printed()}")
    else:
        for piece in chosen(asked.names) if asked.command == "adopt" else ():
            adopt(piece, asked.commit)
        print("\n".join(fill()) or "nothing to change")


def chosen(asked: list[str]) -> list[Piece]:
    """The pieces of these names or families, all without any."""
    known = pieces().values()
    wrong = [name for name in asked if not any(name in (piece.name, piece.family) for piece in known)]
    if wrong:
        names = ", ".join(dict.fromkeys(piece.family for piece in known))
        sys.exit(f"No evidence is called {', '.join(wrong)}. There are: {names}.")
    return [piece for piece in known if not asked or piece.name in asked or piece.family in asked]


def status() -> None:
    """Print the state of each piece."""
    for piece in pieces().values():
        print(f"{piece.name:34} {state_of(piece).why}")
    print(left([piece for piece in pieces().values() if state_of(piece).kind != "fresh"]))


def left(waiting: list[Piece]) -> str:
    """What is left, in words."""
    if not waiting:
        return "All evidence is of this version."
    minutes = sum(piece.minutes for piece in waiting)
    return f"{len(waiting)} pieces are left, about {minutes / 60:.1f} hours: `make evidence`."


def hindered(piece: Piece) -> str:
    """Why a piece can't be run here; empty where it can."""
    packages = [name for name in piece.packages if importlib.util.find_spec(name) is None]
    folders = [name for name in piece.folders if not Path(os.environ.get(name, " ")).is_dir()]
    reasons = [f"needs {', '.join(packages)}: install benchmarks/requirements.lock"] if packages else []
    reasons += [f"needs recordings: set {name} to the folder of the dataset" for name in folders]
    return "; ".join(reasons)


def run_pieces(asked: list[Piece], *, again: bool) -> int:
    """Run them one after the other, and say what is left; the exit status."""
    failed, skipped, waiting = [], [], []
    for piece in asked:
        if not again and state_of(piece).kind == "fresh":
            print(f"{piece.name}: of this version, not run again")
        elif reason := hindered(piece):
            skipped.append(f"{piece.name}: skipped, {reason}")
            print(skipped[-1])
        else:
            waiting.append(piece)
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
    }
    try:
        for number, piece in enumerate(waiting):
            print(
                f"{piece.name}: {number + 1} of {len(waiting)}, about {piece.minutes} minutes: {piece.asks}",
                flush=True,
            )
            begun = time.monotonic()
            done = subprocess.run([sys.executable, *piece.command], cwd=ROOT, env=environment, check=False)  # noqa: S603
            if done.returncode:
                failed.append(piece)
            words = f"failed with status {done.returncode}" if done.returncode else "done"
            print(f"{piece.name}: {words} after {(time.monotonic() - begun) / 60:.1f} minutes", flush=True)
    except KeyboardInterrupt:
        print("\nInterrupted. The same command goes on.")
        failed = failed or waiting
    state_of.cache_clear()
    rest = [piece for piece in asked if state_of(piece).kind != "fresh"]
    print("\n".join(f"{piece.name}: {state_of(piece).why}" for piece in rest))
    print(left(rest))
    return 1 if failed else 0


if __name__ == "__main__":
    main()
