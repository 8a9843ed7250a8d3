"""What pages of fits, and the sentences they are made of, say: tables of ``test_page_words.toml``."""

from __future__ import annotations

import re
import tomllib
from functools import cache, reduce
from pathlib import Path

import changed_fits
import pytest

from bayestissue import Fit
from bayestissue.reports.pages.fit import answers, checks, method_agreement
from bayestissue.reports.pages.fit import fit_run as groups
from bayestissue.reports.pages.fit.fit_page import page_of
from bayestissue.reports.pages.page import worded, written
from bayestissue.reports.paper import text
from make_fit_run import changed, fit_run
from page_reader import first_screen, plain, require_whole, section

# The modules of the table's expressions, by their names.
MODULES = {
    module.__name__.rpartition(".")[2]: module for module in (answers, checks, method_agreement, text)
} | {"groups": groups, "worded": worded, "written": written}
PAGES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def prose(page: str) -> str:
    return plain(re.sub(r"<(script|style|code|pre)\b.*?</\1>", "", html_of(page), flags=re.DOTALL))


@cache
def run_of(page: str) -> Fit:
    """A fit by its options, as functions of changed_fits.py and entries of its files change it."""
    options = {
        name: None if option == "none" else option for name, option in PAGES[page].get("run", {}).items()
    }
    run = fit_run(**options)
    run = reduce(lambda run, name: getattr(changed_fits, name)(run), PAGES[page].get("change", []), run)
    return changed(run, record=PAGES[page].get("record"), diagnostics=PAGES[page].get("diagnostics"))


@cache
def html_of(page: str) -> str:
    return page_of(run_of(page))


def text_of(page: str, part: str) -> str:
    """What is said in a part of a page: all, its first screen, a section by its name, or by an expression."""
    if "(" in part:
        return plain(str(eval(part, globals() | MODULES | {"run": run_of(page)})))  # noqa: S307 - of our own table
    html = html_of(page)
    if part in ("K", "C"):
        captions = rf'<figure class="of-{part}"><figcaption>(.*?)</figcaption>'
        return " | ".join(plain(text) for text in re.findall(captions, html, re.DOTALL))
    parts = {"all": plain(html), "first": plain(first_screen(html)), "html": re.sub(r"\s+", " ", html)}
    return parts[part] if part in parts else plain(section(html, part))


ROWS = [
    pytest.param(page, part, words, id=f"{page}-{part}".replace(" ", "-"))
    for page, content in PAGES.items()
    for part, words in content["says"].items()
]


@pytest.mark.parametrize(("page", "part", "words"), ROWS)
def test_it_says(page: str, part: str, words: list[str]) -> None:
    """Each of the words, and none of those after "not "."""
    text = text_of(page, part)
    wrong = [one for one in words if (one.removeprefix("not ") in text) == one.startswith("not ")]
    assert wrong == [], text[:4000]


@pytest.mark.parametrize("page", [page for page, content in PAGES.items() if content.get("drawn", True)])
def test_it_is_whole_its_sentences_of_25_words_and_its_captions_of_40(page: str) -> None:
    html = html_of(page)
    require_whole(html)
    sentences = [sentence for q in "KC" for sentence in text_of(page, q).split(" | ")]
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", html, re.DOTALL)
    for most, texts in ((PAGES[page].get("words", 25), sentences), (40, map(plain, captions))):
        assert [text for text in texts if len(text.split()) > most] == []
