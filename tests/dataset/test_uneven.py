"""Uneven times: taken where the likelihood takes them, refused with the reason where it can't."""

from __future__ import annotations

import numpy as np
import pytest
from test_limits import SIGNAL, TIME, force, read

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.ragged_traces import Traces
from bayestissue.recordings.signal import displacements


def bent(rows: int = 2) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of the same force, 15 % of jitter and one sample in fifty lost."""
    random = np.random.default_rng(1)
    found = []
    for row in range(rows):
        time = TIME + 0.15 * 5e-4 * random.uniform(-1, 1, len(TIME))
        keep = np.arange(len(TIME)) % 50 != 49
        found.append((time[keep], np.interp(time[keep], TIME, force(row))))
    return found


def of_times(pairs: list[tuple[np.ndarray, np.ndarray]], **chosen) -> bt.Dataset:
    impacts = read([force(row) for row in range(len(pairs))]).impacts
    return bt.dataset(impacts, pairs, **SIGNAL | chosen)


def test_they_are_taken_at_the_times_that_there_are() -> None:
    data = of_times(bent())
    signal, even = displacements(data), displacements(read([force(row) for row in range(2)]))
    assert signal.uneven.all()
    assert [note.code for note in signal.notes[0]] == ["uneven-times"]
    # What noise and jitter do to a linear interpolation of it is below a hundredth.
    np.testing.assert_allclose(signal.stop.x, even.stop.x, rtol=0.01)
    np.testing.assert_allclose(signal.time_to_peak, even.time_to_peak, rtol=0.02)
    found = signal.contact_time_s[0] + signal.since_contact_s[0, : signal.n_samples[0]]
    begin = int(np.searchsorted(data.traces[0].time_s, found[0] - 1e-9))
    np.testing.assert_allclose(found, data.traces[0].time_s[begin:][: len(found)], atol=1e-9)


def test_an_even_recording_is_taken_as_it_is_alone() -> None:
    alone = displacements(of_times([(TIME, force(0))]))
    beside = displacements(of_times([(TIME, force(0)), bent()[1]]))
    assert beside.uneven.tolist() == [False, True]
    for name in ("x", "v", "value"):
        here, there = (getattr(of, name)[0, : alone.n_samples[0]] for of in (beside, alone))
        # A product of matrices rounds by how many rows there are.
        np.testing.assert_allclose(here, there, rtol=1e-14)


def test_what_needs_even_times_refuses() -> None:
    with pytest.raises(InputError, match="the declared low-pass"):
        of_times(bent(), recorder={"low_pass_hz": 500.0})
    with pytest.raises(InputError, match="evenly spaced"):
        bt.estimate(of_times(bent()), method="dds")


def test_a_lost_sample_is_uneven_and_a_rounded_clock_is_not() -> None:
    rounded = np.round(np.arange(200) / 3000, 4)
    lost = np.delete(np.arange(200) * 1e-4, 100)
    times = [np.arange(200) * 3.3e-4, rounded, lost]
    start = np.cumsum([0, *map(len, times)])
    whole = np.concatenate(times)
    assert Traces(whole, np.zeros_like(whole), start).uneven.tolist() == [False, False, True]


def test_a_stated_rate_is_that_of_the_clock_and_not_of_what_was_not_lost() -> None:
    impacts = read([force(0)]).impacts.assign(sampling_rate_hz=2000.0)
    bt.dataset(impacts, bent(1), **SIGNAL)
