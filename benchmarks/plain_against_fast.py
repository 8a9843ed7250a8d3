"""How far answers are from those with every fast path off.

    .venv/bin/python benchmarks/plain_against_fast.py

The answers are those of `tests/plain_answers.py`: each is computed here and in a process with
BAYESTISSUE_PLAIN=1. A row has the largest difference over the largest number of its kind, or, of what is
drawn, in Monte Carlo errors.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from evidence import recorded

from bayestissue import runtime

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests"))
from plain_answers import FITS, QUICK, SLOW, both_ways, differences  # noqa: E402

# The first fit; the others are tests.
TOGETHER, DRAWN = "quick", next(iter(FITS))


def main() -> None:
    runtime.configure(one_core=True)
    with recorded("plain_against_fast") as record:
        for unit in record.missing([TOGETHER, *SLOW, DRAWN]):
            names = list(QUICK) if unit == TOGETHER else [unit]
            with tempfile.TemporaryDirectory() as folder:
                apart = differences(*both_ways(Path(folder), names))
            rows = [
                {"answer": name, "drawn": name in FITS, "difference": size} for name, size in apart.items()
            ]
            record.add(unit, rows)


if __name__ == "__main__":
    main()
