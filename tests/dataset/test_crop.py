"""The stretch of a recording that is read: for all impacts, or for each its own; several from one file."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset
from dataset_bench import NAMES, Lab, tables

START, STOP = 0.001, 0.03


def inside(impact: str) -> pd.DataFrame:
    _, traces = tables()
    return traces[(traces["impact"] == impact) & traces["time_s"].between(START, STOP)]


def test_a_dataset_is_cropped_in_its_unit_of_time(lab: Lab) -> None:
    table = pd.read_csv(lab.path("traces.csv"))
    table["time_s"] *= 1e3
    table.to_csv(lab.path("traces.csv"), index=False)
    lab.replace(
        "dataset.toml", "[signal]", f'[signal]\ntime_unit = "ms"\ncrop = [{1e3 * START}, {1e3 * STOP}]'
    )
    for impact, trace in zip(NAMES, read_dataset(lab.folder).traces, strict=True):
        # Two conversions of a unit: two roundings.
        np.testing.assert_allclose(trace.time_s, inside(impact)["time_s"], rtol=4e-16)
        np.testing.assert_array_equal(trace.value, inside(impact)["value"])


def test_what_lies_outside_may_be_spoilt(lab: Lab) -> None:
    lab.cell("traces.csv", 3, "value", "saturated")
    with pytest.raises(InputError, match="saturated"):
        read_dataset(lab.folder)
    lab.replace("dataset.toml", "[signal]", f"[signal]\ncrop = [{START}, {STOP}]")
    assert len(read_dataset(lab.folder).traces) == 4
    lab.row("traces.csv", 100, lambda line: line.rsplit(",", 1)[0] + ",lost")
    with pytest.raises(InputError, match=r"row 100, column value, impact a: found \"lost\""):
        read_dataset(lab.folder)
