"""One person written in two ways, and one recording under two impacts, are named; sound datasets are not."""

from __future__ import annotations

import pandas as pd
import pytest

from bayestissue.dataset import read_dataset
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


def test_a_sound_dataset_has_nothing_twice(lab: Lab) -> None:
    assert warned(lab) == []
