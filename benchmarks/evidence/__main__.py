"""The command `python -m evidence`: what is known, run what is not, fill the pages."""

from __future__ import annotations

import argparse
import os
import sys

from evidence.checking import check_numbers
from evidence.figures import figures
from evidence.pages import fill
from evidence.provenance import TRIAL
from evidence.references import SETS
from evidence.registry import Piece, pieces
from evidence.running import left, run_pieces
from evidence.status import state_of


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m evidence", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("status", help="each piece: fresh, or what has changed since")
    run = commands.add_parser("run", help="run pieces that are not fresh, all unless named")
    run.add_argument("names", nargs="*", help="of pieces, or of families of pieces")
    run.add_argument("--again", action="store_true", help="run fresh ones too")
    run.add_argument("--units", help="of each no more than so many units, such as campaigns, for a trial")
    check = commands.add_parser("check", help="whether the program's numbers are those that were accepted")
    check.add_argument("sets", nargs="*", help=f"of references.csv, all unless named: {', '.join(SETS)}")
    check.add_argument("--accept", action="store_true", help="take what differs as the program's numbers now")
    commands.add_parser("pages", help="write the figures into sentences of the README and the manual")
    commands.add_parser("figures", help="list the names of all figures, and what they are now")
    asked = parser.parse_args()
    if asked.command == "run":
        os.environ |= {TRIAL: asked.units} if asked.units else {}
        sys.exit(run_pieces(chosen(asked.names), again=asked.again))
    if asked.command == "check":
        sys.exit(check_numbers(asked.sets or list(SETS), accept=asked.accept))
    if asked.command == "status":
        for piece in pieces().values():
            print(f"{piece.name:34} {state_of(piece).why}")
        print(left([piece for piece in pieces().values() if state_of(piece).kind != "fresh"]))
    elif asked.command == "figures":
        for name, figure in figures().items():
            print(f"{name}: {'(table)' if figure.block else figure.text}")
    else:
        print("\n".join(fill()) or "nothing to change")


def chosen(asked: list[str]) -> list[Piece]:
    """The pieces of these names or families, all without any."""
    known = pieces().values()
    wrong = [name for name in asked if not any(name in (piece.name, piece.family) for piece in known)]
    if wrong:
        names = ", ".join(dict.fromkeys(piece.family for piece in known))
        sys.exit(f"No evidence is called {', '.join(wrong)}. There are: {names}.")
    return [piece for piece in known if not asked or piece.name in asked or piece.family in asked]


if __name__ == "__main__":
    main()
