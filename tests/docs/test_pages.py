"""Every code block of tutorials and how-to guides runs, and prints what the page shows."""

from __future__ import annotations

import hashlib
import re
import runpy
from pathlib import Path

import h5py
import jupytext
import pandas as pd
import preparations
import pytest
from pages import (
    DOCS,
    KEPT,
    LONG,
    NOTEBOOKS,
    OF,
    README,
    ROOT,
    Block,
    blocks,
    commands,
    compare,
    parse,
    run,
)
from PIL import Image

PAGES = sorted(
    page
    for folder in ("tutorial", "how-to")
    for page in (DOCS / folder).glob("*.md")
    if any(block.language for block in blocks(page.read_text(encoding="utf-8")))
)
WITH_LONG_BLOCKS = [
    page for page in PAGES if any(set(LONG) & set(block.notes) for block in blocks(page.read_text("utf-8")))
]


def name_of(page: Path) -> str:
    return f"{page.parent.name}/{page.stem}"


@pytest.mark.slow
def test_names_in_blocks_of_r_and_matlab_are_in_the_files(tmp_path: Path) -> None:
    """Neither program is here: each variable, column and file that they name is looked up."""
    fitted = preparations.tutorial(tmp_path) / "fitted"
    page = (DOCS / "how-to" / "read-in-r-and-matlab.md").read_text(encoding="utf-8")
    code = "".join(block.text for block in blocks(page) if block.language in ("r", "matlab"))
    with h5py.File(fitted / "posterior.nc") as file:
        named = set(re.findall(r'"/?(posterior/\w+)"', code))
        assert {path for path in named if path not in file} == set()
        # As the page says of the order: chain, draw, and then the level, from Python.
        assert file["posterior/K_subject"].shape[-1] == len(file["posterior/subject"])
    for first, name in (("label", "summary"), ("level", "contrasts")):
        lists = re.findall(rf'(?:\[|c\()"({first}[^\])]*)"[\])]', code)
        columns = {column for each in lists for column in each.split('", "')}
        assert columns
        assert columns <= set(pd.read_csv(fitted / f"{name}.csv", nrows=1))
    files = set(re.findall(r'"fitted/([\w.]+)"', code))
    assert {name for name in files if not (fitted / name).is_file()} == set()


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_does_what_it_says(page: Path, tmp_path: Path) -> None:
    if page == preparations.TUTORIAL:
        preparations.tutorial(tmp_path)
    else:
        run(page, tmp_path, preparations)


@pytest.mark.long
@pytest.mark.parametrize("page", WITH_LONG_BLOCKS, ids=name_of)
def test_a_page_with_its_long_fits_does_what_it_says(page: Path, tmp_path: Path) -> None:
    run(page, tmp_path, preparations, whole=True)


def test_an_output_that_is_not_the_page_s_is_found() -> None:
    shown = "$ bayestissue check a\nfine\n│ K │ 2936 │\n...\nwrote a\n"
    command = commands(shown)[0]
    block = Block("console", shown, 0)
    page = Path("page.md")
    compare(page, block, command, "fine\n┃ K   ┃  2951 ┃\nsome\nlines\nwrote a\n")
    for other in ("fine\nK 4000\nwrote a\n", "fine\nC 2936\nwrote a\n", "fine\nK 2936\n"):
        with pytest.raises(AssertionError):
            compare(page, block, command, other)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_rendered_notebook_is_the_one_that_is_kept_as_text(name: str) -> None:
    rendered, kept = jupytext.read(DOCS / "tutorial" / name), jupytext.read(NOTEBOOKS[name])
    assert [(c.cell_type, c.source) for c in rendered.cells] == [(c.cell_type, c.source) for c in kept.cells]
    assert any(cell.get("outputs") for cell in rendered.cells)


PICTURES = {
    page.parent / block.text: block.notes.get("picture of", "").partition(", ")[0]
    for page in (README, *DOCS.glob("*/*.md"))
    for block in blocks(page.read_text(encoding="utf-8"))
    if block.language == "picture" and block.text.endswith(".png")
}


def test_every_picture_names_the_page_that_it_is_of() -> None:
    assert [picture for picture, shown in PICTURES.items() if not shown] == []
    kept = [*(DOCS / "pictures").iterdir(), *(DOCS / "tutorial" / "pictures").iterdir()]
    assert sorted(kept) == sorted(picture.resolve() for picture in PICTURES)


@pytest.mark.parametrize(
    ("picture", "shown"),
    [pytest.param(*pair, id=pair[1]) for pair in PICTURES.items() if pair[1].startswith(KEPT)],
)
def test_a_picture_is_of_the_report_that_is_kept(picture: Path, shown: str) -> None:
    """Both are made by one command, `make docs-outputs`, of which no half is kept."""
    of = hashlib.sha256((ROOT / shown).read_bytes()).hexdigest()
    assert Image.open(picture).text[OF] == of, "run make docs-outputs"


def test_commands_of_the_explanations_have_options_that_the_program_knows() -> None:
    for page in (DOCS / "explanation").glob("*.md"):
        for block in blocks(page.read_text(encoding="utf-8")):
            parse(block)


def test_the_recordings_of_the_tutorial_are_those_that_their_script_makes(tmp_path: Path) -> None:
    folder = ROOT / "data" / "tutorial"
    runpy.run_path(str(folder / "make_recordings.py"))["main"](tmp_path)
    places = (tmp_path, folder / "recorded")
    made, kept = ({path.name: path.read_text() for path in place.iterdir()} for place in places)
    assert made.keys() == kept.keys()
    for name, text in made.items():
        # A last digit may differ where another library rounds.
        pairs = zip(text.splitlines(), kept[name].splitlines(), strict=True)
        assert sum(a != b for a, b in pairs) <= 2, name
