from __future__ import annotations

from pathlib import Path

import pytest

from make_published_run import make_published_run


@pytest.fixture
def drawn() -> None:
    """The figures of pages that a test makes by itself are drawn."""


@pytest.fixture(autouse=True)
def _undrawn(request: pytest.FixtureRequest) -> None:
    """Tests of a page's words draw none; the pages that a module's tests share are drawn, once."""
    if "drawn" not in request.fixturenames:
        request.getfixturevalue("undrawn")


@pytest.fixture(scope="session")
def published_run_folder(tmp_path_factory) -> Path:
    return make_published_run(tmp_path_factory.mktemp("published") / "run")
