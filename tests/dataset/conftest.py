from __future__ import annotations

from pathlib import Path

import pytest

from bayestissue.recordings.dataset import write_dataset
from dataset_bench import SETTINGS, Lab, tables


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    impacts, traces = tables()
    folder = tmp_path / "bench"
    write_dataset(folder, settings=SETTINGS, impacts=impacts, traces=traces, trace_file="traces.csv")
    return Lab(folder)
