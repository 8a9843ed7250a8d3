"""The manual builds strictly: no broken link, no unknown name, no equation that can't be shown."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def build(out: Path, source: Path = ROOT / "docs") -> subprocess.CompletedProcess[str]:
    strict = ["--fail-on-warning", "--nitpicky", "--keep-going", "--quiet"]
    command = [sys.executable, "-m", "sphinx", *strict, "--doctree-dir", str(out.with_name("doctrees"))]
    return subprocess.run([*command, str(source), str(out)], capture_output=True, text=True, check=False)  # noqa: S603


@pytest.fixture(scope="module")
def manual(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("manual") / "html"
    done = build(out)
    assert done.returncode == 0, done.stderr
    return out


def test_the_manual_builds_without_a_warning(manual):
    assert (manual / "index.html").exists()


def test_reading_it_fetches_nothing(manual):
    fetched = re.compile(r'<(?:script|img|iframe)[^>]*\ssrc="(?:https?:)?//|<link[^>]*\shref="(?:https?:)?//')
    for page in manual.rglob("*.html"):
        assert not fetched.search(page.read_text(encoding="utf-8")), page.name
    for style in manual.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", style.read_text(encoding="utf-8")), style.name


def test_a_broken_link_and_an_equation_that_cannot_be_shown_fail(tmp_path):
    (tmp_path / "docs").mkdir()
    for name in ("_extensions", "_static", "conf.py"):
        (tmp_path / "docs" / name).symlink_to(ROOT / "docs" / name)
    (tmp_path / "docs" / "index.md").write_text("# Page\n\n[gone](gone.md)\n\n$\\frac{1}{2}$ $\\nonsense$\n")
    done = build(tmp_path / "html", tmp_path / "docs")
    assert done.returncode == 1
    assert "gone" in done.stderr
    assert "nonsense" in done.stderr
    assert "<mfrac>" in (tmp_path / "html" / "index.html").read_text(encoding="utf-8")
