from __future__ import annotations

import numpy as np
import pytest

from bayestissue.errors import InputError
from bayestissue.signal.filters import low_pass

RATE = 50_000.0


def impulse_response(frequency_class: int) -> np.ndarray:
    impulse = np.zeros((1, 8001))
    impulse[0, 4000] = 1.0
    return low_pass(impulse, np.array([1 / RATE]), frequency_class)[0]


@pytest.mark.parametrize("frequency_class", [60, 180, 600, 1000])
def test_the_corner_lies_at_five_thirds_of_the_class(frequency_class):
    frequencies = np.array([0.0, 5 / 3 * frequency_class])
    time = (np.arange(8001) - 4000) / RATE
    response = np.exp(-2j * np.pi * frequencies[:, None] * time) @ impulse_response(frequency_class)
    assert response[0].real == pytest.approx(1, abs=1e-9)
    # -3 dB; the bilinear transform bends the frequency axis by less than half a per cent here.
    assert np.abs(response[1]) == pytest.approx(1 / np.sqrt(2), rel=0.01)
    # Phaseless: the response is real.
    np.testing.assert_allclose(response.imag, 0, atol=1e-9)


def test_the_response_is_that_of_four_poles():
    time = (np.arange(8001) - 4000) / RATE
    frequency = 10 * 300
    response = np.exp(-2j * np.pi * frequency * time) @ impulse_response(180)
    # Ten times the corner: 1 / (1 + (10 x 0.8022)⁴), and less as the bilinear transform bends the axis.
    assert np.abs(response) < 1 / (1 + 8.022**4)
    assert np.abs(response) > 0.5 / (1 + 8.022**4)


def test_rows_of_different_rates_are_filtered_each_by_its_own():
    random = np.random.default_rng(0)
    rows = random.standard_normal((2, 500))
    both = low_pass(rows, np.array([1e-4, 5e-5]), 180)
    np.testing.assert_array_equal(both[1:], low_pass(rows[1:], np.array([5e-5]), 180))
    assert not np.allclose(both[0], low_pass(rows[:1], np.array([5e-5]), 180)[0])


def test_a_class_beyond_the_sampling_rate_is_refused():
    with pytest.raises(InputError, match=r"signal\.filter.*sampling rate above 4155 Hz") as refusal:
        low_pass(np.zeros((1, 100)), np.array([1 / 2000]), 1000)
    assert refusal.value.problems[0].value == "2000 Hz"
