"""LabVIEW's texts of several blocks: recordings as the sheets of a workbook are, or one that goes on."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.dataset_file import SignalSettings
from bayestissue.recordings.dataset.recorders import contents_of, read_recording
from bayestissue.recordings.dataset.source_files import Source
from command_line import init
from dataset_bench import deceleration
from recorder_files import lvm

VELOCITY = 1.2
FACTS = {"velocity_m_s": VELOCITY, "mass_kg": 1}
SIGNAL = SignalSettings(quantity="deceleration", unit="m/s^2")


def recorded(which: int) -> tuple[np.ndarray, np.ndarray]:
    return deceleration(1 + 0.001 * which, VELOCITY)


def blocks(
    path: Path, recordings: list[tuple[np.ndarray, np.ndarray]], form: str = "header", **how: str
) -> None:
    """A file of several blocks: each with its header, behind that of a file of its own, or with none."""
    texts = []
    for time, value in recordings:
        lvm(path, time, {"Impact": value}, **how)  # type: ignore[arg-type]
        texts.append(path.read_text())
    begin = {
        "header": lambda text: text.index("Channels"),
        "file": lambda _: 0,
        "empty line": lambda text: text.index("\n", text.index("X_Value")) + 1,
        "times": lambda text: text.index("\n", text.index("X_Value")) + 1,
    }[form]
    between = "" if form == "times" else "\n"
    path.write_text(between.join([texts[0], *(text[begin(text) :] for text in texts[1:])]))


@pytest.mark.parametrize("form", ["header", "file", "empty line", "times"])
def test_each_block_is_a_recording_with_its_rows(form: str, tmp_path: Path) -> None:
    path = tmp_path / "a.lvm"
    blocks(path, [recorded(0), recorded(1), recorded(2)], form)
    assert len(contents_of(Source.at(path)).blocks) == 3
    lines = path.read_text().split("\n")
    for which in range(3):
        part = path.with_name(f"a.lvm#{which + 1}")
        found = read_recording(Source.at(part), SIGNAL)
        time, value = recorded(which)
        np.testing.assert_allclose(found.values, value, rtol=1e-11, atol=0)
        np.testing.assert_allclose(found.clock, time, rtol=0, atol=1e-9)
        assert float(lines[found.rows[0] - 1].split("\t")[1]) == pytest.approx(value[0])
    with pytest.raises(InputError, match=r'found "3 blocks"; expected one recording.*such as a.lvm#1'):
        read_recording(Source.at(path), SIGNAL)
    with pytest.raises(InputError, match=r'found "#4"; expected the number of a block. It has 3'):
        read_recording(Source.at(tmp_path / "a.lvm#4"), SIGNAL)


@pytest.mark.parametrize(
    ("form", "x_columns"),
    [("header", "One"), ("header", "No"), ("file", "Multi"), ("empty line", "One")],
)
def test_blocks_that_go_on_are_one_recording(form: str, x_columns: str, tmp_path: Path) -> None:
    time, value = recorded(0)
    path, parts = tmp_path / "a.lvm", zip(np.split(time, 4), np.split(value, 4), strict=True)
    blocks(path, list(parts), form, x_columns=x_columns)
    assert_whole(path, time, value)


def test_blocks_of_one_sample_are_one_recording(tmp_path: Path) -> None:
    time, value = recorded(0)
    blocks(tmp_path / "a.lvm", [(time[i : i + 2], value[i : i + 1]) for i in range(len(time) - 1)])
    # The second time says the interval; it has no sample.
    lines = (tmp_path / "a.lvm").read_text().split("\n")
    (tmp_path / "a.lvm").write_text(
        "\n".join(line for line in lines if not re.fullmatch(r"[-\d.e]+\t", line))
    )
    assert_whole(tmp_path / "a.lvm", time[:-1], value[:-1])


def assert_whole(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    found = read_recording(Source.at(path), SIGNAL)
    np.testing.assert_allclose(found.values, value, rtol=1e-11, atol=0)
    np.testing.assert_allclose(found.clock, time, rtol=0, atol=1e-9)
    lines = path.read_text().split("\n")
    cells = [float(lines[row - 1].split("\t")[1]) for row in found.rows]
    np.testing.assert_allclose(cells, value, rtol=1e-11, atol=0)


def test_pieces_without_a_header_and_times_are_refused(tmp_path: Path) -> None:
    # They may be one recording or several.
    blocks(tmp_path / "a.lvm", [recorded(0), recorded(1)], "empty line", x_columns="No")
    with pytest.raises(InputError, match="expected a header, or times in a column X_Value, of every piece"):
        contents_of(Source.at(tmp_path / "a.lvm"))


def test_two_recordings_in_segments_are_two(tmp_path: Path) -> None:
    (time, value), (_, other) = recorded(0), recorded(1)
    later = time + 3.0
    halves = (slice(200), slice(200, None))
    segments = [(t[half], v[half]) for t, v in ((time, value), (later, other)) for half in halves]
    blocks(tmp_path / "a.lvm", segments)
    first, second = (read_recording(Source.at(tmp_path / f"a.lvm#{n}"), SIGNAL) for n in (1, 2))
    np.testing.assert_allclose(first.values, value, rtol=1e-11, atol=0)
    np.testing.assert_allclose(second.values, other, rtol=1e-11, atol=0)
    assert second.clock[0] == pytest.approx(later[0])


def test_a_header_without_numbers_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.lvm"
    blocks(path, [recorded(0), recorded(1)])
    text = path.read_text()
    second = text.index("Channels", text.index("X_Value"))
    names = text.index("X_Value", second)
    for end in (second + 40, names, text.index("\n", names) + 1):
        path.write_text(text[:end])
        with pytest.raises(InputError, match="expected numbers below every header"):
            contents_of(Source.at(path))


def test_a_table_has_no_blocks(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,value\n0,1\n1,2\n")
    with pytest.raises(InputError, match=r'a\.csv#1: found "#1"; expected the name of a file'):
        read_recording(Source.at(tmp_path / "a.csv#1"), SIGNAL)


def test_blocks_that_are_no_recording_are_passed_over(tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    for name, first, last in (("p1", 0, 1), ("p2", 3, 2)):
        time, value = recorded(first)
        blocks(folder / f"{name}.lvm", [(time, value), (time[:3], value[:3]), recorded(last)])
    made = init(folder, tmp_path / "d", set=FACTS, pattern="{subject}")
    assert made.status == 0, made.err
    assert "passed over: blocks without a recording: p1.lvm (2), p2.lvm (2)" in made.out
    table = bt.read_dataset(tmp_path / "d").impacts
    assert table["trace"].tolist() == [f"recordings/{who}.lvm#{n}" for who in ("p1", "p2") for n in (1, 3)]
    assert table["impact"].tolist() == ["p1_1", "p1_3", "p2_1", "p2_3"]


def test_a_path_names_a_block_unless_a_file_is_called_so(tmp_path: Path) -> None:
    part = Source.at(Path("a/b.LVM#12"))
    assert (part.path, part.part, part.label) == (Path("a/b.LVM"), "12", "b.LVM#12")
    for whole in ("a.lvm", "a.lvm#left", "a.tdms#1", "#1"):
        assert (Source.at(Path(whole)).path, Source.at(Path(whole)).part) == (Path(whole), "")
    (tmp_path / "a.lvm#1").write_text("")
    assert Source.at(tmp_path / "a.lvm#1").path == tmp_path / "a.lvm#1"
