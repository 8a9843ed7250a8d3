"""One person written in two ways, and one recording under two impacts, are named; sound datasets are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.recordings import Samples
from bayestissue.recordings.dataset.twins import twins
from dataset_bench import Lab


def warned(lab: Lab) -> list[str]:
    return [str(problem) for problem in read_dataset(lab.folder).warnings]


def rename(lab: Lab, column: str, names: list[str]) -> None:
    table = pd.read_csv(lab.path("impacts.csv"))
    table[column] = names
    table.to_csv(lab.path("impacts.csv"), index=False)


@pytest.mark.parametrize(
    ("one", "other"),
    [("s1", "S1"), ("s1", "s01"), ("s1", "s 1"), ("s1", "s-1"), ("1", "1.0"), ("ﬁt", "fit"), ("7", "007")],
)
def test_one_name_written_in_two_ways_is_named(lab: Lab, one: str, other: str) -> None:
    rename(lab, "subject", [one, other, "x", "x"])
    (found,) = warned(lab)
    assert "impacts.csv, row 3, column subject, impact b" in found
    assert f'found "{other}"' in found
    assert f'one way to write the subject "{one}"' in found


@pytest.mark.parametrize(
    "names", [["s1", "s11", "s10", "s1-1"], ["0.5 kg", "5 kg", "1.5", "15"], ["-5", "5", "+5", "1.05"]]
)
def test_different_names_are_not(lab: Lab, names: list[str]) -> None:
    rename(lab, "subject", names)
    rename(lab, "trial", names)
    assert warned(lab) == []


def test_a_recording_under_two_impacts_is_named(lab: Lab) -> None:
    traces = pd.read_csv(lab.path("traces.csv"))
    traces.loc[(traces["impact"] == "c").to_numpy(), "value"] = traces.loc[
        (traces["impact"] == "a").to_numpy(), "value"
    ].to_numpy()
    traces.to_csv(lab.path("traces.csv"), index=False)
    (found,) = warned(lab)
    assert "traces.csv, column value, impact c" in found
    assert "the same samples as impact a" in found


def recorded(values: list[np.ndarray], every: dict[int, int] | None = None) -> Samples:
    """Recordings at one rate, but for those that have one of so many samples."""
    start = np.cumsum([0, *map(len, values)])
    numbers = np.arange(len(values))
    files = ["f"] * len(values)
    time = np.concatenate([1e-4 * (every or {}).get(i, 1) * np.arange(len(v)) for i, v in enumerate(values)])
    return Samples(time, np.concatenate(values), start, numbers, files, np.zeros(start[-1], int))


def repeats(noise: float, rate: float, count: int = 60) -> list[np.ndarray]:
    """The same impact again and again, met by a triggered recorder, with noise of this share of the peak."""
    time = np.arange(int(0.08 * rate)) / rate - 0.01
    value = np.where(time > 0, 40 * np.exp(-30 * time) * np.sin(60 * time), 0)
    draw = np.random.default_rng(int(rate)).normal
    return [value + draw(0, noise * value.max(), value.size) for _ in range(count)]


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("rate", [500.0, 2000.0, 10_000.0])
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


def test_a_recording_exported_anew_is_named(lab: Lab) -> None:
    traces = pd.read_csv(lab.path("traces.csv"))
    mine, other = ((traces["impact"] == name).to_numpy() for name in "ca")
    traces.loc[mine, "value"] = (1.0001 * traces.loc[other, "value"].to_numpy()).round(3)
    traces.to_csv(lab.path("traces.csv"), index=False)
    (found,) = warned(lab)
    assert "with other digits, beginning, gain or rate, the recording of impact a" in found


def test_a_sound_dataset_has_nothing_twice(lab: Lab) -> None:
    assert warned(lab) == []


@pytest.mark.parametrize("noise", [1e-4, 1e-2])
@pytest.mark.parametrize(("every", "begin"), [(2, 0), (2, 1), (5, 3), (10, 0)])
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
