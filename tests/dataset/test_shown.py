"""What a console and a notebook show of a dataset: a few lines, whoever wrote the names in it."""

from __future__ import annotations

import pytest

from bayestissue.base.outline import Outlined, Rows
from bayestissue.recordings.dataset import Dataset, read_dataset
from dataset_bench import Lab


class Evil(Outlined):
    def _outline(self) -> tuple[str, Rows]:
        return "<t>\n", [("a", "<i>\x9b"), ("longer", "b\nc")]


@pytest.fixture
def dataset(lab: Lab) -> Dataset:
    return read_dataset(lab.folder)


def test_a_dataset_in_a_few_lines(dataset: Dataset) -> None:
    assert "  recorded  deceleration, 400 samples each, 10000 Hz" in repr(dataset).splitlines()
    assert repr(dataset.traces[0]) == "Trace of 400 samples, -0.005 to 0.0349 s"
    assert dataset._repr_html_().count("<tr>") == 4


def test_text_of_any_origin_is_tame(dataset: Dataset) -> None:
    evil = dataset.with_settings(name="<script>alert(1)</script>\x1b[2J" + 1000 * "x")
    assert "\x1b" not in repr(evil)
    assert len(repr(evil)) < 400
    assert "<script" not in evil._repr_html_()
    assert repr(Evil()) == "<t>\\u000a\n  a       <i>\\u009b\n  longer  b\\u000ac"
    assert "&lt;i&gt;\\u009b" in Evil()._repr_html_()
    assert "<t>" not in Evil()._repr_html_()
