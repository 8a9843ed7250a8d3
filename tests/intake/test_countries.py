"""Folders of text files from spreadsheets and loggers of any country become datasets in one command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from command_line import Outcome, init
from country import GERMAN, PLAIN, Country, facts, recordings
from dataset_bench import DAMPING, STIFFNESS, deceleration
from recorder_files import xlsx

FACTS = {"subject": "s", "trial": "x", "mass_kg": 0.5, "velocity_m_s": 1.2}
WRITTEN = "cp1252, a semicolon between cells, a decimal comma, names in row 4, units in row 5"


def made_of(folder: Path, *more: str, **given: object) -> tuple[Path, Outcome]:
    out = folder.with_name(f"{folder.name}-dataset")
    return out, init(folder, out, *more, **given)


@pytest.mark.slow
def test_sixty_files_of_a_german_excel(tmp_path: Path) -> None:
    facts(tmp_path / "info.csv", GERMAN, recordings(tmp_path / "de", GERMAN))
    out, made = made_of(tmp_path / "de", table=tmp_path / "info.csv")
    assert (made.status, made.err) == (0, "")
    assert f"texts read as: {WRITTEN}" in made.out
    assert "dataset: fine" in made.out
    assert "texts read as: info.csv: cp1252, a semicolon between cells, a decimal comma" in made.out
    assert WRITTEN in (out / "init.html").read_text()
    data = bt.read_dataset(out)
    assert len(data.impacts) == 60
    assert data.impacts["subject"].iloc[0] == "Müller 1"


@pytest.mark.slow
def test_their_estimates_are_those_of_plain_files(tmp_path: Path) -> None:
    tables = []
    for name, country in (("de", GERMAN), ("en", PLAIN)):
        facts(tmp_path / f"{name}.csv", country, recordings(tmp_path / name, country, people=2))
        out, _ = made_of(tmp_path / name, table=tmp_path / f"{name}.csv")
        # As a person may write it by hand.
        impacts = pd.read_csv(out / "impacts.csv")
        separated = {"sep": country.delimiter, "decimal": country.decimal, "encoding": country.encoding}
        impacts.to_csv(out / "impacts.csv", index=False, **separated)
        tables.append(bt.estimate(bt.read_dataset(out)))
    german, plain = tables
    pd.testing.assert_frame_equal(german, plain, check_exact=True)
    for name, true in (("K", STIFFNESS), ("C", DAMPING)):
        unit = "N_per_m" if name == "K" else "N_s_per_m"
        low, high = (plain[f"{name}_{end}_{unit}"] for end in ("low", "high"))
        # Half of a 90 % interval is 1.645 standard deviations; none of eight is off by four.
        assert (np.abs(plain[f"{name}_{unit}"] - true) < 4 / (2 * 1.645) * (high - low)).all()


def test_one_table_of_all_samples(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text(
        'name = "x"\n[signal]\nquantity = "deceleration"\nunit = "m/s^2"\n'
    )
    time, value = deceleration(0.5, 1.2)
    rows = [["a", GERMAN.number(t, 4), GERMAN.number(v, 4)] for t, v in zip(time, value, strict=True)]
    above = Country("utf-16", "\t", ",", ("Prüfstand",), units=False)
    (tmp_path / "traces.csv").write_bytes(above.table(["impact", "time_s", "value"], rows))
    facts = [["a", "s1", "drop", "0,5", "1,2"]]
    names = ["impact", "subject", "trial", "mass_kg", "velocity_m_s"]
    (tmp_path / "impacts.csv").write_bytes(GERMAN.table(names, facts))
    data = bt.read_dataset(tmp_path)
    np.testing.assert_array_equal(data.traces[0].value, value)
    assert data.impacts["mass_kg"].tolist() == [0.5]
    rows[9][2] = "kaputt"
    (tmp_path / "traces.csv").write_bytes(above.table(["impact", "time_s", "value"], rows))
    with pytest.raises(InputError, match=r"traces\.csv, row 12, column value, impact a: found \"kaputt\""):
        bt.read_dataset(tmp_path)


def test_a_workbook_of_facts_and_one_of_all_samples(tmp_path: Path) -> None:
    rows = recordings(tmp_path / "de", GERMAN, people=1)
    numbers = ("mass_kg", "velocity_m_s")
    plain = [
        [float(cell.replace(",", ".")) if name in numbers else cell for name, cell in row.items()]
        for row in rows
    ]
    xlsx(tmp_path / "info.xlsx", [["Studie 7"], list(rows[0]), *plain])
    out, made = made_of(tmp_path / "de", table=tmp_path / "info.xlsx")
    assert (made.status, made.err) == (0, "")
    data = bt.read_dataset(out)
    assert data.impacts["mass_kg"].tolist() == [float(row["mass_kg"].replace(",", ".")) for row in rows]
    impacts = pd.read_csv(out / "impacts.csv").drop(columns="trace")
    impacts.to_csv(out / "impacts.csv", index=False)
    cells = [list(impacts), *impacts.to_numpy(object).tolist()]
    xlsx(out / "impacts.xlsx", cells)
    with pytest.raises(InputError, match=r'impacts\.xlsx: found "both"'):
        bt.read_dataset(out)
    (out / "impacts.csv").unlink()
    samples = [
        [impact, 1e3 * time, value]
        for impact, trace in zip(data.impacts["impact"], data.traces, strict=True)
        for time, value in zip(trace.time_s.tolist(), trace.value.tolist(), strict=True)
    ]
    xlsx(out / "traces.xlsx", [["impact", "Zeit", "Verzögerung"], *samples])
    for one, other in zip(data.traces, bt.read_dataset(out).traces, strict=True):
        np.testing.assert_array_equal(one.value, other.value)
    pd.testing.assert_frame_equal(bt.read_dataset(out).impacts, data.impacts.drop(columns="trace"))
    cells[2][cells[0].index("mass_kg")] = -0.5
    xlsx(out / "impacts.xlsx", cells)
    with pytest.raises(InputError, match=r"impacts\.xlsx, row 3, column mass_kg"):
        bt.read_dataset(out)


def test_columns_of_several_lengths(tmp_path: Path) -> None:
    """Two channels with times of their own, as a recorder of two rates exports them."""
    folder = tmp_path / "rates"
    folder.mkdir()
    time, value = deceleration(0.5, 1.2)
    slow, force = time[::4], 2 * value[::4]
    cells = pd.DataFrame({"Zeit 1": time, "a": value}).join(pd.DataFrame({"t2": slow, "F": force}))
    cells.to_csv(folder / "a.csv", index=False, sep=";", decimal=",")
    for channel, clock, expected, scale in (("a", "Zeit 1", value, 1.0), ("F", "t2", force, 0.5)):
        said = {"channel": channel, "time": clock, "unit": "m/s^2", "scale": scale, "set": FACTS}
        out, made = made_of(folder, "--overwrite", **said)
        assert made.status == 0, made.err
        np.testing.assert_array_equal(bt.read_dataset(out).traces[0].value, scale * expected)


def test_what_is_wrong_with_all_files_is_one_problem(tmp_path: Path) -> None:
    """Decimal commas between which commas separate: no program can tell, and one sentence says so."""
    recordings(tmp_path / "de", Country(delimiter=",", decimal=","), people=2)
    _, refused = made_of(tmp_path / "de", set={"trial": "drop"})
    assert refused.status == 2
    lines = refused.err.splitlines()
    assert lines[0] == "1 problem; nothing was written."
    assert lines[1].startswith("  all 8 files, such as Müller1_links_1.csv, row 2: found")
    assert "399 more rows are like this" in lines[1]


def test_a_way_of_writing_can_be_given(tmp_path: Path) -> None:
    """Numbers of three decimals, as whole ones with a mark between thousands are written too."""
    folder = tmp_path / "de"
    folder.mkdir()
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


def test_a_file_without_names_is_asked_for_by_number(tmp_path: Path) -> None:
    folder = tmp_path / "plain"
    folder.mkdir()
    time, value = deceleration(0.5, 1.2)
    np.savetxt(folder / "a.csv", np.column_stack([time, value, 2 * value]), delimiter=",")
    _, refused = made_of(folder)
    assert 'found "none"; expected the channel with the impact: column 2 or column 3' in refused.err
    assert 'Add, say, --channel "column 2"' in refused.err


def test_a_folder_without_values_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "times"
    folder.mkdir()
    for name in "abc":
        rows = "".join(f"{n / 1000};kein Wert\n" for n in range(50))
        (folder / f"{name}.csv").write_text(f"Zeit;Wert\n{rows}")
    _, refused = made_of(folder)
    assert refused.status == 2
    assert "all 3 files, such as a.csv: found" in refused.err
    assert "expected a channel of numbers besides the times" in refused.err


@pytest.mark.slow
def test_remedies_name_options(tmp_path: Path) -> None:
    """Who runs `init` has no dataset.toml yet."""
    recordings(tmp_path / "en", PLAIN, people=1)
    _, refused = made_of(tmp_path / "en", time_unit="us", set=FACTS)
    assert refused.status == 2
    assert "Check --time-unit, and sampling_rate_hz" in refused.err
    assert "dataset.toml" not in refused.err
