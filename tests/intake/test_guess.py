"""Patterns guessed from the names of recordings, and what init shows and writes without options."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.resources import shared
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake import choices_of
from bayestissue.recordings.intake.folder import RecorderFile
from bayestissue.recordings.intake.names import contradictions, guessed
from bayestissue.studies.init import prepare
from command_line import bayestissue

RECORDED = shared("data", "tutorial", "recorded")


def named(name: str) -> RecorderFile:
    return RecorderFile(Source(Path(name), name), {})


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        ("p1_operated_0.5kg p1_sound_0.5kg p2_sound_1.0kg", "{subject}_{side}_{mass_kg}kg"),
        ("anna-links-500g-1 anna-rechts-500g-2 bert-links-700g-1", "{subject}-{side}-{mass_g}g-{n}"),
        ("01_1 01_2 02_1", "{subject}_{n}"),
        ("s01_day1_left_0.5kg_r1 s01_day2_right_0.5kg_r2", "{subject}_day{session}_{side}_{mass_kg}kg_r{n}"),
        # Of one person, or of none who comes twice, what has a unit is still what it is.
        ("p1_0.5kg p1_1.0kg", "{subject}_{mass_kg}kg"),
        ("p1_0.5kg", "{subject}_{mass_kg}kg"),
        ("p1_1 p1_2", "{subject}_{n}"),
        ("drop_0.5kg drop_1.0kg", "drop_{mass_kg}kg"),
        ("rec1_0.5kg rec2_0.5kg", "{}_{mass_kg}kg"),
        ("p1_0.5kg_12cm p2_0.5kg_12cm", "{}_{mass_kg}kg_{drop_height_cm}cm"),
        (
            "s01_day1_left_0.5kg_r1 s01_day2_right_0.5kg_r2 s02_day2_right_0.5kg_r2",
            "{subject}_day{session}_{side}_{mass_kg}kg_r{n}",
        ),
        ("exp/max/L1 exp/max/R1 exp/eva/L2", "exp/{subject}/{group}"),
        ("s1_12cm_soft s1_15cm_hard s2_15cm_hard", "{subject}_{drop_height_cm}cm_{group}"),
        # A person each, or a count: it can't be told.
        ("rec1 rec2 rec3", None),
        ("a b_c", None),
        ("only_one", None),
    ],
)
def test_a_pattern_is_what_names_look_like(names: str, pattern: str | None) -> None:
    files = [named(f"{name}.csv") for name in names.split()]
    assert guessed(files) == pattern


def test_what_is_given_otherwise_does_not_matter_in_names() -> None:
    files = [named(f"p{n}_{s}_500g.csv") for n in (1, 2) for s in "lr"]
    assert guessed(files, {"mass_kg", "side"}) == "{subject}_{}_{}g"


def test_of_one_person_masses_in_names_are_read(tmp_path: Path) -> None:
    for path in RECORDED.glob("p1_*"):
        shutil.copyfile(path, tmp_path / path.name)
    data = bt.init_dataset(tmp_path, tmp_path / "d", quantity="deceleration", given={"velocity_m_s": 1.5})
    assert sorted(set(data.impacts["mass_kg"])) == [0.5, 1.0]
    assert set(data.impacts["subject"]) == {"p1"}
    given = {"velocity_m_s": 1.5, "subject": "Anna"}
    data = bt.init_dataset(tmp_path, tmp_path / "e", quantity="deceleration", given=given)
    assert sorted(set(data.impacts["mass_kg"])) == [0.5, 1.0]
    assert set(data.impacts["subject"]) == {"Anna"}


@pytest.mark.parametrize(
    ("names", "given", "found"),
    [
        ("p1_0.5kg p1_1.0kg", {"mass_kg": "0.5"}, [("p1_1.0kg.csv", "mass_kg = 0.5", "1.0kg")]),
        ("p1_500g p1_left_1200g", {"mass_kg": "0.5"}, [("p1_left_1200g.csv", "mass_kg = 0.5", "1200g")]),
        ("p1_0.5kg p1_1.0kg", {"mass_g": "500"}, [("p1_1.0kg.csv", "mass_g = 500", "1.0kg")]),
        ("p1_12cm", {"drop_height_m": "0.15"}, [("p1_12cm.csv", "drop_height_m = 0.15", "12cm")]),
        ("p1_1.5mps", {"velocity_m_s": "2"}, [("p1_1.5mps.csv", "velocity_m_s = 2", "1.5mps")]),
        ("p1_L p1_R", {"side": "left"}, [("p1_R.csv", "side = left", "R")]),
        ("p1_0.5kg p1_0,5kg", {"mass_g": "500"}, []),
        # A velocity that was measured is no contradiction to a height, nor one of another kind of side.
        ("p1_12cm", {"velocity_m_s": "1.5"}, []),
        ("p1_r", {"side": "operated"}, []),
    ],
)
def test_what_a_name_says_otherwise_is_told_with_both(names: str, given: dict[str, str], found: list) -> None:
    files = [named(f"{name}.csv") for name in names.split()]
    problems = [problem for file in files for problem in contradictions(file, given)]
    assert [(p.file, p.value, p.expected.split('"')[1]) for p in problems] == found


def test_a_set_fact_or_a_row_that_contradicts_a_name_is_refused(tmp_path: Path) -> None:
    recorded = tmp_path / "r"
    recorded.mkdir()
    for path in RECORDED.glob("p1_*"):
        shutil.copyfile(path, recorded / path.name)
    usual = (
        "init",
        recorded,
        "--out",
        tmp_path / "d",
        "--quantity",
        "deceleration",
        "--set",
        "velocity_m_s=1.5",
    )
    masses = "".join(f"{path.name},0.5\n" for path in recorded.iterdir())
    (tmp_path / "info.csv").write_text(f"file,mass_kg\n{masses}")
    for more in (("--set", "mass_kg=0.5"), ("--table", tmp_path / "info.csv")):
        refused = bayestissue(*usual, "--set", "subject=p1", *more)
        assert refused.status == 2
        assert 'found "mass_kg = 0.5"; expected what the name says: "1.0kg"' in refused.err
        assert not (tmp_path / "d").exists()
    # Who says how names are read has said that this part does not matter.
    made = bayestissue(*usual, "--set", "mass_kg=0.5", "--pattern", "{subject}_{side}_{}kg")
    assert made.status == 0, made.err


def test_without_options_init_says_what_it_understood_and_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = bayestissue("init", RECORDED)
    assert found.status == 2
    assert "Names read as {subject}_{side}_{mass_kg}kg, a guess; --pattern takes another:" in found.err
    assert "subject: 6, p1 (4), p2 (4)" in found.err
    assert "mass_kg: 2, 0.5 (12), 1 (12)" in found.err
    assert "recordings of each combination: 1" in found.err
    assert "with your own values: --quantity deceleration --set velocity_m_s=1.5\n" in found.err
    assert not any(tmp_path.iterdir())


def test_what_is_left_out_has_a_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    asked = ["--quantity", "deceleration", "--set", "velocity_m_s=1.534", "--uncertainty", "velocity=0.01"]
    made = bayestissue("init", RECORDED, *asked)
    assert made.status == 0, made.err
    folder = tmp_path / "recorded-dataset"
    settings = tomllib.loads((folder / "dataset.toml").read_text())
    assert settings["name"] == "recorded-dataset"
    assert settings["uncertainty"] == {"velocity_sd_m_s": 0.01}
    assert "Before a fit" not in made.out
    data = bt.read_dataset(folder)
    assert set(data.impacts["trial"]) == {"0.5 kg", "1 kg"}
    # As many digits as two samples in the time to peak are worth.
    assert "15.5 to 30.3 ms" in made.out


def test_a_table_for_the_uncertainty_waits_where_none_was_stated(tmp_path: Path) -> None:
    bt.init_dataset(RECORDED, tmp_path / "d", quantity="deceleration", given={"velocity_m_s": 1.5})
    text = (tmp_path / "d" / "dataset.toml").read_text()
    rows = text[text.index("# [uncertainty]") :].splitlines()
    assert (
        tomllib.loads("\n".join(row.removeprefix("# ") for row in rows))["uncertainty"]["velocity_sd_m_s"]
        == 0.01
    )


def test_a_pattern_where_a_person_is_asked_for_is_one(tmp_path: Path) -> None:
    for number, path in enumerate(sorted(RECORDED.iterdir())[:3]):
        shutil.copyfile(path, tmp_path / f"rec{number}.lvm")
    intake = prepare(
        tmp_path, choices_of(quantity="deceleration", given={"velocity_m_s": "1", "mass_kg": "1"})
    )
    (question,) = intake.questions
    assert question.option == "--set subject="
    assert intake.answered(question, "{subject}.lvm").questions == ()


@pytest.mark.parametrize(
    ("mass", "velocity", "names"),
    [
        ([1, 1, 1, 1], [2, 2, 2, 2], ["all"] * 4),
        ([1, 1, 2, 2], [2, 2, 2, 2], ["1 kg", "1 kg", "2 kg", "2 kg"]),
        ([1, 1, 2, 2], [3, 3, 2, 2], ["1 kg, 3 m/s", "1 kg, 3 m/s", "2 kg, 2 m/s", "2 kg, 2 m/s"]),
        # Measured each by itself, a velocity is no condition.
        ([1, 1, 2, 2], [2.1, 2.2, 2.3, 2.4], ["1 kg", "1 kg", "2 kg", "2 kg"]),
    ],
)
def test_a_condition_that_is_left_out_is_a_mass_and_velocity(mass, velocity, names) -> None:
    table = pd.DataFrame({"impact": list("abcd"), "subject": "s", "mass_kg": mass, "velocity_m_s": velocity})
    t = np.arange(100) / 1e3
    traces = [(t, 50 * np.sin(np.pi * t / 0.1))] * 4
    assert bt.dataset(table, traces, quantity="deceleration", unit="m/s^2").impacts["trial"].tolist() == names


def six_people(folder: Path) -> Path:
    """Recordings of three people in each of two groups, numbered anew in each, twice each."""
    for group in ("treated", "control"):
        (folder / group).mkdir(parents=True)
        for number, path in enumerate(sorted(RECORDED.iterdir())[:6]):
            shutil.copyfile(path, folder / group / f"{number // 2 + 1}_{number % 2 + 1}.lvm")
    return folder


@pytest.mark.parametrize("pattern", [None, "{group}/{subject}_{n}"])
def test_people_numbered_anew_in_each_group_are_asked_about(tmp_path: Path, pattern: str | None) -> None:
    said = {"mass_kg": "1", "velocity_m_s": "1"}
    choices = choices_of(quantity="deceleration", pattern=pattern, given=said, unit="m/s^2")
    intake = prepare(six_people(tmp_path / "r"), choices)
    (question,) = intake.questions
    assert "1 is in control and in treated: one person or two?" in question.wording
    one, two = question.answers
    assert (one, two) == ("{condition}/{subject}_{n}", "{group}/{subject:group}_{n}")
    for answer, people in ((one, 3), (two, 6)):
        answered = intake.answered(question, answer)
        assert answered.questions == ()
        assert len({row["subject"] for row in answered.facts.of_file.values()}) == people


def test_people_numbered_anew_are_joined_with_a_table_by_group_and_number(tmp_path: Path) -> None:
    table = tmp_path / "people.csv"
    rows = [
        f"{g},{n},{w}" for w, (g, n) in enumerate((g, n) for g in ("treated", "control") for n in (1, 2, 3))
    ]
    table.write_text("group,subject,who\n" + "\n".join(rows))
    pattern = "{group}/{subject:group}_{n}"
    intake = prepare(
        six_people(tmp_path / "r"), choices_of(quantity="deceleration", pattern=pattern, table=table)
    )
    who = {(row["subject"], row["who"]) for row in intake.facts.of_file.values()}
    assert who == {(f"{g}-{n}", str(i)) for i, (g, n, _) in enumerate(row.split(",") for row in rows)}


@pytest.mark.parametrize(
    ("head", "people"),
    [
        ("file,Patient", 6),
        ("file,Subject", 6),
        ("file,PATIENT_ID", 6),
        ("file,who", None),
        ("file,subject", 6),
    ],
)
def test_a_table_says_who_was_hit_in_whatever_case(tmp_path: Path, head: str, people: int | None) -> None:
    lines = [head]
    for number, path in enumerate(sorted(RECORDED.iterdir())[:6]):
        shutil.copyfile(path, tmp_path / f"rec_{number}.lvm")
        lines.append(f"rec_{number}.lvm,p{number}")
    table = tmp_path / "facts.csv"
    table.write_text("\n".join(lines))
    said = {"mass_kg": "1", "velocity_m_s": "1"}
    intake = prepare(tmp_path, choices_of(quantity="deceleration", table=table, given=said))
    if people is None:
        (question,) = intake.questions
        assert "--set" not in question.line
    else:
        assert intake.questions == ()
        assert len({row["subject"] for row in intake.facts.of_file.values()}) == people


def test_a_velocity_may_stand_beside_its_height_in_a_table_of_whatever_case(tmp_path: Path) -> None:
    """The velocity is what counts; that the two contradict each other is told of the dataset, with both."""
    lines = ["File,Subject,Mass_kg,Drop_height_cm,Velocity_m_s"]
    for number, path in enumerate(sorted(RECORDED.iterdir())[:2]):
        shutil.copyfile(path, tmp_path / f"rec_{number}.lvm")
        lines.append(f"rec_{number}.lvm,p{number},1,{(12, 20)[number]},1.53414")
    table = tmp_path / "facts.csv"
    table.write_text("\n".join(lines))
    intake = prepare(tmp_path, choices_of(quantity="deceleration", table=table, gravity="drop"))
    assert intake.questions == ()
    rows = [(row["velocity_m_s"], row["drop_height_cm"]) for row in intake.facts.of_file.values()]
    assert rows == [(1.53414, 12.0), (1.53414, 20.0)]


def test_a_table_that_does_not_say_who_was_hit_leaves_it_to_the_names(tmp_path: Path) -> None:
    files = sorted(RECORDED.iterdir())
    table = tmp_path / "facts.csv"
    table.write_text("file,mass_kg\n" + "\n".join(f"{path.name},1" for path in files if "1.0kg" in path.name))
    recorded = tmp_path / "r"
    recorded.mkdir()
    for path in files:
        if "1.0kg" in path.name:
            shutil.copyfile(path, recorded / path.name)
    intake = prepare(recorded, choices_of(quantity="deceleration", table=table, given={"velocity_m_s": "1"}))
    assert intake.questions == ()
    assert {row["subject"] for row in intake.facts.of_file.values()} == {f"p{n}" for n in range(1, 7)}
