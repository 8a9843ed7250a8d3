"""What a dataset calls its units: "pad" where sentences of the program say person.

The program's sentences are written once, of persons, conditions and impacts. `Words` puts a dataset's own
nouns in their place when a page, a paper or a message is finished, with the article that goes before.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from markupsafe import escape

# What the program's sentences say, by key of [words]: of one, and of several.
NOUNS = {
    "subject": ("person", "people"),
    "trial": ("condition", "conditions"),
    "impact": ("impact", "impacts"),
}
# Of a page: what is no prose. An element's texts for those who point at it or hear it are.
_NO_PROSE = re.compile(r"(<(script|style|code|pre)\b.*?</\2>|<[^>]*>)", re.DOTALL)
_TOLD = re.compile(r'(?<= )(title|aria-label|alt|summary)="[^"]*"')
# Of a chart: what names columns or computes, instead of being shown.
_COMPUTED = frozenset(
    {
        *("field", "fields", "detail", "groupby", "as"),
        *("calculate", "filter", "test", "expr", "param", "name", "type", "$schema", "data"),
    }
)


@dataclass(frozen=True)
class Words:
    """Nouns in the place of the program's.

    Attributes:
        nouns: the table ``[words]`` of ``dataset.toml``: the noun of one by "subject", "trial" and "impact",
            that of several by "subjects", "trials" and "impacts"; with an s unless it is there.
        unchanged: the user's own texts, such as names of levels, which stay as they are.
    """

    nouns: Mapping[str, str]
    unchanged: Collection[str] = ()

    @cached_property
    def _replacements(self) -> dict[str, str]:
        stated: dict[str, str] = {}
        for key in [key for key in NOUNS if key in self.nouns]:
            one, several = NOUNS[key]
            stated |= {one: self.nouns[key], several: self.nouns.get(f"{key}s", f"{self.nouns[key]}s")}
        return stated | ({"persons": stated["people"]} if "people" in stated else {})

    @cached_property
    def _pattern(self) -> re.Pattern[str] | None:
        """The nouns with an article before them; neither as a part of a name, nor of a file's."""
        if not self._replacements:
            return None
        nouns = "|".join(self._replacements)
        ambiguous = [text for text in self.unchanged if re.search(rf"\b({nouns})\b", text, re.IGNORECASE)]
        unchanged = "|".join(re.escape(text) for text in sorted(ambiguous, key=len, reverse=True))
        return re.compile(
            rf"{f'(?P<unchanged>{unchanged})|' if unchanged else ''}"
            rf"(?<![\w`./:-])(?:(?P<article>an?)(?P<space>\s+))?(?P<noun>{nouns})(?![\w`]|[.:]\w|[/=])",
            re.IGNORECASE,
        )

    def __call__(self, text: str) -> str:
        """A text of the program with the dataset's nouns."""
        return self._pattern.sub(self._replaced, text) if self._pattern else text

    def _replaced(self, match: re.Match[str]) -> str:
        if match.groupdict().get("unchanged"):
            return match[0]
        noun = self._replacements[match["noun"].lower()]
        noun = noun if match["noun"][0].islower() else noun[:1].upper() + noun[1:]
        if not match["article"]:
            return noun
        article = match["article"][0] + ("n" if noun[0].lower() in "aeiou" else "")
        return f"{article}{match['space']}{noun}"

    def page(self, html: str) -> str:
        """A page with the dataset's nouns in its prose: neither in code, nor in what scripts read."""
        if not self._pattern:
            return html
        # Nouns, and names that stay, as they stand where text has become HTML.
        nouns = {key: str(escape(noun)) for key, noun in self.nouns.items()}
        words = Words(nouns, [str(escape(text)) for text in self.unchanged])
        parts = _NO_PROSE.split(html)
        # Of each match the split has the whole and the name of its element.
        texts = [words(text) for text in parts[::3]]
        others = [_TOLD.sub(lambda match: words(match[0]), whole) for whole in parts[1::3]]
        return "".join(piece for pair in zip(texts, [*others, ""], strict=True) for piece in pair)

    def chart(self, specification: Any) -> Any:
        """A chart's specification with the dataset's nouns in what it shows."""
        if not self._pattern:
            return specification
        if isinstance(specification, dict):
            return {
                key: inner if key in _COMPUTED else self.chart(inner) for key, inner in specification.items()
            }
        if isinstance(specification, list):
            return [self.chart(inner) for inner in specification]
        return self(specification) if isinstance(specification, str) else specification


# The program's own nouns.
PLAIN = Words({})
