"""Folders of text files from spreadsheets and loggers of any country become datasets in one command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from command_line import Outcome, init
from country import GERMAN, PLAIN, facts, recordings
from dataset_bench import deceleration

FACTS = {"subject": "s", "trial": "x", "mass_kg": 0.5, "velocity_m_s": 1.2}
WRITTEN = "cp1252, a semicolon between cells, a decimal comma, names in row 4, units in row 5"


def made_of(folder: Path, *more: str, **given: object) -> tuple[Path, Outcome]:
    out = folder.with_name(f"{folder.name}-dataset")
    return out, init(folder, out, *more, **given)


@pytest.mark.slow
def test_files_of_a_german_excel_are_read_as_plain_ones(tmp_path: Path) -> None:
    found = []
    for name, country in (("en", PLAIN), ("de", GERMAN)):
        facts(tmp_path / f"{name}.csv", country, recordings(tmp_path / name, country, people=2))
        out, made = made_of(tmp_path / name, table=tmp_path / f"{name}.csv")
        assert (made.status, made.err) == (0, "")
        found.append(bt.read_dataset(out))
    assert f"texts read as: {WRITTEN}" in made.out
    assert "texts read as: de.csv: cp1252, a semicolon between cells, a decimal comma" in made.out
    plain, german = found
    pd.testing.assert_frame_equal(german.impacts, plain.impacts)
    for one, other in zip(german.traces, plain.traces, strict=True):
        np.testing.assert_array_equal(one.value, other.value)


def test_a_way_of_writing_can_be_given(tmp_path: Path) -> None:
    """Numbers of three decimals, as whole ones with a mark between thousands are written too."""
    (folder := tmp_path / "de").mkdir()
    time, value = deceleration(0.5, 1.2)
    text = "\n".join(f"{t:.4f};{v:.0f}".replace(".", ",") for t, v in zip(time, value, strict=True))
    (folder / "a.txt").write_text(f"{text}\n")
    said = {"channel": "column 2", "time": "column 1", "unit": "m/s^2"}
    facts = FACTS | {"mass_kg": "0,5", "velocity_m_s": "1,2"}
    out, made = made_of(folder, set=facts, text={"decimal": "comma", "thousands": "point"}, **said)
    assert made.status == 0, made.err
    assert "a point between thousands, no names of columns" in made.out
    assert 'decimal = "comma"' in (out / "dataset.toml").read_text()
    np.testing.assert_array_equal(bt.read_dataset(out).traces[0].value, value.round(0))
    _, refused = made_of(folder, text={"decimal": "semicolon"})
    assert refused.status == 2
    assert '--text, column decimal: found "semicolon"' in refused.err


def test_a_folder_without_values_says_so(tmp_path: Path) -> None:
    (folder := tmp_path / "times").mkdir()
    for name in "abc":
        rows = "".join(f"{n / 1000};kein Wert\n" for n in range(50))
        (folder / f"{name}.csv").write_text(f"Zeit;Wert\n{rows}")
    _, refused = made_of(folder)
    assert refused.status == 2
    assert "all 3 files, such as a.csv: found" in refused.err
    assert "expected a channel of numbers besides the times" in refused.err
