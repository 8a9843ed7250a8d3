"""Notebooks that fit, run by a kernel: no cell fails, and they find what is true."""

from __future__ import annotations

import os
import re
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

pytestmark = pytest.mark.long
NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
# A kernel without widgets says so when a progress bar's library loads; the notebook shows no bar.
QUIET = {"PYTHONWARNINGS": "ignore:IProgress not found"}


def printed(name: str, folder: Path) -> tuple[str, str]:
    """What a notebook prints, all of it and on standard error."""
    resources = {"metadata": {"path": str(folder)}}
    notebook = jupytext.read(NOTEBOOKS / name)
    client = NotebookClient(notebook, timeout=900, kernel_name="python3", resources=resources)
    environment = {key: value for key, value in os.environ.items() if key != "BAYESTISSUE_DATASET"}
    cells = client.execute(env=environment | QUIET).cells
    outputs = [output for cell in cells if cell.cell_type == "code" for output in cell.outputs]
    texts = [(output.get("text", ""), output.get("name") == "stderr") for output in outputs]
    return "".join(text for text, _ in texts), "".join(text for text, loud in texts if loud)


def test_both_samplers_agree(tmp_path: Path) -> None:
    text, _ = printed("another_sampler.py", tmp_path)
    greatest = re.search(r"greatest difference: ([\d.]+) errors", text)
    # The greatest of six standard normals is beyond 4 once in 2600 times.
    assert float(greatest[1]) < 4


def test_the_fit_of_traces_decides_as_the_truth_is(tmp_path: Path) -> None:
    text, warned = printed("traces.py", tmp_path)
    assert warned == ""
    assert "diagnostics passed: True" in text
    assert re.findall(r"fixed, whatever the mass: probability [\d.]+: (.*)", text) == ["yes", "yes"]
    assert re.findall(r"in proportion to mass: probability [\d.]+: (.*)", text) == ["no", "no"]
    for quantity in "KC":
        held = re.search(rf"{quantity}: intervals hold (\d\.\d+);", text)
        # 90 % of ninety impacts, some of which share their errors: four binomial standard errors.
        assert abs(float(held[1]) - 0.9) < 4 * (0.9 * 0.1 / 90) ** 0.5
