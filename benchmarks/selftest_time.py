"""How long `bayestissue selftest` takes with nothing compiled yet, and what it finds.

.venv/bin/python benchmarks/selftest_time.py
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
from evidence import recorded

from bayestissue.base.results.tables import read_table


def main() -> None:
    with recorded("selftest") as record, tempfile.TemporaryDirectory() as name:
        out, own = Path(name) / "selftest", {"JAX_COMPILATION_CACHE_DIR": str(Path(name) / "compiled")}
        command = [sys.executable, "-m", "bayestissue", "selftest", "--quiet", "--out", str(out)]
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        subprocess.run(command, check=False, env=os.environ | own)  # noqa: S603 - our own program
        after, seconds = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic() - begin
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        found = read_table(out, "selftest")
        counts = {"checks": len(found), "failed": int((found["passed"] == 0).sum())}
        record.write(pd.DataFrame([counts | {"s": round(seconds, 1), "cpu_s": round(spent, 1)}]))


if __name__ == "__main__":
    main()
