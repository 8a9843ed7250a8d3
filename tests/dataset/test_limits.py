"""Which samples stand at the sensor's limit: a plateau, a shared greatest value, or a stated one."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from dataset_bench import Lab

TIME = np.arange(0, 0.06, 5e-4)
COUNT = 5
SIGNAL = {"quantity": "deceleration", "unit": "m/s^2"}


def force(row: int) -> np.ndarray:
    """Half a sine over 30 ms in noise, of a peak of its own."""
    since = TIME - 0.02 - 1e-4 * row
    pulse = np.where((since > 0) & (since < 0.03), np.sin(np.pi * since / 0.03), 0.0)
    return (80 + 2 * row) * pulse + 0.3 * np.random.default_rng(row).standard_normal(len(TIME))


def read(values: list[np.ndarray], **chosen) -> bt.Dataset:
    names = [f"i{row}" for row in range(len(values))]
    impacts = pd.DataFrame({"impact": names, "subject": "s", "mass_kg": 0.5, "velocity_m_s": 1.5})
    return bt.dataset(impacts, [(TIME, value) for value in values], **SIGNAL | chosen)


def marked(data: bt.Dataset) -> list[int]:
    return [0 if trace.clipped is None else int(np.abs(trace.clipped).sum()) for trace in data.traces]


def test_the_same_greatest_value_of_several_recordings_is_the_limit() -> None:
    limit = np.sort(np.array([force(row).max() for row in range(COUNT)]))[1] - 0.05
    cut = [np.minimum(force(row), limit) for row in range(COUNT)]
    expected = [int((value == limit).sum()) for value in cut]
    assert min(expected) < 3
    assert marked(read(cut)) == expected


def test_its_sign_may_be_the_other() -> None:
    cut = [-np.minimum(force(row), 78.0) for row in range(COUNT)]
    data = read(cut, quantity="acceleration")
    assert marked(data) == [int((value == -78.0).sum()) for value in cut]
    assert all((trace.clipped <= 0).all() for trace in data.traces)


def test_a_stated_limit_and_one_that_a_copy_shares() -> None:
    whole = [force(row) for row in range(2)]
    assert marked(read([*whole, whole[0]])) == [0, 0, 0]
    assert marked(read(whole, limit=70.0)) == [int((value >= 70.0).sum()) for value in whole]
    in_g = read([value / 9.80665 for value in whole], unit="g_0", limit=70.0 / 9.80665)
    assert marked(in_g) == marked(read(whole, limit=70.0))


def test_it_is_written_and_read_again(tmp_path) -> None:
    data = read([force(row) for row in range(2)], limit=70.0)
    assert marked(bt.read_dataset(data.write(tmp_path / "again"))) == marked(data)


def test_limits_of_two_recordings_are_written_and_read_again(tmp_path) -> None:
    data = read([np.minimum(force(0), 40.0), np.minimum(force(1), 70.0)])
    assert len({float(trace.value[trace.clipped != 0].max()) for trace in data.traces}) == 2
    assert marked(bt.read_dataset(data.write(tmp_path / "again"))) == marked(data)


def test_models_that_have_no_place_for_it_say_so() -> None:
    clipped = read([np.minimum(force(row), 70.0) for row in range(2)])
    with pytest.raises(InputError, match="2 of these"):
        bt.fit(clipped, "arma")
    with pytest.raises(InputError, match="i0 the first"):
        bt.estimate(clipped, method="dds")


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("form", ["files", "long"])
def test_what_a_recorder_writes_as_infinite_is_at_its_limit(form: str, sign: int, lab: Lab) -> None:
    lab.value("abcd", f"{sign} * np.minimum(v, 20.0)")
    limit, infinite = f",{sign * 20.0}\n", f",{'∞' if sign > 0 else '-∞'}\n"
    at = np.split(pd.read_csv(lab.path("traces.csv"))["value"].to_numpy() == sign * 20.0, 4)
    lab.replace("traces.csv", limit, infinite, -1)
    if sign < 0:
        lab.replace("dataset.toml", "deceleration", "acceleration")
    if form == "files":
        lab.trace("a.csv")
    for trace, cut in zip(bt.read_dataset(lab.folder).traces, at, strict=True):
        np.testing.assert_array_equal(trace.clipped, sign * cut)
        assert (trace.value[cut] == sign * np.max(sign * trace.value[~cut])).all()
