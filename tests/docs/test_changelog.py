"""The changelog names what is gone."""

import re
from pathlib import Path

import pytest

from bayestissue.base.remedies import retired

CHANGELOG = (Path(__file__).resolve().parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
REMOVED = "\n".join(re.findall(r"^### Removed\n(.*?)(?=^##)", CHANGELOG, re.MULTILINE | re.DOTALL))


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in retired() for name in retired()[kind]])
def test_a_name_that_is_refused_stands_under_what_was_removed(kind: str, name: str) -> None:
    last = re.split(r"[ =]+|(?<=\w)\.(?=\w+$)", name)[-1] if kind in ("key", "value") else name.split()[-1]
    assert last in REMOVED, f"{kind} {name}: CHANGELOG.md lacks {last}"
