from __future__ import annotations

import numpy as np
import pytest

from bayestissue.errors import InputError
from bayestissue.signal import SignalOptions, displacements, integrated
from bayestissue.signal.traces import stack
from bayestissue.simulation.centring import one_tissue


@pytest.mark.parametrize("window", ["peak", "rebound"])
def test_recordings_that_lie_under_one_another_give_what_a_dataset_gives(window: str) -> None:
    dataset = one_tissue()
    options = SignalOptions(window=window)
    mass, velocity = (dataset.impacts[name].to_numpy() for name in ("mass_kg", "velocity_m_s"))
    expected = displacements(dataset, options)
    found = integrated(stack(dataset.traces), mass, velocity, options)
    for name in ("x", "n_samples", "time_to_peak", "first_sample_s", "noise_sd"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_filter_needs_its_sampling_rate_here_too() -> None:
    dataset = one_tissue(sampling_rate=800)
    mass, velocity = (dataset.impacts[name].to_numpy() for name in ("mass_kg", "velocity_m_s"))
    with pytest.raises(InputError):
        integrated(stack(dataset.traces), mass, velocity, SignalOptions(filter=1000))
