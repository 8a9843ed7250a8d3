"""The changelog names what is gone."""

import re
from pathlib import Path

from bayestissue.base.remedies import retired

CHANGELOG = (Path(__file__).resolve().parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
REMOVED = "\n".join(re.findall(r"^### Removed\n(.*?)(?=^##)", CHANGELOG, re.MULTILINE | re.DOTALL))


def test_names_that_are_refused_stand_under_what_was_removed() -> None:
    for kind, names in retired().items():
        for name in names:
            parts = re.split(r"[ =]+|(?<=\w)\.(?=\w+$)", name) if kind in ("key", "value") else name.split()
            assert parts[-1] in REMOVED, f"{kind} {name}: CHANGELOG.md lacks {parts[-1]}"
