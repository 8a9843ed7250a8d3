"""Which options `init` offers, what of a name is enough, and files beside the recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError

RATE = 2000.0
TIME = np.arange(400) / RATE
PULSE = 65 * np.where((TIME > 0.05) & (TIME < 0.107), np.sin(np.pi * (TIME - 0.05) / 0.0573), 0.0)
FACTS = {"mass_kg": 1.0, "velocity_m_s": 1.2}


def value(seed: int = 0) -> np.ndarray:
    return PULSE + np.random.default_rng(seed).normal(0, 0.05, TIME.size)


def folder(tmp_path: Path, **columns: object) -> Path:
    recorded = tmp_path / "recorded"
    recorded.mkdir()
    named = {name.replace("__", " [") + ("]" if "__" in name else ""): each for name, each in columns.items()}
    pd.DataFrame({"Time [s]": TIME, **named}).to_csv(recorded / "s1.csv", index=False, sep=";")
    return recorded


def asked(recorded: Path, tmp_path: Path, **options: object) -> dict[str, str]:
    """The questions of an intake without an answer, by option, with the line that answers each."""
    with pytest.raises(InputError) as refused:
        bt.init_dataset(recorded, tmp_path / "made", given={"subject": "s1", **FACTS}, **options)
    assert not (tmp_path / "made").exists()
    return {problem.file: f"{problem.expected} | {problem.remedy}" for problem in refused.value.problems}


@pytest.mark.parametrize("unit", ["V", "N"])
def test_g_is_no_unit_of_volts_or_newtons(unit: str, tmp_path: Path) -> None:
    said = asked(folder(tmp_path, **{f"Ch__{unit}": value()}), tmp_path)["--unit"]
    assert f"the files state {unit}: give --scale too" in said
    assert "--unit m/s^2" in said.partition("|")[2]


def test_a_deceleration_in_millimetres_is_refused(tmp_path: Path) -> None:
    recorded = folder(tmp_path, z__mm=value())
    with pytest.raises(InputError, match=r"found .deceleration.*a channel in mm.*--quantity displacement"):
        bt.init_dataset(recorded, tmp_path / "made", quantity="deceleration")
    assert "displacement" in asked(recorded, tmp_path, scale=9.8)["--quantity"]


def test_channels_whose_unit_can_not_be_right_are_not_offered(tmp_path: Path) -> None:
    beside = {"Force__N": value(), "Temperature__°C": value(1)}
    recorded = folder(tmp_path, **beside, ax__g=value(2), az__g=value(3))
    said = asked(recorded, tmp_path)["--channel"]
    assert "ax [g] or az [g]" in said
    recorded.rename(tmp_path / "before")
    several = asked(folder(tmp_path, z__mm=value(), a__g=value(1)), tmp_path)
    assert "displacement" in several["--quantity"]
    assert "--scale" not in several["--unit"]
    assert "Force" not in said


def test_the_beginning_of_a_name_is_enough_where_no_other_begins_so(tmp_path: Path) -> None:
    recorded = folder(tmp_path, Impact__g=value() / 9.80665, Input__g=value(1))
    how = {"given": {"subject": "s1", **FACTS}, "quantity": "deceleration"}
    with pytest.raises(InputError, match="a channel of the files"):
        bt.init_dataset(recorded, tmp_path / "a", channel="i", **how)
    data = bt.init_dataset(recorded, tmp_path / "b", channel="imp", time="time", **how)
    np.testing.assert_allclose(data.traces[0].value, value(), rtol=1e-9)


def test_files_that_the_pattern_does_not_name_are_passed_over_and_said(tmp_path: Path) -> None:
    recorded = tmp_path / "phone"
    for number in (1, 2):
        trial = recorded / f"s1_{number}"
        (trial / "meta").mkdir(parents=True)
        cells = pd.DataFrame({"Time (s)": TIME, "a (m/s^2)": value(number)})
        cells.to_csv(trial / "Raw Data.csv", index=False)
        (trial / "meta" / "device.csv").write_text("property,value\nmodel,Phone\nversion,1.2\n")
    how = {"pattern": "{subject}_{n}/Raw Data.csv", "given": FACTS, "quantity": "deceleration"}
    data = bt.init_dataset(recorded, tmp_path / "made", **how)
    assert len(data.impacts) == 2
    page = (tmp_path / "made" / "init.html").read_text()
    assert "files that --pattern does not name" in page
    # A recording whose name is misspelt is none of them.
    (recorded / "s1_1" / "Raw Data.csv").rename(recorded / "s1_1" / "RawData.csv")
    with pytest.raises(InputError, match="a name like"):
        bt.init_dataset(recorded, tmp_path / "more", **how)
