"""One impact from two arrays: the row of `estimate`, in the words and the picture of one object."""

from __future__ import annotations

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.resources import shared

UNCERTAINTY = {"relative_mass_sd": 0.005, "velocity_sd_m_s": 0.01}


@pytest.fixture(scope="module")
def example():
    return bt.read_dataset(shared("data", "example"))


@pytest.fixture(scope="module")
def found(example) -> bt.Impact:
    trace, about = example.traces[5], example.impacts.iloc[5]
    given = {"mass_kg": about["mass_kg"], "velocity_m_s": about["velocity_m_s"]}
    return bt.impact(trace.time_s, trace.value, **given, uncertainty=UNCERTAINTY)


def test_it_is_the_row_that_estimate_has(example, found: bt.Impact):
    about = example.impacts.iloc[[5]]
    alone = bt.dataset(
        about, example.traces[5:6], quantity="deceleration", unit="m/s^2", uncertainty=UNCERTAINTY
    )
    row = bt.estimate(alone).iloc[0]
    assert (row["K_N_per_m"], row["C_N_s_per_m"]) == (found.K, found.C)
    assert found.K_interval == (row["K_low_N_per_m"], row["K_high_N_per_m"])
    assert found.C_interval == (row["C_low_N_s_per_m"], row["C_high_N_s_per_m"])
    assert "; ".join(found.flags) == row["flags"]


def test_its_picture_and_words(found: bt.Impact):
    left = found.deceleration - found.fitted
    assert left.std() == pytest.approx(found.row["noise_sd_m_s2"], rel=0.2)
    assert f"{found.K:.4g} N/m (90 %" in repr(found)
    assert len(found.plot().axes) == 2
    assert found._repr_html_().count("<svg") == 1


def test_slips_are_named_by_their_array():
    time = np.arange(100) * 1e-4
    with pytest.raises(bt.InputError, match="100 times and 99 values"):
        bt.impact(time, np.zeros(99), mass_kg=1.0, velocity_m_s=1.0)
    with pytest.raises(bt.InputError, match="a signal that changes"):
        bt.impact(time, np.zeros(100), mass_kg=1.0, velocity_m_s=1.0)
    with pytest.raises(bt.InputError, match="column mass_kg"):
        bt.impact(time, np.sin(300 * time), mass_kg=-1.0, velocity_m_s=1.0)
    with pytest.raises(bt.InputError, match='column unit: found "N"'):
        bt.impact(time, np.sin(300 * time), mass_kg=1.0, velocity_m_s=1.0, unit="N")


def test_too_few_samples_give_no_estimate_and_say_so(example):
    trace, about = example.traces[5], example.impacts.iloc[5]
    few = bt.impact(trace.time_s[3::30], trace.value[3::30], mass_kg=about["mass_kg"], velocity_m_s=1.25)
    assert "fewer than 8 samples in the window" in few.flags
    assert "no estimate" in repr(few)
    assert len(few.plot().axes) == 2
