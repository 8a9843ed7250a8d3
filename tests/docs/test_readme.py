"""The README's example runs and gives what the text says; its links lead somewhere; it stays short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pages import README, ROOT, run

TEXT = README.read_text(encoding="utf-8")


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.long)])
def test_the_example_gives_what_is_read_of_it(tmp_path: Path, whole: bool) -> None:
    run(README, tmp_path, whole=whole)


def test_what_is_read_aloud_is_what_was_shown() -> None:
    rows = re.findall(r"│ (K\[.*?) +│ +([\d.]+) │ +([\d.]+) │ +([\d.]+) │", TEXT)
    shown = {name.strip(): [float(number) for number in numbers] for name, *numbers in rows}
    read = TEXT.split("Read it so:")[1]
    ratio = shown["K[side=operated] / K[side=sound]"]
    assert [f"{number:.2f}" for number in ratio] == ["1.24", "1.19", "1.30"]
    assert all(f"{number:.2f}" in read for number in ratio)
    assert all(f"{number:.0f}" in read for number in shown["K[side=operated]"])
    assert f"{shown['K[side=sound]'][0]:.0f} N/m on the sound" in read


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(([^)#]+)[^)]*\)", TEXT))))
def test_a_link_leads_somewhere(link: str) -> None:
    assert (ROOT / link).exists()
