"""The wheel holds all that the program reads, and works where there is no checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from email import message_from_bytes
from email.message import Message
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def call(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command that finds no checkout: neither by the working folder nor by Python's path."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return subprocess.run(  # noqa: S603 - our own build and program
        [str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built by the project's own backend, which needs no network."""
    out = tmp_path_factory.mktemp("wheel")
    built = call(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", out, cwd=ROOT)
    assert built.returncode == 0, built.stderr
    (found,) = out.glob("*.whl")
    return found


def test_the_wheel_holds_every_file_that_the_program_reads(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
    expected = {f"bayestissue/{path.relative_to(ROOT / 'src/bayestissue')}": path for path in sources()}
    for folder in ("models", "data/published"):
        for path in (ROOT / folder).rglob("*"):
            if path.is_file():
                expected[f"bayestissue/_shared/{path.relative_to(ROOT)}"] = path
    assert {name for name, path in expected.items() if held.get(name) != path.read_bytes()} == set()
    kinds = {Path(name).suffix for name in expected}
    assert {".toml", ".html", ".css", ".csv", ".py"} <= kinds
    assert "bayestissue/base/remedies/remedies.toml" in held


def sources() -> list[Path]:
    return [
        path
        for path in (ROOT / "src" / "bayestissue").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_bytes(archive.read(name))


def test_the_wheel_has_the_version_of_the_citation(wheel: Path) -> None:
    version = metadata(wheel)["Version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in citation
    assert f"\n## [{version}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
