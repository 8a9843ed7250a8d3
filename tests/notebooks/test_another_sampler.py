from __future__ import annotations

import os
import re
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).resolve().parents[2] / "notebooks" / "another_sampler.py"


@pytest.mark.long
def test_both_samplers_agree(tmp_path: Path):
    resources = {"metadata": {"path": str(tmp_path)}}
    client = NotebookClient(
        jupytext.read(NOTEBOOK), timeout=900, kernel_name="python3", resources=resources
    )
    executed = client.execute(env=dict(os.environ))
    outputs = [output for cell in executed.cells if cell.cell_type == "code" for output in cell.outputs]
    text = "".join(output.get("text", "") for output in outputs)
    greatest = re.search(r"greatest difference: ([\d.]+) errors", text)
    # The greatest of six standard normals is beyond 4 once in 2600 times.
    assert float(greatest[1]) < 4
