"""From a folder of recorder files to a dataset that `check` calls fine."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import typer
from nptdms import ChannelObject, TdmsWriter

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.commands import init_command as command
from bayestissue.recordings.dataset import LowPassFilter
from bayestissue.recordings.dataset.left_out import reasons
from cases import cases
from command_line import bayestissue, init
from dataset_bench import RATE, deceleration
from page_reader import figures
from recorder_files import acq, c3d, lvm

PATTERN = "{subject}_{side}_{mass_kg}kg_{n}"
VELOCITY = 1.2
HEIGHT_CM = 1e2 * VELOCITY**2 / (2 * 9.80665)
DROPS = [
    (s, side, m, n) for s in ("s01", "s02") for side in ("left", "right") for m, n in ((0.5, 1), (1.2, 2))
]
FACTS = {"trial": "drop", "velocity_m_s": VELOCITY}


def trace(which: int) -> tuple[np.ndarray, np.ndarray]:
    """The deceleration of one drop, m/s², with noise of its own."""
    _, _, mass, _ = DROPS[which]
    return deceleration(mass * (1 + 0.001 * which), VELOCITY)


def name(which: int) -> str:
    subject, side, mass, number = DROPS[which]
    return f"{subject}_{side}_{mass}kg_{number}"


def write_lvm(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    lvm(path, time, {"Force": 2 * value, "Impact": value})


def write_tdms(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    clock = {"wf_increment": 1 / RATE, "wf_start_offset": float(time[0]), "unit_string": "m/s^2"}
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("Drop", "Impact", value, properties=clock)])


def write_c3d(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    c3d(path, {"Fz": 3 * value, "Impact": value}, RATE, {"Fz": "N", "Impact": "m/s^2"}, points=2)


def write_csv(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    pd.DataFrame({"Time (ms)": 1e3 * time, "Impact (g)": value / 9.80665}).to_csv(path, index=False)


def write_acq(path: Path, time: np.ndarray, value: np.ndarray) -> None:
    acq(path, {"ECG": 0 * value, "Impact": value}, RATE, {"ECG": "mV", "Impact": "m/s^2"})


FORMATS = {
    ".lvm": (write_lvm, {"channel": "Impact"}),
    ".tdms": (write_tdms, {}),
    ".c3d": (write_c3d, {"channel": "Impact"}),
    ".csv": (write_csv, {}),
    ".acq": (write_acq, {"channel": "Impact"}),
}


@pytest.fixture
def folder(tmp_path: Path) -> Callable[[str], Path]:
    def filled(suffix: str) -> Path:
        made = tmp_path / "recorded"
        made.mkdir(exist_ok=True)
        for which in range(len(DROPS)):
            FORMATS[suffix][0](made / f"{name(which)}{suffix}", *trace(which))
        return made

    return filled


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.slow
@pytest.mark.parametrize("suffix", FORMATS)
def test_a_folder_becomes_a_dataset_that_check_calls_fine(
    suffix: str, folder: Callable, tmp_path: Path
) -> None:
    recorded, out = folder(suffix), tmp_path / "drops"
    before = contents(recorded)
    made = init(recorded, out, pattern=f"{PATTERN}{suffix}", set=FACTS, json=True, **FORMATS[suffix][1])
    assert (made.status, made.err) == (0, "")
    # The plate's force is as large with every mass, which no force is.
    verdict = "no errors, 1 warning" if suffix == ".c3d" else "fine"
    assert json.loads(made.out)["verdict"] == verdict
    checked = json.loads(bayestissue("check", out, "--json").out)
    assert (checked["verdict"], checked["impacts"]) == (verdict, len(DROPS))
    data = bt.read_dataset(out)
    assert list(data.impacts["impact"]) == sorted(name(which) for which in range(len(DROPS)))
    assert set(zip(data.impacts["subject"], data.impacts["side"], data.impacts["mass_kg"], strict=True)) == {
        drop[:3] for drop in DROPS
    }
    for impact, found in zip(data.impacts["impact"], data.traces, strict=True):
        time, value = trace([name(which) for which in range(len(DROPS))].index(impact))
        # C3D keeps four bytes of a number up to 100; the others lose a rounding or two in units.
        np.testing.assert_allclose(found.value, value, rtol=0, atol=4e-6 if suffix == ".c3d" else 1e-13)
        np.testing.assert_allclose(found.time_s - found.time_s[0], time - time[0], rtol=0, atol=1e-14)
    assert contents(recorded) == before
    assert {f"{file}" for file in contents(out / "recordings")} == set(before)
    page = (out / "init.html").read_text()
    assert len(figures(page)) == 1
    assert "deceleration, channel Impact" in page


def test_at_a_terminal_it_asks(folder: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    answers = ["nonsense", "Impact", "deceleration", str(VELOCITY)]

    def prompt(words: str, **_: object) -> str:
        asked.append(words)
        return answers[len(asked) - 1]

    monkeypatch.setattr(typer, "prompt", prompt)
    monkeypatch.setattr(typer, "confirm", lambda *_, **__: True)
    monkeypatch.setattr(command, "_at_a_terminal", lambda: True)
    made = bayestissue("init", folder(".lvm"), "--out", tmp_path / "drops", "--pattern", f"{PATTERN}.lvm")
    assert made.status == 0
    assert len(asked) == len(answers)
    assert "The channel with the impact (Force, Impact)" in asked[:2]
    assert (
        "The same without questions: --channel Impact --quantity deceleration --set velocity_m_s=" in made.err
    )


def facts(**columns: object) -> pd.DataFrame:
    rows = pd.DataFrame(DROPS, columns=["subject", "side", "mass_kg", "number"])
    rows = rows.assign(file=[name(which) for which in rows.index], trial=rows["mass_kg"].map("{} kg".format))
    rows = rows.assign(mass_g=1e3 * rows["mass_kg"], drop_height_cm=HEIGHT_CM)
    return rows.drop(columns=["mass_kg", "number"]).assign(**columns)


def test_a_table_says_what_names_do_not(folder: Callable, tmp_path: Path) -> None:
    recorded = folder(".tdms")
    # In the folder itself it is no recording, though its name ends like one.
    facts().to_csv(recorded / "info.csv", index=False)
    given = {"quantity": "deceleration", "table": recorded / "info.csv"}
    with pytest.raises(InputError, match=r"--gravity.*straight down"):
        bt.init_dataset(recorded, tmp_path / "drops", **given)
    data = bt.init_dataset(recorded, tmp_path / "drops", **given, name="Drops", gravity="none")
    assert data.name == "Drops"
    # Twelve digits of the velocity are kept.
    np.testing.assert_allclose(data.impacts["velocity_m_s"], VELOCITY, rtol=1e-11)
    assert sorted(data.impacts["mass_kg"].unique()) == [0.5, 1.2]
    assert set(data.impacts["trial"]) == {"0.5 kg", "1.2 kg"}


def test_a_recording_without_a_row_may_be_left_out(folder: Callable, tmp_path: Path) -> None:
    facts().iloc[1:].to_csv(tmp_path / "info.csv", index=False)
    said = {"quantity": "deceleration", "table": tmp_path / "info.csv", "gravity": -0.5}
    data = bt.init_dataset(folder(".tdms"), tmp_path / "drops", **said, skip_bad=True)
    assert name(0) not in set(data.impacts["impact"])
    assert data.gravity == -0.5
    assert "-0.5 m/s², zero at free fall" in (tmp_path / "drops" / "init.html").read_text()
    assert len(data.impacts) == len(DROPS) - 1


def test_everything_that_is_wrong_is_said_at_once(folder: Callable, tmp_path: Path) -> None:
    recorded, out = folder(".tdms"), tmp_path / "drops"
    table = facts().astype(object)
    table.loc[0, "mass_g"] = "heavy"
    table.loc[1, "file"] = "nobody"
    table.loc[7, "drop_height_cm"] = -1
    table.to_csv(tmp_path / "info.csv", index=False)
    (recorded / f"{name(2)}.tdms").write_bytes(b"no TDMS file")
    time, value = trace(3)
    write_tdms(recorded / f"{name(3)}.tdms", time, -value)
    refused = init(recorded, out, table=tmp_path / "info.csv", gravity="none")
    assert refused.status == 2
    for said in (
        f'{name(0)}.tdms, column mass_g: found "heavy"',
        f'info.csv, column file: found "none"; expected a row for {name(1)}.tdms',
        'info.csv, row 3, column file: found "nobody: no such file"',
        f"{name(2)}.tdms",
        f"{name(3)}.tdms, column Impact, impact {name(3)}",
        f'{name(7)}.tdms, column drop_height_cm: found "-1',
    ):
        assert said in refused.err
    assert not out.exists()


def test_recordings_of_one_dataset_have_one_unit_and_the_channel(folder: Callable, tmp_path: Path) -> None:
    recorded, out = folder(".c3d"), tmp_path / "drops"
    c3d(recorded / f"{name(0)}.c3d", {"Impact": trace(0)[1] / 9.80665}, RATE, {"Impact": "g"})
    c3d(recorded / f"{name(1)}.c3d", {"Acc": trace(1)[1]}, RATE, {"Acc": "m/s^2"})
    said = {"quantity": "deceleration", "channel": "Impact", "unit": "m/s^2", "pattern": f"{PATTERN}.c3d"}
    with pytest.raises(InputError) as refused:
        bt.init_dataset(recorded, out, **said, given=FACTS)
    other_unit, no_channel = map(str, refused.value.problems)
    assert f'{name(0)}.c3d, column Impact: found "g"; expected the unit of the other recordings' in other_unit
    assert no_channel.endswith("a channel 'Impact'. Name one of the channels by --channel.")
    data = bt.init_dataset(recorded, out, **said, given=FACTS, skip_bad=True)
    assert len(data.impacts) == len(DROPS) - 2


@pytest.mark.slow
def test_what_is_wrong_may_be_left_out(folder: Callable, tmp_path: Path) -> None:
    recorded, out = folder(".tdms"), tmp_path / "drops"
    (recorded / f"{name(2)}.tdms").write_bytes(b"damaged")
    time, value = trace(3)
    write_tdms(recorded / f"{name(3)}.tdms", time, -value)
    made = init(recorded, out, pattern=f"{PATTERN}.tdms", set=FACTS, skip_bad=True)
    assert made.status == 0
    assert made.out.count("left out: ") == 2
    data = bt.read_dataset(out)
    assert set(data.impacts["impact"]) == {name(which) for which in range(len(DROPS))} - {name(2), name(3)}
    assert "Left out:" in (out / "init.html").read_text()
    # Whoever reads the dataset afterwards knows of them too.
    why = reasons(out)
    assert set(why) == {name(2), name(3)}
    assert why[name(3)].startswith("not in the dataset: the sign is the other way")
    assert "damaged" in why[name(2)]
    assert {problem.impact for problem in data.left_out} == set(why)
    assert data.warnings == ()


@pytest.mark.parametrize(("given", "says"), cases(__file__, "refused"))
def test_options_that_can_t_be_are_refused(
    given: dict[str, Any], says: str, folder: Callable, tmp_path: Path
) -> None:
    usual = {"pattern": f"{PATTERN}.tdms", "set": FACTS}
    refused = init(folder(".tdms"), tmp_path / "drops", **usual | given)
    assert (refused.status, says in refused.err) == (2, True), refused.err
    assert not (tmp_path / "drops").exists()


@pytest.mark.slow
def test_a_low_pass_is_declared_by_its_entries(folder: Callable, tmp_path: Path) -> None:
    recorded, said = folder(".tdms"), {"pattern": f"{PATTERN}.tdms", "set": FACTS}
    stated = {"low_pass_hz": 1500, "order": 4, "kind": "bessel", "zero_phase": True, "noise": "before"}
    made = init(recorded, tmp_path / "drops", **said, recorder=stated)
    assert made.status == 0
    expected = LowPassFilter.model_validate(stated)
    assert bt.read_dataset(tmp_path / "drops").recorder == expected
    page = (tmp_path / "drops" / "init.html").read_text()
    assert "low_pass_hz = 1500, order = 4, kind = bessel, zero_phase = True, noise = before" in page
    assert "noise entered" in made.out
    of_arrays = {"pattern": f"{PATTERN}.tdms", "quantity": "deceleration", "given": FACTS}
    data = bt.init_dataset(recorded, tmp_path / "again", **of_arrays, recorder=expected)
    assert data.recorder == expected


@pytest.mark.slow
def test_a_dataset_is_replaced_only_as_it_was_written(folder: Callable, tmp_path: Path) -> None:
    recorded, out = folder(".tdms"), tmp_path / "recorded" / "drops"
    again = {"pattern": f"{PATTERN}.tdms", "set": FACTS}
    assert init(recorded, out, **again).status == 0
    assert init(recorded, out, **again).status == 2
    # The dataset lies among the recordings and holds copies of them: it is not taken for more recordings.
    assert init(recorded, out, "--overwrite", **again).status == 0
    assert len(bt.read_dataset(out).impacts) == len(DROPS)
    (out / "impacts.csv").write_text((out / "impacts.csv").read_text().replace("drop", "fall"))
    assert "changed since it was written" in init(recorded, out, "--overwrite", **again).err


def sequence(path: Path, gap_s: float = 1.0) -> list[tuple[float, np.ndarray]]:
    """One recording of all drops, one after the other; of each when it begins and its samples."""
    step, quiet = 1 / RATE, np.random.default_rng(0).normal(0, 0.05, int(gap_s * RATE))
    pieces, begins, at = [], [], 0
    for which in range(len(DROPS)):
        _, value = trace(which)
        fading = value[-1] * np.exp(-np.arange(400) * step / 0.01)
        pieces += [np.roll(quiet, 37 * which), value, fading + quiet[:400]]
        begins.append(((at + quiet.size) * step, value))
        at += quiet.size + value.size + 400
    write_tdms(path, np.array([0.0]), np.concatenate([*pieces, quiet]))
    return begins


@pytest.mark.slow
def test_a_crop_is_kept_in_the_dataset(folder: Callable, tmp_path: Path) -> None:
    recorded, out = folder(".csv"), tmp_path / "drops"
    said = {"pattern": f"{PATTERN}.csv", "set": FACTS}
    assert init(recorded, out, "--crop", "-4", "34.95", **said).status == 0
    assert {trace.time_s.size for trace in bt.read_dataset(out).traces} == {390}
    assert "from -4 to 34.95" in (out / "init.html").read_text()
    assert init(recorded, out, "--overwrite", "--crop", "3", "2", **said).err.count("--crop") == 1


@pytest.mark.slow
def test_several_impacts_in_one_recording_are_cut_apart_as_many_as_the_table_has(tmp_path: Path) -> None:
    recorded, out = tmp_path / "recorded", tmp_path / "drops"
    recorded.mkdir()
    begins = sequence(recorded / "all.tdms")
    facts(file="all", number=range(1, len(DROPS) + 1)).to_csv(tmp_path / "info.csv", index=False)
    said = {"quantity": "deceleration", "table": tmp_path / "info.csv", "gravity": "none"}
    with pytest.raises(InputError, match=r"all\.tdms: found \"8 rows of the table\".*--several"):
        bt.init_dataset(recorded, out, **said)
    data = bt.init_dataset(recorded, out, **said, several=True)
    assert list(data.impacts["impact"]) == [f"all-{number}" for number in range(1, len(DROPS) + 1)]
    assert list(data.impacts["mass_kg"]) == [drop[2] for drop in DROPS]
    assert bayestissue("check", out, "--json").status == 0
    for (begin, value), found in zip(begins, data.traces, strict=True):
        first = int(np.argmin(np.abs(found.time_s - begin)))
        np.testing.assert_array_equal(found.value[first : first + value.size], value)
    # The dataset names stretches of the one recording, which is copied once.
    assert list(contents(out / "recordings")) == ["all.tdms"]
    facts(file="all", number=range(1, len(DROPS) + 1)).iloc[:5].to_csv(tmp_path / "info.csv", index=False)
    with pytest.raises(InputError, match=r"found \"8 impacts\"; expected 5 impacts, as many as the table"):
        bt.init_dataset(recorded, tmp_path / "fewer", **said, several=True)


def test_a_recording_that_seems_to_hold_several_is_named(tmp_path: Path) -> None:
    recorded = tmp_path / "recorded"
    recorded.mkdir()
    sequence(recorded / "s01.tdms")
    made = init(recorded, tmp_path / "drops", pattern="{subject}.tdms", set=FACTS | {"mass_kg": 0.5})
    # Eight impacts together lose more speed than one can have: refused, and with a way out.
    assert made.status == 2
    assert "--several" in made.err


def test_a_rate_in_the_table_stands_in_for_times(tmp_path: Path) -> None:
    (recorded := tmp_path / "recorded").mkdir()
    cells = pd.DataFrame({"Impact (m/s^2)": trace(0)[1]}).astype(object)
    cells.to_csv(recorded / f"{name(0)}.csv", index=False)
    facts().iloc[:1].to_csv(tmp_path / "info.csv", index=False)
    said = {"quantity": "deceleration", "table": tmp_path / "info.csv", "gravity": "none"}
    with pytest.raises(InputError, match="--rate-hz"):
        bt.init_dataset(recorded, tmp_path / "drops", **said)
    facts(sampling_rate_hz=RATE).iloc[:1].to_csv(tmp_path / "info.csv", index=False)
    data = bt.init_dataset(recorded, tmp_path / "drops", **said)
    np.testing.assert_allclose(np.diff(data.traces[0].time_s), 1 / RATE)
    cells.iloc[100] = "overload"
    cells.to_csv(recorded / f"{name(0)}.csv", index=False)
    with pytest.raises(InputError, match=r"found .no number at 1 of .*expected finite numbers"):
        bt.init_dataset(recorded, tmp_path / "more", **said, several=True)


def test_where_contact_falls_is_asked_where_recordings_begin_there(tmp_path: Path) -> None:
    """A note is all: nothing is refused that was taken before."""
    (recorded := tmp_path / "recorded").mkdir()
    for which in range(2):
        time, value = trace(which)
        write_csv(recorded / f"{name(which)}.csv", time[time >= 0], value[time >= 0])
    asked = init(recorded, tmp_path / "asked", pattern=PATTERN, set=FACTS)
    assert asked.status == 0
    assert "by --contact on_sample, of a recorder that contact triggers" in asked.out
    made = init(recorded, tmp_path / "made", pattern=PATTERN, set=FACTS, contact="between")
    assert "by --contact" not in made.out
    assert bt.read_dataset(tmp_path / "made").contact == "between"
