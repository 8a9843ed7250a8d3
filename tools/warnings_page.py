"""Write docs/how-to/warnings.md from the entries of `bayestissue explain`: python tools/warnings_page.py."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from bayestissue.base.remedies import Remedy, entries

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "warnings.md"
_HEAD = """\
<!-- Written by tools/warnings_page.py from src/bayestissue/base/remedies/remedies.toml: change that file. -->
# What to do about a warning or an error

A message ends with a code in brackets, such as `[clipped]`, or with a line such as
`More: bayestissue explain clipped`. That command prints the entry of this page, without a network:

```text
bayestissue explain clipped
```

`bayestissue explain` alone lists all codes. Pages of results link each warning to its entry at their foot.
"""


def page() -> str:
    """The page as Markdown; each entry has its code as anchor."""
    return "\n".join([_HEAD, *_lines()])


def _lines() -> Iterator[str]:
    for title, group in groupby(entries().values(), key=lambda entry: entry.group):
        yield f"## {title}\n"
        for entry in group:
            yield from _entry(entry)


def _entry(entry: Remedy) -> Iterator[str]:
    yield f"(explain-{entry.code})="
    yield f"### {entry.title}\n"
    yield f"`{entry.code}`. {entry.means}\n"
    for heading, text in entry.parts[1:]:
        yield f"*{heading}.* {text}\n"


if __name__ == "__main__":
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")
