"""What every warning and error means, what it does to K and C, and what to do: ``remedies.toml``.

The sentences that a problem is keyed in stand in ``messages.toml``, those of one code together; what to use
instead of a name that is gone stands in ``retired.toml``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import NamedTuple

from bayestissue.declarations import declared

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
        says: words of tables and pages by which it is recognised; see `codes_in`.
    """

    code: Code
    group: str
    title: str
    means: str
    effect: str
    remedy: str
    example: str
    says: tuple[str, ...] = ()

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


class Message(NamedTuple):
    """What a problem is keyed in: what was expected and what to do, with its numbers in braces."""

    code: Code
    expected: str
    remedy: str


@cache
def messages() -> MappingProxyType[str, Message]:
    """Every message by its key: a code, or a code, a point and which of its messages."""
    by_code = declared(__name__, "messages.toml")
    keyed: dict[str, Message] = {}
    for code, content in by_code.items():
        several = {code: content} if "expected" in content else {f"{code}.{k}": m for k, m in content.items()}
        keyed |= {key: Message(code, **sentences) for key, sentences in several.items()}
    return MappingProxyType(keyed)


@cache
def retired() -> MappingProxyType[str, MappingProxyType[str, str]]:
    """Names that earlier versions had, by their kind ("command", "key", ...): what to do instead of each."""
    kinds = declared(__name__, "retired.toml")
    return MappingProxyType({kind: MappingProxyType(names) for kind, names in kinds.items()})


@cache
def entries() -> MappingProxyType[Code, Remedy]:
    """Every entry by its code, in the order of the file: groups as one meets them."""
    content = declared(__name__, "remedies.toml")
    remedies: dict[Code, Remedy] = {}
    for group in content["group"]:
        for code, entry in group["entry"].items():
            says = tuple(entry.pop("says", ()))
            remedies[code] = Remedy(code, group["title"], says=says, **entry)
    return MappingProxyType(remedies)


def codes_in(text: str) -> list[Code]:
    """The codes of the warnings that a text holds, such as a cell of ``flags``, in the order of the file.

    Tables of a finished run hold the words alone. They are recognised by what their entries say.
    """
    return [code for code, entry in entries().items() if any(words in text for words in entry.says)]
