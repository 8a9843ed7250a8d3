from __future__ import annotations

from pathlib import Path

import pytest

from make_published_run import make_published_run


@pytest.fixture(scope="session")
def published_run_folder(tmp_path_factory) -> Path:
    return make_published_run(tmp_path_factory.mktemp("published") / "run")
