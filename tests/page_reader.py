"""Reads a page as a browser would meet it."""

from __future__ import annotations

import base64
import gzip
import json
import re
from html import unescape
from html.parser import HTMLParser

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Reader(HTMLParser):
    """Collects what a page links to and holds, and checks that its elements nest."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.unnamed = 0

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given["href"]] if tag == "a" else []
        self.sources += [given["src"]] if "src" in given else []
        if tag == "svg" and not given.get("aria-label"):
            self.unnamed += 1
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        given = dict(attrs)
        self.ids += [given["id"]] if "id" in given else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def plain(html: str) -> str:
    """The text of a part of a page, that of cells and blocks apart."""
    text = re.sub(r"</?(?:a|b|code|em|i|s|span|strong|sub|sup)\b[^>]*>", "", html)
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", text)).split())


def first_screen(html: str) -> str:
    return html[html.index('class="first"') : html.index("<nav")]


def section(html: str, name: str) -> str:
    return html[html.index(f'<section id="{name}"') :].partition("</section>")[0]


def require_whole(html: str) -> None:
    """A page whose elements nest, that asks nothing of the network, whose links stay in it."""
    page = Reader()
    page.feed(html)
    assert page.open == []
    assert page.unnamed == 0
    assert len(page.ids) == len(set(page.ids))
    assert set(page.links) <= {f"#{name}" for name in page.ids}
    assert all(source.startswith("data:") for source in page.sources)
    assert not re.search(r'(?:src|href)="(?:https?:)?//|@import', html)


def figures(html: str) -> list[str]:
    """The specifications of a page's figures."""
    content = json.loads(unpacked(re.findall(r'id="figures-data">([^<]*)</script>', html)[0]))
    return [json.dumps(one, ensure_ascii=False, separators=(",", ":")) for one in content.values()]


def unpacked(text: str) -> bytes:
    """What a page carries, as bytes."""
    return gzip.decompress(base64.b85decode(text.translate(str.maketrans(",:.", "<>&"))))
