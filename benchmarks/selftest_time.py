"""How long `bayestissue selftest` takes with nothing compiled yet, and what it finds.

.venv/bin/python benchmarks/selftest_time.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from evidence import recorded
from evidence.commands import timed

from bayestissue.base.results.tables import read_table


def main() -> None:
    with recorded("selftest") as record, tempfile.TemporaryDirectory() as name:
        out, compiled = Path(name) / "selftest", Path(name) / "compiled"
        seconds = timed("selftest", "--quiet", "--out", out, JAX_COMPILATION_CACHE_DIR=str(compiled))
        found = read_table(out, "selftest")
        record.write([{"checks": len(found), "failed": int((found["passed"] == 0).sum())} | seconds])


if __name__ == "__main__":
    main()
