"""The README's examples in Python run, and do what the text says."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd
import pytest

import bayestissue as bt

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"^### (.+?)\n.*?^```python\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL))


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run the example of a section in a folder that holds the program's data, and return what it printed."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)

    def example(heading: str) -> str:
        exec(compile(EXAMPLES[heading], heading, "exec"), {})  # noqa: S102 - the project's own text
        return capsys.readouterr().out

    return example


def test_one_impact(run):
    said = run("One impact")
    truth = pd.read_csv(ROOT / "data" / "example" / "truth.csv").iloc[5]
    for name, unit in (("K", "N_per_m"), ("C", "N_s_per_m")):
        low, high = re.search(rf"{name} .*\(90 %: ([\d.]+) to ([\d.]+)\)", said).groups()
        # One of ten such intervals would miss; twice as wide a one hardly ever does.
        half = (float(high) - float(low)) / 2
        assert float(low) - half < truth[f"{name}_{unit}"] < float(high) + half


def test_from_arrays(run):
    assert "no errors" in (said := run("From arrays")) or "fine" in said
    assert len(bt.read_dataset("four-impacts").impacts) == 4
