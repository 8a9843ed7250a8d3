"""One person written in two ways, and one recording under two impacts, are named; sound datasets are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.ragged_traces import Traces
from bayestissue.recordings.dataset.twins import twins
from dataset_bench import Lab


def test_a_recording_under_two_impacts_is_named(lab: Lab) -> None:
    traces = pd.read_csv(lab.path("traces.csv"))
    mine, other = ((traces["impact"] == name).to_numpy() for name in "ca")
    for gain, words in (
        (1.0, "the same samples as impact a"),
        (1.0001, "with other digits, beginning, gain or rate, the recording of impact a"),
    ):
        traces.loc[mine, "value"] = gain * traces.loc[other, "value"].to_numpy()
        traces.to_csv(lab.path("traces.csv"), index=False)
        (found,) = read_dataset(lab.folder).warnings
        assert "traces.csv, column value, impact c" in str(found)
        assert words in str(found)


def recorded(values: list[np.ndarray], every: dict[int, int] | None = None) -> Traces:
    """Recordings at one rate, but for those that have one of so many samples."""
    start = np.cumsum([0, *map(len, values)])
    time = np.concatenate([1e-4 * (every or {}).get(i, 1) * np.arange(len(v)) for i, v in enumerate(values)])
    return Traces(time, np.concatenate(values), start)


def repeats(noise: float, rate: float, count: int = 60) -> list[np.ndarray]:
    """The same impact again and again, met by a triggered recorder, with noise of this share of the peak."""
    time = np.arange(int(0.08 * rate)) / rate - 0.01
    value = np.where(time > 0, 40 * np.exp(-30 * time) * np.sin(60 * time), 0)
    draw = np.random.default_rng(int(rate)).normal
    return [value + draw(0, noise * value.max(), value.size) for _ in range(count)]


@pytest.mark.parametrize(("noise", "rate"), [(1e-4, 500.0), (1e-2, 500.0), (1e-3, 2000.0), (1e-2, 10_000.0)])
def test_a_recording_exported_anew_is_known_again_and_repeats_are_not(noise: float, rate: float) -> None:
    values = repeats(noise, rate)
    # 1,770 pairs of repeats, each less likely than 1e-10 to come so near by chance.
    assert list(twins(recorded(values))) == []
    digits = int(np.ceil(-np.log10(noise))) + 1
    for change in (
        lambda value: value.round(digits),
        lambda value: value[1:],
        lambda value: value[:-3],
        lambda value: 1.0001 * value,
        lambda value: (1.0001 * value + 0.5)[1:].round(digits),
    ):
        again = list(twins(recorded([*values[:10], *map(change, values[:10])])))
        assert again == [(10 + which, which, False) for which in range(10)]


def test_impacts_that_people_recorded_are_none_again(heel_strikes: Path) -> None:
    values = [trace.value for trace in read_dataset(heel_strikes).traces]
    assert list(twins(recorded(values))) == []
    again = [(1.0001 * value)[1:].round(int(5 - np.log10(np.ptp(value)))) for value in values]
    found = list(twins(recorded([*values, *again])))
    assert found == [(len(values) + which, which, False) for which in range(len(values))]


@pytest.mark.parametrize(("noise", "every", "begin"), [(1e-4, 2, 1), (1e-2, 5, 3), (1e-4, 10, 0)])
def test_a_copy_with_samples_left_out_is_known_again_and_repeats_are_not(
    noise: float, every: int, begin: int
) -> None:
    """The repeats at the lower rate are others, of the same machine."""
    values = repeats(noise, 10_000.0)
    lower = [value[::every] for value in values[30:]]
    rates = dict.fromkeys(range(30, 61), every)
    assert list(twins(recorded([*values[:30], *lower], rates))) == []
    copied = 1.003 * values[7][begin::every] + 0.2
    assert list(twins(recorded([*values[:30], *lower, copied], rates))) == [(60, 7, False)]
