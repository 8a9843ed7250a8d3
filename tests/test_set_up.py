"""What `make setup` installs, and what it says meanwhile."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def pins(name: str) -> dict[str, str]:
    text = (ROOT / name).read_text(encoding="utf-8")
    return dict(re.findall(r"^([A-Za-z0-9._-]+)==(\S+)", text, flags=re.MULTILINE))


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[<>=~!\[ ]", each)[0].lower() for each in requirements}


@pytest.fixture(scope="module")
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_both_locks_have_the_same_pins() -> None:
    run, every = pins("requirements.lock"), pins("requirements-dev.lock")
    assert run.items() <= every.items()


def test_a_run_installs_what_it_needs_and_no_tool_of_the_tests(project: dict) -> None:
    run, every = set(pins("requirements.lock")), set(pins("requirements-dev.lock"))
    groups = project["dependency-groups"]
    dev = names([each for each in groups["dev"] if isinstance(each, str)])
    assert names(project["project"]["dependencies"]) | names(groups["build"]) <= run
    assert not dev & run
    assert dev <= every
