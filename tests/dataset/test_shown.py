"""What a console and a notebook show of a dataset: a few lines, whoever wrote the names in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayestissue.base.errors import Problem
from bayestissue.base.outline import Outlined, Rows, span
from bayestissue.recordings.dataset import Dataset, read_dataset
from dataset_bench import Lab


class Evil(Outlined):
    def _outline(self) -> tuple[str, Rows]:
        return "<t>\n", [("a", "<i>\x9b"), ("longer", "b\nc")]


@pytest.fixture
def dataset(lab: Lab) -> Dataset:
    return read_dataset(lab.folder)


def test_a_dataset_in_a_few_lines(dataset: Dataset) -> None:
    assert repr(dataset).splitlines() == [
        "Dataset bench",
        "  impacts   4; subjects: 2, trials: 2",
        "  recorded  deceleration, 400 samples each, 10000 Hz",
        "  mass      0.5 to 1.3 kg",
        "  velocity  0.9 to 1.2 m/s",
    ]
    assert repr(dataset.traces[0]) == "Trace of 400 samples, -0.005 to 0.0349 s"
    page = dataset._repr_html_()
    assert page.count("<tr>") == 4
    assert "0.5 to 1.3 kg" in page


def test_what_was_left_out_and_what_looks_odd_is_counted(dataset: Dataset) -> None:
    odd = Problem("f", "e", "r", impact="x", code="no-file")
    left_out = (odd, replace(odd, column="c"), replace(odd, impact="y"))
    told = repr(replace(dataset, warnings=(odd,), left_out=left_out))
    assert told.endswith("\n  look at   1 warning, 2 impacts left out")


def test_text_of_any_origin_is_tame(dataset: Dataset) -> None:
    evil = dataset.with_settings(name="<script>alert(1)</script>\x1b[2J" + 1000 * "x")
    assert "\x1b" not in repr(evil)
    assert len(repr(evil)) < 400
    assert "<script" not in evil._repr_html_()
    assert repr(Evil()) == "<t>\\u000a\n  a       <i>\\u009b\n  longer  b\\u000ac"
    assert "&lt;i&gt;\\u009b" in Evil()._repr_html_()
    assert "<t>" not in Evil()._repr_html_()


def test_values_that_are_not_stated() -> None:
    assert span([np.nan, np.inf], "m") == "not stated"
    assert span([], "m") == "not stated"
    assert span([2.0, np.nan, 1234.56], "N/m") == "2 to 1235 N/m"
