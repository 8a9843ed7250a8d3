from __future__ import annotations

import os
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

from make_published_run import make_published_run

NOTEBOOK = Path(__file__).resolve().parents[2] / "notebooks" / "published.py"


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """The notebook after a run on a made-up run folder, or on the one that BAYESTISSUE_RUN names."""
    folder = tmp_path_factory.mktemp("notebook")
    run = os.environ.get("BAYESTISSUE_RUN") or make_published_run(folder / "run")
    notebook = jupytext.read(NOTEBOOK)
    client = NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    return client.execute(env={**os.environ, "BAYESTISSUE_RUN": str(run)})


def outputs(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def test_every_cell_runs_without_a_warning(executed):
    loud = [output for output in outputs(executed) if output.get("name") == "stderr"]
    assert [output["text"] for output in loud] == []


def test_it_tells_what_it_found(executed):
    text = "".join(output.get("text", "") for output in outputs(executed))
    assert "divergent transitions: 0" in text
    assert "a fixed stiffness would give 0.530" in text


def test_it_is_kept_without_outputs():
    assert not list(NOTEBOOK.parent.glob("*.ipynb"))
