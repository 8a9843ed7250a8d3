"""The README's example runs and gives what the text says; its links lead somewhere; it stays short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pages import ROOT, run

README = ROOT / "README.md"
TEXT = README.read_text(encoding="utf-8")
# GitHub shows no captions: a file's name stands at the end of the sentence before its block.
FILE = re.compile(r"`(drops/\S+)`:\n\n```(?:toml|csv)\n(.*?)```", re.DOTALL)


def test_the_example_gives_what_is_read_of_it(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text(
        FILE.sub(lambda found: f"\n\n```{{code-block}} text\n:caption: {found[1]}\n\n{found[2]}```", TEXT)
    )
    assert page.read_text().count(":caption:") == 2
    run(page, tmp_path)


def test_what_is_read_aloud_is_what_was_shown() -> None:
    shown = re.search(r"^impact,K_N_per_m,K_low.*?\n(.*?)```", TEXT, re.DOTALL | re.MULTILINE)
    assert shown is not None
    K = {name: [int(n) for n in numbers] for name, *numbers in (r.split(",") for r in shown[1].splitlines())}
    first = K["operated_500g"]
    assert all(str(number) in TEXT.split("Read it so:")[1] for number in first)
    operated, sound = ([K[f"{side}_{mass}g"] for mass in (500, 1000)] for side in ("operated", "sound"))
    assert operated[0][2] > operated[1][1]
    assert sound[0][2] < sound[1][1]
    assert min(low for _, low, _ in operated) > max(high for _, _, high in sound)


def test_it_is_short() -> None:
    assert len(TEXT.splitlines()) <= 130


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(([^)#]+)[^)]*\)", TEXT))))
def test_a_link_leads_somewhere(link: str) -> None:
    assert (ROOT / link).exists()
