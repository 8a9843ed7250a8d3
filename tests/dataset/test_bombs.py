"""Small files that would unpack to more than any memory holds: refused, and without taking that memory."""

from __future__ import annotations

import gzip
import os
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.source_files import LIMIT, sheet_text
from dataset_bench import Lab

LIMIT_MB = 5
UNPACKED = 40_000_000


def _packed(path: Path, line: bytes, first: bytes = b"") -> None:
    with gzip.open(path, "wb", 9) as file:
        file.write(first)
        for _ in range(40):
            file.write(line * (UNPACKED // 40 // len(line)))


def _parquet(path: Path) -> None:
    rows = UNPACKED // 20
    zeros, name = pa.array(np.zeros(rows)), pa.array(["a"] * rows).dictionary_encode()
    pq.write_table(pa.table({"impact": name, "time_s": zeros, "value": zeros}), path, compression="zstd")


def _mat5(path: Path) -> None:
    savemat(path, {"value": np.zeros(UNPACKED // 8)}, do_compression=True)


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("value", data=np.zeros(UNPACKED // 8), compression="gzip")


BOMBS: dict[str, Callable[[Path], None]] = {
    "traces.csv.gz": lambda path: _packed(path, b"a,0,0\n", b"impact,time_s,value\n"),
    "traces.parquet": _parquet,
    "a.csv.gz": lambda path: _packed(path, b"0,0\n", b"time_s,value\n"),
    "a.mat": _mat5,
    "a.h5": _hdf5,
}


@pytest.mark.parametrize("name", BOMBS)
def test_refused_before_it_takes_the_memory(name: str, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    lab.remove("traces.csv")
    BOMBS[name](lab.path(name))
    if not name.startswith("traces"):
        names, first, *_ = lab.text("impacts.csv").splitlines()
        lab.path("impacts.csv").write_text(f"{names},trace\n{first},{name}\n")
    monkeypatch.setenv(LIMIT, str(LIMIT_MB))
    arrow = pa.total_allocated_bytes()
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as refused:
            read_dataset(lab.folder)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # The variables of a MATLAB file are unpacked before they are counted.
    assert peak < (150e6 if name == "a.mat" else 3 * LIMIT_MB * 1e6)
    assert pa.total_allocated_bytes() - arrow < LIMIT_MB * 1e6
    told = str(refused.value)
    assert (f"at most {LIMIT_MB} MB" in told and LIMIT in told) or "first line of column names" in told


def test_rows_that_would_take_more_than_their_text(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    lab.path("traces.csv").write_text("impact,time_s,value\n" + ",,\n" * 300_000)
    monkeypatch.setenv(LIMIT, "5")
    with pytest.raises(InputError, match="at most 5 MB"):
        read_dataset(lab.folder)


def test_the_limit_is_a_setting(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIMIT, "0.01")
    with pytest.raises(
        InputError, match=rf"traces.csv: found \"0.0.* MB\"; expected at most 0.01 MB.*{LIMIT}"
    ):
        read_dataset(lab.folder)
    for wrong in ("much", "-1", "0", "nan"):
        monkeypatch.setenv(LIMIT, wrong)
        with pytest.raises(InputError, match=f'{LIMIT}: found "{wrong}"; expected a number'):
            read_dataset(lab.folder)
    monkeypatch.setenv(LIMIT, " ")
    assert len(read_dataset(lab.folder).traces) == 4


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("name", ["dataset.toml", "impacts.csv", "traces.csv"])
def test_a_pipe_is_not_waited_for(name: str, lab: Lab) -> None:
    lab.path(name).unlink()
    os.mkfifo(lab.path(name))
    with pytest.raises(InputError, match=r"regular file|file of settings"):
        read_dataset(lab.folder)


def test_an_archive_of_another_kind_is_no_workbook(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w") as file:
        file.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
    with pytest.raises(InputError, match=r"no workbook of the kind \.xlsx"):
        sheet_text((tmp_path / "a.xlsx").read_bytes(), "a.xlsx")
