"""The benchmark of a fit's stages names functions that there are."""

from __future__ import annotations

import runpy
from importlib import import_module
from pathlib import Path

STAGES = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "stages.py"))["STAGES"]


def test_every_stage_is_a_function_of_its_module():
    missing = [
        f"{module}.{name}"
        for module, names in STAGES.items()
        for name in names
        if not callable(getattr(import_module(f"bayestissue.{module}"), name, None))
    ]
    assert not missing
