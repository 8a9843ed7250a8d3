"""A plan that goes on from a study that has begun: people, conditions, model and posterior are of its fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.base.errors import InputError
from bayestissue.studies.planning.assurance import Goal, Planner, planner
from bayestissue.studies.planning.plan import Plan
from bayestissue.studies.planning.plan_file import plan_of
from bayestissue.studies.planning.planned_study import PlannedStudy, study_of
from bayestissue.studies.simulation import simulate, write_campaign
from campaigns import spreads, study
from command_line import bayestissue
from counted import COMPILED, counted
from stand_in_planner import kernel

pytestmark = pytest.mark.slow

FORMULA = "log(mass_kg) + (1|subject)"
RECORDING = {"noise_relative_to_peak": 0.005, "velocity_sd_m_s": 0.005, "relative_mass_sd": 0.002}
CONTENT = {
    "candidates": {"people": [3, 6], "masses_kg": [[0.5], [1.0], [2.0]]},
    "questions": {"exponent": "mass_exponent_K < 0.5"},
    "goal": {"studies": 100},
}


class Begun(NamedTuple):
    fit: bt.Fit
    run: Path
    dataset: Path
    # Programs by this fit and then by one of another dataset of the same design.
    compiled: tuple[int, int]

    def after(self, **changed: object) -> dict[str, object]:
        return {"run": str(self.run), "dataset": str(self.dataset)} | changed

    def plan(self, **candidates: Any) -> Plan:
        asked = {"ask": "mass_exponent_K < 0.5", "studies": 100}
        return bt.plan(after=self.run, dataset=self.dataset, **asked, **candidates)


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Begun:
    folder = tmp_path_factory.mktemp("begun")
    run, drops = folder / "run", folder / "drops"
    drops.mkdir()
    tissue = {"mass_exponent_K": 0.3, **spreads(subject=0.2, impact=0.1)}
    simulation = study(tissue, RECORDING, name="running", people=5, masses=(0.5, 1.0), seed=4)
    write_campaign(drops, simulate(simulation), simulation)
    with (drops / "dataset.toml").open("a", encoding="utf-8") as settings:
        settings.write('\n[words]\nsubject = "pad"\n')
    # As in a new process: after many tests a fit would do so itself, between the two that are counted.
    runtime.release_compiled(0)
    with counted() as events:
        fit = bt.fit(drops, "impact", K=FORMULA, C=FORMULA)
    again = simulate(simulation.model_copy(update={"seed": 5})).dataset("again")
    with counted() as of_another:
        bt.fit(again, "impact", K=FORMULA, C=FORMULA)
    fit.report(run)
    return Begun(fit, run, drops, (events[COMPILED], of_another[COMPILED]))


def planned(**changed: object) -> PlannedStudy:
    return study_of(plan_of(CONTENT | changed, "plan.toml"), "plan.toml")


@pytest.fixture(scope="module")
def ready(begun: Begun) -> Planner:
    """Of nobody further, and of ten people."""
    case = planned(after=begun.after()).cases[0]
    assert case.running.started
    rows = case.running.rows
    more = pd.concat([rows[rows["subject"] == "s01"].assign(subject=f"new{n}") for n in range(10)])
    return planner([rows[:0], more], case.model, case.prior, case.simulation, running=case.running)


def test_people_and_conditions_go_on(begun: Begun) -> None:
    study = planned(after=begun.after())
    assert study.cases[0].prior.fitted is not None
    assert study.cases[0].running.started
    assert len(study.cases[0].running.rows) == 10
    rows = study.cases[0].design.rows()
    assert rows["subject"].tolist() == ["new001", "new002", "new003"]
    # A mass that was recorded has its condition's name, and a new one a name of its own.
    assert [set(case.design.rows()["trial"]) for case in study.cases[::2]] == [
        {"t0"}, {"t1"}, {"2 kg at 1.5 m/s"}
    ]  # fmt: skip
    assert study.cases[0].model.formula.K == FORMULA


def test_a_plan_speaks_as_what_it_goes_on_from(begun: Begun) -> None:
    candidates, pilot = {"people": 3, "masses_kg": [0.5, 1.0]}, {"pilot": str(begun.run)}
    for source in ({"after": begun.after()}, pilot):
        assert planned(candidates=candidates, **source).words == {"subject": "pad"}
    own = {"subject": "athlete"}
    assert planned(candidates=candidates, words=own, **pilot).words == own


def test_the_same_people_may_be_hit_again(begun: Begun) -> None:
    study = planned(after=begun.after(again=True))
    assert study.cases[1].design.rows()["subject"].tolist() == ["s01", "s02", "s03", "s04", "s05", "new001"]


def test_other_recordings_than_were_fitted_are_refused(begun: Begun, tmp_path: Path) -> None:
    spoilt = tmp_path / "drops"
    spoilt.mkdir()
    for path in begun.dataset.iterdir():
        if path.is_file():
            text = path.read_bytes()
            (spoilt / path.name).write_bytes(text.replace(b"running", b"another"))
    with pytest.raises(InputError, match="the dataset that was fitted"):
        planned(after=begun.after(dataset=str(spoilt)))


def test_the_command_takes_a_running_study(begun: Begun, tmp_path: Path) -> None:
    options = ["--people", "3,6", "--masses", "0.5", "--ask", "mass_exponent_K < 0.5", "--studies", "100"]
    of_study = ["--after", begun.run, "--dataset", begun.dataset]
    with kernel():
        ended = bayestissue("plan", *options, *of_study, "--out", tmp_path / "out")
        assert ended.status == 0, ended.err
        plan = begun.plan(people=[3, 6], masses_kg=[0.5])
    assert "further pads" in ended.out
    assert "as it stands" in plan.content["variants"]
    assert "one truth" not in plan.content["variants"]
    assert "A study has begun" in (tmp_path / "out" / "report.html").read_text()
    refused = bayestissue("plan", *options, *of_study[:2], "--out", tmp_path / "no")
    assert (refused.status, "after.dataset" in refused.err) == (2, True)


def test_a_fit_works_as_little_as_it_did(begun: Begun) -> None:
    """Counts of a small fit, the same on any machine but for what is stated."""
    first, again = begun.compiled
    # Programs of a new process: what another test has compiled is not compiled again. Two more are let pass.
    assert first <= 70
    # Traces of other lengths have a few programs of their own.
    assert again <= 20
    # Bytes of 4,000 draws of 10 impacts, exactly.
    assert sum(part.to_dataset().nbytes for part in begun.fit.posterior.subtree) <= 9_933_284


def test_without_further_impacts_a_plan_says_what_the_fit_says(begun: Begun, ready: Planner) -> None:
    fitted = begun.fit.posterior["posterior"]["mass_exponent_K"].to_numpy()
    goals = [Goal("claim", "mass_exponent_K > 0.2"), Goal("width", "mass_exponent_K", width=0.1)]
    goals.append(Goal("middle", f"mass_exponent_K > {np.median(fitted):.6g}"))
    (now, _) = ready.assess(goals, range(1))
    # All studies are the same one, each with points of its own: their scatter is what these are wrong by.
    assert np.std(now[0].table["p"]) < 0.05
    low, high = np.quantile(fitted, [0.05, 0.95])
    # Within a tenth of a standard deviation.
    assert now[2].table["p"].mean() == pytest.approx(0.5, abs=0.04)
    assert now[1].table["width"].mean() == pytest.approx((high - low) / 2, rel=0.1)
    assert now[0].table["p"].mean() == pytest.approx((fitted > 0.2).mean(), abs=0.05)


def test_further_people_tell_more(ready: Planner) -> None:
    goals = [Goal("claim", "mass_exponent_K > 0.2"), Goal("width", "mass_exponent_K", width=0.1)]
    now, later = ready.assess(goals, range(3))
    assert later[1].table["width"].mean() < 0.8 * now[1].table["width"].mean()
    assert later[0].numbers()["undecided_bits"] < now[0].numbers()["undecided_bits"]
    # What is going to be said is, on average, what is said now: probabilities are a martingale.
    error = later[0].table["p"].std() / np.sqrt(len(later[0].table))
    assert abs(later[0].table["p"].mean() - now[0].table["p"].mean()) < 3 * error + 0.02
