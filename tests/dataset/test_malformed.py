"""Every way a dataset can be wrong: refused with status 2, the place named, and nothing written."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import bayestissue as bt
from bayestissue.base.errors import has_control_characters
from cases import cases
from command_line import bayestissue
from dataset_bench import SETTINGS, Lab

NAMES_AS: dict[str, Callable[[str], object]] = {
    "binary": lambda name: name.encode() + b"\xff",
    "list": lambda name: [name],
    "double": lambda _: 1.5,
}
# What the same tables in Python may be wrong in, by what spoils them.
IN_TABLES = {"cell", "keep", "value", "time", "displacement", "column", "says"}


class Malformed(Lab):
    """Further ways to spoil a dataset."""

    def damage(self, name: str, old: str, new: str) -> None:
        """Replace bytes, those of Latin-1."""
        text = self.path(name).read_bytes().decode("latin-1")
        assert old in text
        self.write(name, text.replace(old, new, 1))

    def line(self, name: str, number: int, text: str | None = None) -> None:
        """Replace a line by a text, in which braces stand for it, or take it out."""
        self.row(name, number, lambda line: text and text.format(line))

    def low_pass(self, hertz: float) -> None:
        """A filter of the recorder, which is applied to even times only."""
        self.append("dataset.toml", f"\n[recorder]\nlow_pass_hz = {hertz}\n")

    def crop(self, start: object, stop: object = None) -> None:
        self.column("crop_start_s", start)
        self.column("crop_stop_s", stop)

    def copy(self, name: str, packed: str) -> None:
        self.path(packed).write_bytes(gzip.compress(self.path(name).read_bytes()))

    def columns(self, name: str, count: int) -> None:
        self.replace(name, "value", "value," + ",".join(map(str, range(count))))

    def names_as(self, kind: str) -> None:
        table = pd.read_csv(self.path("traces.csv"))
        self.remove("traces.csv")
        names = pa.array([NAMES_AS[kind](name) for name in table["impact"]])
        columns = {"impact": names, "time_s": table["time_s"], "value": table["value"]}
        pq.write_table(pa.table(columns), self.path("traces.parquet"))

    def subfolder(self, name: str) -> None:
        self.path(name).mkdir()

    def link(self, name: str) -> None:
        away = self.folder.with_name("away.csv")
        away.write_bytes(self.path("b.csv").read_bytes())
        self.path(name).symlink_to(away)


@pytest.fixture
def malformed(lab: Lab) -> Malformed:
    return Malformed(lab.folder)


def places(error: bt.InputError, first: int) -> list[tuple[Any, ...]]:
    """Of each problem the impact, the key or column and the row, counted from the first."""
    return [
        (one.impact, (one.column or "").removeprefix("signal."), one.row and one.row - first)
        for one in error.problems
    ]


def in_tables(lab: Lab, unit: str | None) -> bt.Dataset:
    """The dataset's tables as a caller in Python has them: of displacements, where they have a unit."""
    impacts, traces = (
        pd.read_csv(lab.path(name), keep_default_na=False) for name in ("impacts.csv", "traces.csv")
    )
    signal = {"quantity": "displacement", "unit": unit} if unit else SETTINGS["signal"]
    return bt.dataset(impacts, traces, uncertainty=SETTINGS["uncertainty"], **signal)


@pytest.mark.slow
@pytest.mark.parametrize("case", cases(__file__))
def test_refused_with_its_place_and_nothing_written(
    case: dict[str, Any], malformed: Malformed, tmp_path: Path
) -> None:
    malformed.spoil(case)
    before = sorted(path.name for path in tmp_path.rglob("*"))
    outcome = bayestissue("check", malformed.folder, "--out", tmp_path / "quality")
    assert (outcome.status, outcome.out) == (2, "")
    assert "problem" in outcome.err
    assert "nothing was written" in outcome.err
    for words in case["says"]:
        assert words in outcome.err
    assert not has_control_characters(outcome.err.replace("\n", ""))
    with pytest.raises(bt.InputError) as refused:
        bt.read_dataset(malformed.folder)
    assert sorted(path.name for path in tmp_path.rglob("*")) == before
    if set(case) <= IN_TABLES:
        with pytest.raises(bt.InputError) as of_tables:
            in_tables(malformed, case.get("displacement"))
        assert places(of_tables.value, 0) == places(refused.value, 2)
        assert "csv" not in str(of_tables.value)
        assert "toml" not in str(of_tables.value)


def test_everything_is_said_at_once(lab: Lab) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "heavy")
    lab.cell("impacts.csv", 3, "velocity_m_s", "-1")
    lab.value("c", "-v")
    lab.time("d", "t[::-1]")
    outcome = bayestissue("check", lab.folder)
    assert outcome.err.startswith("4 problems")
    for words in ("impact a", "impact b", "impact c", "impact d"):
        assert words in outcome.err


def test_a_path_inside_the_folder_may_take_a_way_round(lab: Lab) -> None:
    lab.trace("a.csv")
    plain = bt.read_dataset(lab.folder)
    lab.column("trace", ["nowhere/../a.csv", "b.csv", "c.csv", "d.csv"])
    found = bt.read_dataset(lab.folder)
    np.testing.assert_array_equal(found.traces[0].value, plain.traces[0].value)
