"""Damaged files: refused, or read for what they now say; never a traceback, never a number from nowhere."""

from __future__ import annotations

import contextlib
import csv
import io
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_recorders import FORMATS, files_instead

from bayestissue import cli
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import Dataset, read_dataset, write_dataset
from dataset_bench import NAMES, SETTINGS, Lab, tables

pytestmark = pytest.mark.slow

SLIPS = st.one_of(
    st.tuples(st.just("flip"), st.floats(0, 1), st.integers(1, 255)),
    st.tuples(st.just("delete"), st.floats(0, 1), st.integers(1, 40)),
    st.tuples(st.just("insert"), st.floats(0, 1), st.binary(min_size=1, max_size=8)),
    st.tuples(st.just("repeat"), st.floats(0, 1), st.integers(1, 60)),
    st.tuples(st.just("truncate"), st.floats(0, 1), st.just(0)),
)
CELLS = st.one_of(
    st.sampled_from(
        ["", " ", "nan", "-inf", "1e999", "0x1F", "1_000", "1,5", "１", "-", "+", "1e", "NULL", '"', "\x00"]
    ),
    st.floats().map(repr),
    st.text(max_size=6),
)


def damaged(data: bytes, slips: list[tuple[str, float, int | bytes]]) -> bytes:
    for kind, where, what in slips:
        at = int(where * max(len(data) - 1, 0))
        if kind == "flip" and data:
            data = data[:at] + bytes([data[at] ^ int(what)]) + data[at + 1 :]
        elif kind == "delete":
            data = data[:at] + data[at + int(what) :]
        elif kind == "insert":
            data = data[:at] + bytes(what) + data[at:]
        elif kind == "repeat":
            data = data[:at] + data[at : at + int(what)] + data[at:]
        elif kind == "truncate":
            data = data[:at]
    return data


def status(folder: Path) -> int:
    """What the command line answers; an exception that escapes it fails the test."""
    before = sys.argv
    sys.argv = ["bayestissue", "check", str(folder)]
    silent = io.StringIO()
    try:
        with contextlib.redirect_stdout(silent), contextlib.redirect_stderr(silent):
            cli.main()
    except SystemExit as stop:
        return int(stop.code or 0)
    finally:
        sys.argv = before
    return 0


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One valid dataset for every way of keeping the samples."""
    folders = {}
    impacts, traces = tables()
    for name in ("traces.csv", "traces.csv.gz", "traces.parquet"):
        folders[name] = tmp_path_factory.mktemp("long")
        write_dataset(folders[name], settings=SETTINGS, impacts=impacts, traces=traces, trace_file=name)
    for name, (suffix, write) in FORMATS.items():
        folders[name] = tmp_path_factory.mktemp("files")
        write_dataset(
            folders[name], settings=SETTINGS, impacts=impacts, traces=traces, trace_file="traces.csv"
        )
        files_instead(Lab(folders[name]), suffix, write)
    return folders


def check_damage(
    folder: Path,
    file: str,
    damage: Callable[[bytes], bytes],
    judge: Callable[[Path, Dataset], None],
    *,
    whole_command: bool = False,
) -> None:
    """By the reader, or by the command that looks at what was read, too; what else escapes fails the test."""
    path = folder / file
    whole = path.read_bytes()
    try:
        path.write_bytes(damage(whole))
        try:
            dataset = read_dataset(folder)
        except InputError:
            dataset = None
        if whole_command:
            assert status(folder) == (2 if dataset is None else 0)
        if dataset is not None:
            judge(folder, dataset)
    finally:
        path.write_bytes(whole)


def text_of(path: Path) -> str:
    """As the manual says: UTF-8, and what is none the code page of western Windows."""
    data = path.read_bytes()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")


def as_python_reads_it(folder: Path, dataset: Dataset) -> None:
    """An independent reading of the CSV files: Python's own csv module and float."""
    text = text_of(folder / "traces.csv")
    header, *rows = csv.reader(io.StringIO(text, newline=""))
    place = {name.strip(): index for index, name in enumerate(header)}
    samples: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if any(row):
            impact = row[place["impact"]].strip()
            samples.setdefault(impact, []).append((float(row[place["time_s"]]), float(row[place["value"]])))
    text = text_of(folder / "impacts.csv")
    header, *rows = csv.reader(io.StringIO(text, newline=""))
    place = {name.strip(): index for index, name in enumerate(header)}
    rows = [row for row in rows if any(cell.strip() for cell in row)]
    assert [row[place["impact"]].strip() for row in rows] == list(dataset.impacts["impact"])
    for name in ("mass_kg", "velocity_m_s"):
        assert [float(row[place[name]]) for row in rows] == list(dataset.impacts[name])
    for impact, trace in zip(dataset.impacts["impact"], dataset.traces, strict=True):
        np.testing.assert_array_equal(
            np.array(samples[impact]), np.stack([trace.time_s, trace.value], axis=1)
        )


