"""One impact from two arrays: the row of `estimate`, in the words and the picture of one object."""

from __future__ import annotations

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.base.resources import shared
from tissues import path

UNCERTAINTY = {"relative_mass_sd": 0.005, "velocity_sd_m_s": 0.01}


@pytest.fixture(scope="module")
def example():
    return bt.read_dataset(shared("data", "example"))


@pytest.fixture(scope="module")
def found(example) -> bt.Impact:
    trace, about = example.traces[5], example.impacts.iloc[5]
    given = {"mass_kg": about["mass_kg"], "velocity_m_s": about["velocity_m_s"]}
    return bt.impact(trace.time_s, trace.value, **given, uncertainty=UNCERTAINTY)


@pytest.mark.slow
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
    assert found.outcomes.loc["peak_force", "median"] == row["peak_force_N"]


@pytest.mark.slow
def test_its_picture_and_words(found: bt.Impact):
    left = found.deceleration - found.fitted
    assert left.std() == pytest.approx(found.row["noise_sd_m_s2"], rel=0.2)
    assert f"{found.K:.4g} N/m (90 %" in repr(found)
    assert f"K = {found.K:.4g} N/m (90 %" in found.plot().words
    np.testing.assert_array_equal(found.plot().data["median"], found.fitted)
    assert found._repr_html_().count("<svg") == 1
    for words in ("deceleration (m/s²)", "residual (m/s²)", "time since contact (ms)", "spring and damper"):
        assert f">{words}</text>" in found._repr_html_()


@pytest.mark.slow
def test_a_drop_is_told_from_a_horizontal_impact() -> None:
    """Force over mass of M x'' = M g - K x - C x', by an independent solver, in noise."""
    time = np.arange(0, 0.06, 1e-4)
    motion = path("kelvin_voigt", {"K": 3000.0, "C": 25.0}, 0.5, 1.534, 0.04, gravity=9.80665)
    d = np.where(time >= 0.02003, motion.deceleration(np.maximum(time - 0.02003, 0.0)), 0.0)
    d += 0.3 * np.random.default_rng(7).standard_normal(len(time))
    given = {"mass_kg": 0.5, "velocity_m_s": 1.534}
    found, without = bt.impact(time, d, **given, gravity="drop"), bt.impact(time, d, **given)
    assert abs(found.K - 3000) < 3 * found.row["K_se_N_per_m"]
    assert abs(found.C - 25) < 3 * found.row["C_se_N_s_per_m"]
    assert not found.flags
    assert pytest.approx(3450, rel=0.01) == without.K
    assert without.flags


def test_what_a_masked_array_hides_is_not_used(example):
    trace, about = example.traces[5], example.impacts.iloc[5]
    given = {"mass_kg": about["mass_kg"], "velocity_m_s": about["velocity_m_s"], "uncertainty": UNCERTAINTY}
    time, value = trace.time_s, trace.value
    shown = np.arange(len(time)) < len(time) - 5
    found = bt.impact(time, np.ma.array(np.where(shown, value, 500.0), mask=~shown), **given)
    assert found.K == bt.impact(time[shown], value[shown], **given).K
    with pytest.raises(bt.InputError, match="row 50, column value"):
        bt.impact(time, np.ma.array(value, mask=np.arange(len(time)) == 50), **given)


def test_slips_are_named_by_their_array():
    time = np.arange(100) * 1e-4
    with pytest.raises(bt.InputError, match="100 times and 99 values"):
        bt.impact(time, np.zeros(99), mass_kg=1.0, velocity_m_s=1.0)
    with pytest.raises(bt.InputError, match="a signal that changes"):
        bt.impact(time, np.zeros(100), mass_kg=1.0, velocity_m_s=1.0)
    with pytest.raises(bt.InputError, match="column mass_kg"):
        bt.impact(time, np.sin(300 * time), mass_kg=-1.0, velocity_m_s=1.0)
    wrong = {"unit": "N", "gravity": "nowhere", "zero": "nowhere", "uncertainty": "2%", "recorder": True}
    for name, value in wrong.items():
        with pytest.raises(bt.InputError, match=f"column {name}: found"):
            bt.impact(time, np.sin(300 * time), mass_kg=1.0, velocity_m_s=1.0, **{name: value})


def test_too_few_samples_give_no_estimate_and_say_so():
    # One blow of five samples could not be read; the mass bounces.
    blow, rest = 100 * np.sin(np.pi * (np.arange(5) + 0.5) / 5), np.zeros(5)
    value = np.concatenate([np.tile(rest, 6), blow, rest, blow, rest])
    few = bt.impact(0.004 * np.arange(len(value)), value, mass_kg=0.7, velocity_m_s=1.25)
    assert "fewer than 8 samples in the window" in few.flags
    assert "no estimate" in repr(few)
    # Nothing is fitted, and nothing left over.
    assert few.plot().data["median"].isna().all()
    assert "NaN" not in few.plot().svg()
