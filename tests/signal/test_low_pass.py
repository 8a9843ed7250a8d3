"""A low-pass that was not declared: found where the rise shows it, and not where a tissue rises slowly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayestissue.recordings.dataset import Dataset
from bayestissue.recordings.signal import SignalOptions, displacements
from bayestissue.recordings.signal.contact import find_onset
from bayestissue.recordings.signal.padded_traces import stack
from bayestissue.recordings.signal.quality.force_laws import suspected
from bayestissue.studies.checking import check
from bayestissue.studies.simulation import Simulation, simulate

TISSUE = {"K_N_per_m": 32_000.0, "C_N_s_per_m": 60.0, "sd_impact_K": 0.1, "sd_impact_C": 0.1}
CHAIN = {"velocity_sd_m_s": 0.01, "relative_gain_sd": 0.01, "offset_sd_m_s2": 0.5}


def recorded(recorder: dict | None, impacts: int = 8, noise: float = 0.005, **tissue: object) -> Dataset:
    content = {
        "name": "rise",
        "seed": 4,
        "design": {
            "conditions": [{"trial": "a", "mass_kg": 0.6, "velocity_m_s": 1.5}],
            "subjects": impacts,
        },
        "tissue": TISSUE | tissue,
        "recording": {"noise_relative_to_peak": noise, **CHAIN},
    }
    content |= {"recorder": recorder} if recorder else {}
    return simulate(Simulation.model_validate(content)).dataset("rise")


@pytest.fixture(scope="module")
def behind_500_hz() -> Dataset:
    return recorded({"low_pass_hz": 500.0})


def test_check_names_it_and_what_it_costs(behind_500_hz: Dataset):
    found = check(behind_500_hz.with_settings(recorder=None))
    said = [each for each in found.warnings if "a rise at contact as fast as" in each.expected]
    assert len(said) >= 7
    assert all("second-order low-pass of" in str(each.value) for each in said)
    (remedy,) = {each.remedy for each in said}
    assert "[recorder]" in remedy
    assert "C 2" in remedy or "C 3" in remedy
    assert not [each for each in check(behind_500_hz).warnings if "low-pass" in str(each)]
    assert "500 Hz" in repr(behind_500_hz)


def test_the_corner_is_the_filters(behind_500_hz: Dataset):
    """Corners are tried in steps of a fifth."""
    found = suspected(displacements(behind_500_hz))
    assert np.nanmedian(found.corner_hz) == pytest.approx(500.0, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.001, 0.01])
@pytest.mark.parametrize(
    "tissue", [{}, {"element": "hunt_crossley", "K_N_per_m": 24_000.0, "C_N_s_per_m": 150.0}]
)
def test_tissues_are_left_alone(tissue: dict, noise: float):
    data = recorded(None, 40, noise, **tissue)
    assert not np.isfinite(suspected(displacements(data)).corner_hz).any()


def test_what_a_filter_run_backwards_makes_before_contact_is_not_quiet() -> None:
    """Its ringing would pass for an offset of 0.6 m/s^2 here, and make K 0.4 % too large."""
    data = recorded({"sae_class": 180}, noise=1e-5)
    data = replace(
        data, traces=[replace(trace, value=trace.value - trace.value[:20].mean()) for trace in data.traces]
    )
    rows = stack(data.traces)
    onset = find_onset(rows, SignalOptions(), data.recorder)
    assert onset.quiet.there.all()
    # A thousandth of the answer, of some 300 m/s^2, is left where the quiet part ends.
    np.testing.assert_allclose(onset.quiet.offset, 0.0, atol=0.1)
