"""The notebook of published estimates, run as the script that it is; the other one is run by a kernel."""

from __future__ import annotations

import os
import runpy
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

from make_published_run import CHAINS, DRAWS, make_published_run

NOTEBOOK = Path(__file__).resolve().parents[2] / "notebooks" / "published.py"


@pytest.mark.slow
def test_it_runs_without_a_warning_and_tells_what_it_found(tmp_path, monkeypatch):
    """On a made-up run folder, or on the one that BAYESTISSUE_RUN names."""
    run = os.environ.get("BAYESTISSUE_RUN") or make_published_run(tmp_path / "run")
    monkeypatch.setenv("BAYESTISSUE_RUN", str(run))
    # What other tests of this process left open is none of its figures.
    plt.close("all")
    shown = []
    monkeypatch.setattr(plt, "show", lambda: shown.extend(map(plt.close, plt.get_fignums())))
    with mpl.rc_context({"backend": "agg"}), redirect_stdout(StringIO()) as said:
        runpy.run_path(str(NOTEBOOK))
    assert f"{CHAINS} chains of {DRAWS} draws" in said.getvalue()
    assert "a fixed stiffness would give 0.530" in said.getvalue()
    assert len(shown) == NOTEBOOK.read_text(encoding="utf-8").count("plt.show()")
