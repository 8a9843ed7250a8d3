"""Impacts that somebody left out of a dataset, with a reason."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset, write_dataset
from bayestissue.recordings.dataset.left_out import FILE, NEVER_READ, reason_of, reasons, write_left_out
from bayestissue.studies.checking import check
from dataset_bench import SETTINGS, Lab, tables


def test_an_impact_that_is_left_out_is_told_with_its_reason(lab: Lab) -> None:
    whole = read_dataset(lab.folder)
    name = whole.impacts["impact"].iloc[1]
    write_left_out(lab.folder, {name: 'hit the frame, "twice"'})
    rest = read_dataset(lab.folder)
    assert list(rest.impacts["impact"]) == [n for n in whole.impacts["impact"] if n != name]
    assert [(p.impact, p.value, p.code) for p in rest.left_out] == [
        (name, 'hit the frame, "twice"', "left-out")
    ]
    assert rest.input_hash != whole.input_hash
    assert "1 impact left out" in check(rest).verdict
    write_left_out(lab.folder, {})
    assert not (lab.folder / FILE).exists()
    assert read_dataset(lab.folder).input_hash == whole.input_hash


def test_what_is_wrong_with_it_does_not_matter(lab: Lab) -> None:
    name = read_dataset(lab.folder).impacts["impact"].iloc[0]
    lab.row("impacts.csv", 2, lambda line: line.replace(line.split(",")[3], "-1"))
    with pytest.raises(InputError):
        read_dataset(lab.folder)
    write_left_out(lab.folder, {name: "no mass was written down"})
    assert name not in set(read_dataset(lab.folder).impacts["impact"])


def test_a_name_that_nobody_has_is_a_warning_and_a_row_without_a_reason_an_error(lab: Lab) -> None:
    write_left_out(lab.folder, {"nobody": "a reason"})
    assert [p.impact for p in read_dataset(lab.folder).warnings] == ["nobody"]
    lab.path(FILE).write_text("impact,reason\nb,x\nb,y\nc,\n")
    with pytest.raises(InputError) as error:
        reasons(lab.folder)
    assert [problem.row for problem in error.value.problems] == [3, 4]


def test_a_recording_that_never_came_in_is_left_out_too(lab: Lab) -> None:
    write_left_out(lab.folder, {"b": "hit the frame", "z": f"{NEVER_READ}a damaged file: no end"})
    data = read_dataset(lab.folder)
    assert data.warnings == ()
    assert [(p.impact, reason_of(p)) for p in data.left_out] == [
        ("b", "hit the frame"),
        ("z", "a damaged file: no end"),
    ]
    assert len(data.impacts) == 3


def test_names_that_a_spreadsheet_would_compute_are_read_as_they_were(tmp_path: Path) -> None:
    impacts, traces = tables()
    named = dict(zip(impacts["impact"], ["=1+1", "-x", "@", "'+1"], strict=True))
    impacts["impact"], impacts["sex"] = impacts["impact"].map(named), ["=f", "=f", "-m", "-m"]
    traces["impact"] = traces["impact"].astype(str).map(named)
    write_dataset(tmp_path, settings=SETTINGS, impacts=impacts, traces=traces, trace_file="traces.csv")
    write_left_out(tmp_path, {"-x": "=HYPERLINK(1)"})
    for path in (tmp_path / "impacts.csv", tmp_path / "left_out.csv"):
        cells = pd.read_csv(path, dtype=str)
        assert not [cell for name in cells for cell in cells[name] if cell[0] in "=-+@"]
    assert reasons(tmp_path) == {"-x": "=HYPERLINK(1)"}
    data = read_dataset(tmp_path)
    assert sorted(data.impacts["impact"]) == sorted(["=1+1", "@", "'+1"])
    assert set(data.impacts["sex"]) == {"=f", "-m"}
