from __future__ import annotations

from pathlib import Path

import pytest

from bayestissue import runtime

# The tests are an entry point of their own: float64, and two devices for chains side by side.
runtime.configure()


@pytest.fixture(scope="session")
def heel_strikes() -> Path:
    """The recorded heel strikes, used where they lie beside the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "heelstrike"
    if not (folder / "dataset.toml").is_file():
        pytest.skip(f"the recorded heel strikes are not at {folder}")
    return folder
