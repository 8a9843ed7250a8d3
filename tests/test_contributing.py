"""The recipes of CONTRIBUTING.md work as they are written, in a copy of the source."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import bayestissue

ROOT = Path(__file__).resolve().parents[1]
GUIDE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
RECIPE = re.compile(r"^ *<!-- recipe: (\S+) -->\n *```(python|diff)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
# Prints what each of the recipes has added; a copy of the source is first on the path.
TRIED = """
import numpy as np

from bayestissue.mechanics.elements.element import Collision
from bayestissue.mechanics.elements.library import element
found = element("depth_damped")
met = Collision.of(found, {"K": 3000.0, "C": 20.0, "damping_depth_m": 0.01}, 2.0, 1.0)
y = np.array([0.01, 1.0])
print("element", found.name, round(met.deceleration(y).item(), 6))

from bayestissue.recordings.dataset.formats import FORMATS
read = FORMATS[".f64"].read(np.array([1000.0, 0.0, 5.0, 1.0]).tobytes(), "a.f64").channels["signal"]
print("format", read.values.tolist(), read.clock.tolist())

import bayestissue as bt
from bayestissue.commands.program import explain
from bayestissue.recordings.signal.quality import inspect, raised
time = np.arange(400) / 1e4
pulse = 0.5 * np.exp(-(((time - 0.02) / 0.004) ** 2)) + np.random.default_rng(0).normal(0, 1e-3, time.size)
impacts = {"impact": ["i"], "subject": ["s"], "mass_kg": [1.0], "velocity_m_s": [0.003]}
data = bt.dataset(impacts, [(time, pulse)], quantity="deceleration", unit="m/s^2")
codes = {str(flag): flag.code for flag in raised(inspect(data), 1)[0]}
print("check", inspect(data)["too-quiet"], codes["a peak below 1 m/s²"])
explain(["too-quiet"], as_json=False)

from types import SimpleNamespace
from bayestissue.inference.quantities.impact_quantities import QUANTITIES
from bayestissue.inference.results.labels import variables
momentum = QUANTITIES["momentum"](SimpleNamespace(collision=SimpleNamespace(mass=2.0, velocity=1.5)))
print("quantity", momentum, variables()["momentum"].attrs["unit"])

import typer
from bayestissue.cli import app
options = typer.main.get_command(app).commands["plan"].params
(option,) = (one for one in options if one.name == "probability")
print("setting", option.opts[0], option.help)
try:
    bt.plan(people=4, masses_kg=[0.5, 1.0], ask="mass_exponent_K < 0.5", probability=0.3)
except bt.InputError as refused:
    print("setting", refused)
"""


def followed(source: Path, guide: str = GUIDE) -> list[str]:
    """Do what the recipes say, below ``source``; the files that they name."""
    named = []
    for file, kind, indented in RECIPE.findall(guide):
        lines = textwrap.dedent(indented)
        path = source / Path(file).relative_to("src")
        named.append(path.name)
        if kind == "python":
            path.write_text(lines, encoding="utf-8")
            continue
        text = path.read_text(encoding="utf-8")
        for old, new in changes(lines):
            assert text.count(old) == 1, f"{file} has {text.count(old)} times:\n{old}"
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
    return named


def changes(lines: str) -> list[tuple[str, str]]:
    """Lines that go, and those that come in their place."""
    found: list[tuple[list[str], list[str]]] = []
    for line in lines.splitlines():
        if line.startswith("-"):
            if not found or found[-1][1]:
                found.append(([], []))
            found[-1][0].append(line[1:])
        else:
            found[-1][1].append(line[1:])
    return [("\n".join(old), "\n".join(new)) for old, new in found]


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A folder with a copy of the source, in src."""
    ignored = shutil.ignore_patterns("__pycache__")
    package = Path(bayestissue.__file__).parent
    shutil.copytree(package, tmp_path / "src" / "bayestissue", ignore=ignored)
    return tmp_path


def test_recipes_work_as_they_are_written(copied: Path) -> None:
    for folder in ("models", "data/published"):
        shutil.copytree(ROOT / folder, copied / folder)
    named = followed(copied / "src")
    assert {"depth_damped.py", "plainfloat.py", "remedies.toml", "inspection.py"} <= set(named)
    done = subprocess.run(  # noqa: S603 - our own program
        [sys.executable, "-W", "error", "-c", TRIED],
        cwd=copied,
        env={**os.environ, "PYTHONPATH": str(copied / "src"), "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    # 3000 * 0.01 + 20 * 0.01 * 1 / 0.01 = 50 N on 2 kg.
    assert said[0] == "element depth_damped 25.0"
    assert said[1] == "format [0.0, 5.0, 1.0] [0.0, 0.001, 0.002]"
    assert said[2] == "check ['a peak of 0.5 m/s²'] too-quiet"
    assert said[3] == "too-quiet: The recording is too quiet"
    # 2 kg at 1.5 m/s.
    assert "quantity 3.0 N s" in said
    assert any(line.startswith("setting --probability What a claim has to be more probable") for line in said)
    assert re.search(r"setting .*goal\.probability: found 0\.3; expected greater than 0\.5", done.stdout)


def test_targets_and_files_that_the_guide_names_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"\bmake ([a-z-]+)", GUIDE)):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    made = {file for file, kind, _ in RECIPE.findall(GUIDE) if kind == "python"}
    for path in set(re.findall(r"(?:src|tests|benchmarks|tools|models)/[\w./-]+\w", GUIDE)) - made:
        assert (ROOT / path).exists() or path == "models/depth_damped.toml", path
