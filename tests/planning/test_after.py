"""A plan that goes on from a study that has begun: its people, conditions and model are those of the fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.studies.planning.plan import Plan
from bayestissue.studies.planning.plan_file import plan_of
from bayestissue.studies.planning.planned_study import PlannedStudy, study_of
from bayestissue.studies.planning.running import RunningPrior
from bayestissue.studies.simulation import simulate, write_campaign
from campaigns import spreads, study
from command_line import bayestissue
from stand_in_planner import kernel

pytestmark = pytest.mark.slow

FORMULA = "log(mass_kg) + (1|subject)"
CONTENT = {
    "candidates": {"people": [3, 6], "masses_kg": [[0.5], [1.0], [2.0]]},
    "questions": {"exponent": "mass_exponent_K < 0.5"},
    "goal": {"studies": 100},
}


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("begun")
    tissue = {"mass_exponent_K": 0.3, **spreads(subject=0.2, impact=0.1)}
    recording = {"noise_relative_to_peak": 0.005, "velocity_sd_m_s": 0.005}
    simulation = study(tissue, recording, name="running", people=5, masses=(0.5, 1.0), seed=4)
    (folder / "drops").mkdir()
    write_campaign(folder / "drops", simulate(simulation), simulation)
    with (folder / "drops" / "dataset.toml").open("a", encoding="utf-8") as settings:
        settings.write('\n[words]\nsubject = "pad"\n')
    fit = bt.fit(folder / "drops", "impact", K=FORMULA, C=FORMULA)
    fit.report(folder / "run")
    return folder


def after(begun: Path, **changed: object) -> dict[str, object]:
    return {"run": str(begun / "run"), "dataset": str(begun / "drops")} | changed


def further(begun: Path, **candidates: Any) -> Plan:
    running = {"after": begun / "run", "dataset": begun / "drops"}
    return bt.plan(ask="mass_exponent_K < 0.5", studies=100, **running, **candidates)


def planned(**changed: object) -> PlannedStudy:
    return study_of(plan_of(CONTENT | changed, "plan.toml"), "plan.toml")


def test_people_and_conditions_go_on(begun: Path) -> None:
    study = planned(after=after(begun))
    assert isinstance(study.cases[0].prior, RunningPrior)
    assert study.cases[0].running is not None
    assert len(study.cases[0].running.rows) == 10
    rows = study.cases[0].design.rows()
    assert rows["subject"].tolist() == ["new001", "new002", "new003"]
    # A mass that was recorded has its condition's name, and a new one a name of its own.
    assert [set(case.design.rows()["trial"]) for case in study.cases[::2]] == [
        {"t0"}, {"t1"}, {"2 kg at 1.5 m/s"}
    ]  # fmt: skip
    assert study.cases[0].model.formula.K == FORMULA


def test_a_plan_speaks_as_what_it_goes_on_from(begun: Path) -> None:
    candidates, pilot = {"people": 3, "masses_kg": [0.5, 1.0]}, {"pilot": str(begun / "run")}
    for source in ({"after": after(begun)}, pilot):
        assert planned(candidates=candidates, **source).words == {"subject": "pad"}
    own = {"subject": "athlete"}
    assert planned(candidates=candidates, words=own, **pilot).words == own


def test_the_same_people_may_be_hit_again(begun: Path) -> None:
    study = planned(after=after(begun, again=True))
    assert study.cases[1].design.rows()["subject"].tolist() == ["s01", "s02", "s03", "s04", "s05", "new001"]


def test_other_recordings_than_were_fitted_are_refused(begun: Path, tmp_path: Path) -> None:
    spoilt = tmp_path / "drops"
    spoilt.mkdir()
    for path in (begun / "drops").iterdir():
        if path.is_file():
            text = path.read_bytes()
            (spoilt / path.name).write_bytes(text.replace(b"running", b"another"))
    with pytest.raises(InputError, match="the dataset that was fitted"):
        planned(after=after(begun, dataset=str(spoilt)))


def test_the_command_takes_a_running_study(begun: Path, tmp_path: Path) -> None:
    options = ["--people", "3,6", "--masses", "0.5", "--ask", "mass_exponent_K < 0.5", "--studies", "100"]
    of_study = ["--after", begun / "run", "--dataset", begun / "drops"]
    with kernel():
        ended = bayestissue("plan", *options, *of_study, "--out", tmp_path / "out")
        assert ended.status == 0, ended.err
        plan = further(begun, people=[3, 6], masses_kg=[0.5])
    assert "further pads" in ended.out
    assert "as it stands" in plan.content["variants"]
    assert "one truth" not in plan.content["variants"]
    assert "A study has begun" in (tmp_path / "out" / "report.html").read_text()
    refused = bayestissue("plan", *options, *of_study[:2], "--out", tmp_path / "no")
    assert (refused.status, "after.dataset" in refused.err) == (2, True)


def test_a_running_study_is_assessed(begun: Path) -> None:
    plan = further(begun, people=3, masses_kg=[1.0])
    now = plan.content["variants"]["as it stands"]["goals"]["question_1"]
    # What is still to come tells something.
    assert plan.content["designs"][0]["goals"]["question_1"]["undecided_bits"] < now["undecided_bits"] + 0.02
    # Without anything more all studies are the same one, but for where the search for its mode began.
    assert min(now["answered"], 1 - now["answered"]) < 0.05
