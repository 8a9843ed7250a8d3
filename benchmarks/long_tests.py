"""Tests as evidence: how many passed, and how many examples they drew.

    .venv/bin/python benchmarks/long_tests.py damaged_files tests/dataset/test_corruption.py
    .venv/bin/python benchmarks/long_tests.py kills tests/commands/test_fit_command.py -k kills
    .venv/bin/python benchmarks/long_tests.py laws -m 'not(long)' tests/hierarchy/test_laws_of_effects.py

Runs those of the named files that are marked long, unless another -m is given; what
follows goes on to pytest. A row a test: whether it passed, its seconds, and the examples that hypothesis
drew.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import pandas as pd
from evidence import recorded

ROOT = Path(__file__).resolve().parents[1]
STATISTICS = re.compile(
    r"^(\S+::[^\n]*):\n(?:(?!^\S+::).)*?during generate phase.*?- (\d+) passing(?: examples)?, (\d+) failing",
    flags=re.MULTILINE | re.DOTALL,
)


def rows_of(report: Path, said: str) -> pd.DataFrame:
    """A row a test."""
    drawn = {name.split("::")[-1]: (int(good), int(bad)) for name, good, bad in STATISTICS.findall(said)}
    rows = []
    for case in ET.parse(report).iter("testcase"):  # noqa: S314 - pytest's own
        failed = any(case.find(each) is not None for each in ("failure", "error"))
        state = "failed" if failed else "skipped" if case.find("skipped") is not None else "passed"
        good, bad = drawn.get(case.attrib["name"], (None, None))
        row = {"test": case.attrib["name"], "state": state, "seconds": float(case.attrib["time"])}
        rows.append(row | {"examples_passed": good, "examples_failed": bad})
    return pd.DataFrame(rows)


def main() -> None:
    name, *arguments = sys.argv[1:]
    with recorded(name) as record, tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-m", "long", "-n", "0", f"--junitxml={report}"]
        command += ["--hypothesis-show-statistics", *arguments]
        done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)  # noqa: S603
        print(done.stdout)
        found = rows_of(report, done.stdout)
        record.write(found)
        if done.returncode or found.empty:
            record.left = "no test was run" if found.empty else "not all tests passed"
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