def unchanged(_: Path, dataset: Dataset) -> None:
    _, traces = tables()
    for impact, trace in zip(NAMES, dataset.traces, strict=True):
        np.testing.assert_array_equal(trace.value, traces.loc[traces["impact"] == impact, "value"])


def finite(_: Path, dataset: Dataset) -> None:
    assert all(np.isfinite(trace.value).all() and np.isfinite(trace.time_s).all() for trace in dataset.traces)
    assert all(len(trace.value) == len(trace.time_s) >= 8 for trace in dataset.traces)


# What a damaged file of this kind may still say: nothing else (a checksum tells), or other numbers.
KINDS: dict[str, tuple[str, str, Callable[[Path, Dataset], None]]] = {
    "settings": ("traces.csv", "dataset.toml", finite),
    "impacts": ("traces.csv", "impacts.csv", as_python_reads_it),
    "long csv": ("traces.csv", "traces.csv", as_python_reads_it),
    "long packed csv": ("traces.csv.gz", "traces.csv.gz", unchanged),
    "long parquet": ("traces.parquet", "traces.parquet", unchanged),
    **{name: (name, f"a{FORMATS[name][0]}", finite) for name in FORMATS},
}
RELAXED = {
    "deadline": None,
    "derandomize": True,
    "suppress_health_check": [HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10, **RELAXED)
@given(slips=st.lists(SLIPS, min_size=1, max_size=3))
def test_damaged_bytes(kind: str, sound: dict[str, Path], slips: list) -> None:
    layout, file, judge = KINDS[kind]
    check_damage(sound[layout], file, lambda data: damaged(data, slips), judge)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=70, **(RELAXED | {"derandomize": False}))
@given(slips=st.lists(SLIPS, min_size=1, max_size=4))
def test_damaged_bytes_at_length(kind: str, sound: dict[str, Path], slips: list) -> None:
    layout, file, judge = KINDS[kind]
    check_damage(sound[layout], file, lambda data: damaged(data, slips), judge, whole_command=True)


@pytest.mark.parametrize("kind", ["impacts", "long csv"])
@settings(max_examples=6, **RELAXED)
@given(slips=st.lists(SLIPS, min_size=1, max_size=2))
def test_damaged_bytes_before_the_command(kind: str, sound: dict[str, Path], slips: list) -> None:
    layout, file, judge = KINDS[kind]
    check_damage(sound[layout], file, lambda data: damaged(data, slips), judge, whole_command=True)


@pytest.mark.parametrize("file", ["impacts.csv", "traces.csv"])
@settings(max_examples=60, **RELAXED)
@given(row=st.floats(0, 1), column=st.floats(0, 1), cell=CELLS)
def test_damaged_cells(file: str, sound: dict[str, Path], row: float, column: float, cell: str) -> None:
    def damage(data: bytes) -> bytes:
        lines = data.decode().split("\n")
        at = int(row * (len(lines) - 2))
        cells = lines[at].split(",")
        cells[int(column * (len(cells) - 1))] = cell
        lines[at] = ",".join(cells)
        return "\n".join(lines).encode(errors="surrogatepass")

    check_damage(sound["traces.csv"], file, damage, as_python_reads_it)


@pytest.mark.parametrize("kind", ["impacts", "long csv"])
def test_a_stray_byte_is_of_the_windows_code_page(kind: str, sound: dict[str, Path]) -> None:
    layout, file, judge = KINDS[kind]
    check_damage(sound[layout], file, lambda data: damaged(data, [("insert", 1.0, b"\x80")]), judge)


def test_a_footer_of_parquet_with_a_damaged_byte(sound: dict[str, Path]) -> None:
    # Of six of these bytes pyarrow would end the process, where the metadata are asked before a row is read.
    layout, file, judge = KINDS["long parquet"]
    size = int.from_bytes((sound[layout] / file).read_bytes()[-8:-4], "little")
    for back in range(9, size + 9):
        check_damage(
            sound[layout],
            file,
            lambda data, at=-back: data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :],
            judge,
        )


def test_a_missing_file_of_each_kind(sound: dict[str, Path], tmp_path: Path) -> None:
    for layout, file, _ in KINDS.values():
        folder = tmp_path / "copy"
        shutil.copytree(sound[layout], folder)
        (folder / file).unlink()
        assert status(folder) == 2
        shutil.rmtree(folder)
