"""The stretch of a recording that is read: for all impacts, or for each its own; several from one file."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset
from dataset_bench import NAMES, RATE, Lab, tables

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


def test_an_impact_s_own_cells_go_before_the_dataset_s(lab: Lab) -> None:
    impacts, _ = tables()
    impacts.assign(crop_start_s=["", START, "", ""], crop_stop_s=["", "", "", STOP]).to_csv(
        lab.path("impacts.csv"), index=False
    )
    whole, late, _, early = read_dataset(lab.folder).traces
    assert whole.time_s.size == 400
    assert (late.time_s[0], late.time_s[-1]) == (START, whole.time_s[-1])
    assert (early.time_s[0], early.time_s[-1]) == (whole.time_s[0], STOP)


def one_file(lab: Lab, **columns: object) -> pd.DataFrame:
    """All four recordings in one file, one after the other; when each begins and ends."""
    impacts, traces = tables()
    traces["time_s"] = np.arange(len(traces)) / RATE
    clock = {"wf_increment": 1 / RATE}
    with TdmsWriter(lab.path("all.tdms")) as writer:
        channel = ChannelObject("g", "value", traces["value"].to_numpy(), properties=clock)
        writer.write_segment([channel])
    ends = traces.groupby("impact")["time_s"].agg(["min", "max"])
    lab.path("traces.csv").unlink(missing_ok=True)
    table = impacts.assign(
        trace="all.tdms",
        crop_start_s=ends["min"].to_numpy() - 0.4 / RATE,
        crop_stop_s=ends["max"].to_numpy() + 0.4 / RATE,
    )
    table.assign(**columns).to_csv(lab.path("impacts.csv"), index=False)
    return table


def test_several_impacts_come_out_of_one_file(lab: Lab) -> None:
    one_file(lab)
    _, traces = tables()
    for impact, trace in zip(NAMES, read_dataset(lab.folder).traces, strict=True):
        np.testing.assert_array_equal(trace.value, traces.loc[traces["impact"] == impact, "value"])


def test_two_impacts_share_no_stretch(lab: Lab) -> None:
    table = one_file(lab)
    one_file(lab, crop_start_s=[*table["crop_start_s"][:2], 0.0, table["crop_start_s"][3]])
    with pytest.raises(InputError, match=r"row 4, column trace, impact c: .*from 0 to") as refused:
        read_dataset(lab.folder)
    assert len(refused.value.problems) == 1


def test_what_lies_outside_may_be_spoilt(lab: Lab) -> None:
    lab.cell("traces.csv", 3, "value", "saturated")
    with pytest.raises(InputError, match="saturated"):
        read_dataset(lab.folder)
    lab.replace("dataset.toml", "[signal]", f"[signal]\ncrop = [{START}, {STOP}]")
    assert len(read_dataset(lab.folder).traces) == 4
    lab.row("traces.csv", 100, lambda line: line.rsplit(",", 1)[0] + ",lost")
    with pytest.raises(InputError, match=r"row 100, column value, impact a: found \"lost\""):
        read_dataset(lab.folder)
