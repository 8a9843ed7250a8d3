"""Every equation of the manual can be shown: the whole manual is built by slow tests only."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from docutils.utils.math.latex2mathml import tex2mathml
from pages import ROOT

PAGES = sorted(
    page
    for page in (ROOT / "docs").rglob("*.md")
    if "_build" not in page.parts and "$" in page.read_text(encoding="utf-8")
)
CODE = re.compile(r"^(```|~~~).*?^\1|`[^`\n]*`", re.MULTILINE | re.DOTALL)
EQUATION = re.compile(r"\$\$(.+?)\$\$|(?<![\\$])\$(?!\s)([^$\n]+?)(?<!\s)\$(?![\d$])", re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_equation_becomes_mathml(page: Path) -> None:
    prose = CODE.sub("", page.read_text(encoding="utf-8"))
    equations = [block or inline for block, inline in EQUATION.findall(prose)]
    for equation in equations:
        assert tex2mathml(equation.replace(r"\dots", r"\ldots"), as_block=True), equation
