from __future__ import annotations

import os
import re
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

# A whole fit of ninety impacts; the suite's default has those of the command and of the tutorial.
pytestmark = pytest.mark.long
NOTEBOOK = Path(__file__).resolve().parents[2] / "notebooks" / "traces.py"


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    notebook = jupytext.read(NOTEBOOK)
    folder = str(tmp_path_factory.mktemp("notebook"))
    client = NotebookClient(
        notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": folder}}
    )
    # A kernel without widgets says so when a progress bar's library loads; the notebook shows no bar.
    quiet = {"PYTHONWARNINGS": "ignore:IProgress not found"}
    environment = quiet | {name: value for name, value in os.environ.items() if name != "BAYESTISSUE_DATASET"}
    return client.execute(env=environment)


def outputs(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def test_every_cell_runs_without_a_warning(executed):
    loud = [output for output in outputs(executed) if output.get("name") == "stderr"]
    assert [output["text"] for output in loud] == []


def test_it_decides_as_the_truth_is(executed):
    text = "".join(output.get("text", "") for output in outputs(executed))
    assert "diagnostics passed: True" in text
    assert re.findall(r"fixed, whatever the mass: probability [\d.]+: (.*)", text) == ["yes", "yes"]
    assert re.findall(r"in proportion to mass: probability [\d.]+: (.*)", text) == ["no", "no"]
    for quantity in "KC":
        held = re.search(rf"{quantity}: intervals hold (\d\.\d+);", text)
        # 90 % of ninety impacts, some of which share their errors: four binomial standard errors.
        assert abs(float(held[1]) - 0.9) < 4 * (0.9 * 0.1 / 90) ** 0.5
