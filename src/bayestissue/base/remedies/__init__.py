"""What every warning and error means, what it does to K and C, and what to do: ``remedies.toml``.

An entry holds the words that warn of it in tables and pages, the sentences that a problem is keyed in, and
those that a fit says of its draws, model and data; how grave these are stands there too.
What to use instead of a name that is gone stands in ``retired.toml``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from string import Formatter
from types import MappingProxyType
from typing import Any, NamedTuple

from bayestissue.base.declarations import declared, filled

# What a warning or an error carries: the key of its entry. A test holds the sources to the entries.
Code = str


@dataclass(frozen=True)
class Remedy:
    """One entry: `` `text` `` is set as code, and nothing else is marked up.

    Attributes:
        code: what a message carries.
        group: the heading that it stands under.
        title: the warning or error in a few words.
        means: what was found.
        effect: what it does to K and C.
        remedy: what to do.
        example: one case with its remedy.
    """

    code: Code
    group: str
    title: str
    means: str
    effect: str
    remedy: str
    example: str

    @property
    def advice(self) -> str:
        """What it does to K and C, and what to do."""
        return f"{self.effect} {self.remedy}"

    @property
    def parts(self) -> tuple[tuple[str, str], ...]:
        """Headings and their paragraphs, in the order of reading."""
        return (
            ("What it means", self.means),
            ("What it does to K and C", self.effect),
            ("What to do", self.remedy),
            ("Example", self.example),
        )


class Flag(NamedTuple):
    """Words of tables and pages that warn, with values in braces.

    Attributes:
        code: of their entry.
        says: the words.
        expected: of a detector of spoilt recordings: what was, instead.
        found: by it, with braces for its number.
        note: whether nothing is wrong, but should be known.
    """

    code: Code
    says: str
    expected: str = ""
    found: str = ""
    note: bool = False

    @property
    def pattern(self) -> str:
        """A regular expression that finds the words, whatever the values are."""
        return ".*".join(re.escape(literal) for literal, *_ in Formatter().parse(self.says))


class Message(NamedTuple):
    """What a problem is keyed in: what was expected and what to do, with its numbers in braces."""

    code: Code
    expected: str
    remedy: str


@cache
def headlines() -> MappingProxyType[Code, str]:
    """By the codes of a fit's findings, the gravest first, its first line where none graver warns."""
    levels = declared(__name__, "remedies.toml")["severity"]
    return MappingProxyType({code: level["headline"] for level in levels for code in level["codes"]})


def sentence(key: str, **numbers: object) -> str:
    """A sentence of a fit's finding by its code and name, such as "measuring-chain.undecided"."""
    return filled(sentences()[key], **numbers)


@cache
def sentences() -> MappingProxyType[str, str]:
    """Every sentence of a fit's findings by its key; see `sentence`."""
    return MappingProxyType(_parts("finding", lambda entry: isinstance(entry, str)))


@cache
def messages() -> MappingProxyType[str, Message]:
    """Every message by its key: a code, or a code, a point and which of its messages."""
    tables = _parts("message", lambda entry: "expected" in entry)
    return MappingProxyType({key: Message(key.partition(".")[0], **entry) for key, entry in tables.items()})


@cache
def flags() -> MappingProxyType[str, Flag]:
    """All words that warn by their key: a code, or a code and a point."""
    tables = _parts("flag", lambda entry: "says" in entry)
    return MappingProxyType({key: Flag(key.partition(".")[0], **entry) for key, entry in tables.items()})


def _parts(part: str, is_whole: Callable[[Any], bool]) -> dict[str, Any]:
    """What entries have as a ``part``, whole, by the code and the names of tables down to it, with points."""

    def below(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
        for name, entry in table.items():
            if is_whole(entry):
                yield f"{above}{name}", entry
            else:
                yield from below(entry, f"{above}{name}.")

    return dict(below({code: entry[part] for code, (_, entry) in _declared().items() if part in entry}))


@cache
def _declared() -> dict[Code, tuple[str, dict[str, Any]]]:
    """By the code the title of its group, and its entry."""
    groups = declared(__name__, "remedies.toml")["group"]
    return {code: (group["title"], entry) for group in groups for code, entry in group["entry"].items()}


@cache
def retired() -> MappingProxyType[str, MappingProxyType[str, str]]:
    """Names that earlier versions had, by their kind ("command", "key", ...): what to do instead of each."""
    kinds = declared(__name__, "retired.toml")
    return MappingProxyType({kind: MappingProxyType(names) for kind, names in kinds.items()})


@cache
def entries() -> MappingProxyType[Code, Remedy]:
    """Every entry by its code, in the order of the file: groups as one meets them."""
    parts = ("flag", "message", "finding")
    return MappingProxyType(
        {
            code: Remedy(code, group, **{key: text for key, text in entry.items() if key not in parts})
            for code, (group, entry) in _declared().items()
        }
    )


def codes_in(*texts: str) -> list[Code]:
    """The codes of the warnings that texts hold, such as cells of ``flags``, in the order of the entries.

    Tables of a finished run hold the words alone.
    """
    codes = {flag.code for flag in flags().values() if any(re.search(flag.pattern, one) for one in {*texts})}
    return [code for code in entries() if code in codes]
