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
from cases import cases
from command_line import bayestissue, init

UNITS = {"mass_kg": "1", "velocity_m_s": "1"}
RECORDED = shared("data", "tutorial", "recorded")


def copied(folder: Path, *, only: str = "*", count: int = 99, name: str = "") -> list[Path]:
    """Some of the recordings in a folder, under their names or under others with a number."""
    folder.mkdir(exist_ok=True, parents=True)
    paths = sorted(RECORDED.glob(only))[:count]
    names = [name.format(number) if name else path.name for number, path in enumerate(paths)]
    return [Path(shutil.copyfile(path, folder / new)) for path, new in zip(paths, names, strict=True)]


def named(name: str) -> RecorderFile:
    return RecorderFile(Source(Path(name), name), {})


@pytest.mark.parametrize(("names", "pattern"), cases(__file__, "guessed"))
def test_a_pattern_is_what_names_look_like(names: str, pattern: str) -> None:
    files = [named(f"{name}.csv") for name in names.split()]
    assert guessed(files) == (pattern or None)


def test_what_is_given_otherwise_does_not_matter_in_names() -> None:
    files = [named(f"p{n}_{s}_500g.csv") for n in (1, 2) for s in "lr"]
    assert guessed(files, {"mass_kg", "side"}) == "{subject}_{}_{}g"


@pytest.mark.parametrize(("names", "given", "found"), cases(__file__, "contradicted"))
def test_what_a_name_says_otherwise_is_told_with_both(names: str, given: dict[str, str], found: list) -> None:
    files = [named(f"{name}.csv") for name in names.split()]
    problems = [problem for file in files for problem in contradictions(file, given)]
    assert [[p.file, p.value, p.expected.split('"')[1]] for p in problems] == found


def test_a_set_fact_or_a_row_that_contradicts_a_name_is_refused(tmp_path: Path) -> None:
    recorded, out = tmp_path / "r", tmp_path / "d"
    masses = "".join(f"{path.name},0.5\n" for path in copied(recorded, only="p1_*"))
    (tmp_path / "info.csv").write_text(f"file,mass_kg\n{masses}")
    known, mass = {"velocity_m_s": 1.5, "subject": "p1"}, {"mass_kg": 0.5}
    for said in ({"set": known | mass}, {"set": known, "table": tmp_path / "info.csv"}):
        refused = init(recorded, out, **said)
        assert refused.status == 2
        assert 'found "mass_kg = 0.5"; expected what the name says: "1.0kg"' in refused.err
        assert not out.exists()
    # Who says how names are read has said that this part does not matter.
    made = init(recorded, out, set={"velocity_m_s": 1.5} | mass, pattern="{subject}_{side}_{}kg")
    assert made.status == 0, made.err


def test_without_options_init_says_what_it_understood_and_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = bayestissue("init", RECORDED)
    assert found.status == 2
    assert "Names read as {subject}_{side}_{mass_kg}kg, a guess; --pattern takes another:" in found.err
    assert "subject: 6, p1 (4), p2 (4)" in found.err
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


def test_a_pattern_where_a_person_is_asked_for_is_one(tmp_path: Path) -> None:
    copied(tmp_path, count=3, name="rec{}.lvm")
    intake = prepare(tmp_path, choices_of(quantity="deceleration", given=UNITS))
    (question,) = intake.questions
    assert question.option == "--set subject="
    assert intake.answered(question, "{subject}.lvm").questions == ()


@pytest.mark.parametrize(("mass", "velocity", "names"), cases(__file__, "conditions"))
def test_a_condition_that_is_left_out_is_a_mass_and_velocity(mass, velocity, names) -> None:
    table = pd.DataFrame({"impact": list("abcd"), "subject": "s", "mass_kg": mass, "velocity_m_s": velocity})
    t = np.arange(100) / 1e3
    traces = [(t, 50 * np.sin(np.pi * t / 0.1))] * 4
    assert bt.dataset(table, traces, quantity="deceleration", unit="m/s^2").impacts["trial"].tolist() == names


def six_people(folder: Path) -> Path:
    """Recordings of three people in each of two groups, numbered anew in each, twice each."""
    for group in ("treated", "control"):
        for number, path in enumerate(copied(folder / group, count=6)):
            path.rename(path.with_name(f"{number // 2 + 1}_{number % 2 + 1}.lvm"))
    return folder


@pytest.mark.parametrize("pattern", [None, "{group}/{subject}_{n}"])
def test_people_numbered_anew_in_each_group_are_asked_about(tmp_path: Path, pattern: str | None) -> None:
    choices = choices_of(quantity="deceleration", pattern=pattern, given=UNITS, unit="m/s^2")
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
    people = [(group, n) for group in ("treated", "control") for n in (1, 2, 3)]
    rows = (f"{group},{n},{who}" for who, (group, n) in enumerate(people))
    table.write_text("\n".join(["group,subject,who", *rows]))
    choices = choices_of(quantity="deceleration", pattern="{group}/{subject:group}_{n}", table=table)
    intake = prepare(six_people(tmp_path / "r"), choices)
    who = {(row["subject"], row["who"]) for row in intake.facts.of_file.values()}
    assert who == {(f"{group}-{n}", str(who)) for who, (group, n) in enumerate(people)}


@pytest.mark.parametrize(("head", "people"), cases(__file__, "heads"))
def test_a_table_says_who_was_hit_in_whatever_case(tmp_path: Path, head: str, people: int) -> None:
    copied(tmp_path, count=6, name="rec_{}.lvm")
    table = tmp_path / "facts.csv"
    table.write_text("\n".join([head, *(f"rec_{number}.lvm,p{number}" for number in range(6))]))
    intake = prepare(tmp_path, choices_of(quantity="deceleration", table=table, given=UNITS))
    if not people:
        (question,) = intake.questions
        assert "--set" not in question.line
    else:
        assert intake.questions == ()
        assert len({row["subject"] for row in intake.facts.of_file.values()}) == people


def test_a_table_that_does_not_say_who_was_hit_leaves_it_to_the_names(tmp_path: Path) -> None:
    table, files = tmp_path / "facts.csv", copied(tmp_path / "r", only="*1.0kg*")
    table.write_text("file,mass_kg\n" + "".join(f"{path.name},1\n" for path in files))
    choices = choices_of(quantity="deceleration", table=table, given={"velocity_m_s": "1"})
    intake = prepare(tmp_path / "r", choices)
    assert intake.questions == ()
    assert {row["subject"] for row in intake.facts.of_file.values()} == {f"p{n}" for n in range(1, 7)}
