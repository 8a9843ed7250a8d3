"""Whatever passes `check` can be fitted, with what the data can't tell left out and said."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.commands.datasets import check, what_is_untold
from bayestissue.mechanics.oscillator import impact_motion
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset import read_dataset, write_dataset
from bayestissue.studies.fitting import without_short
from bayestissue.studies.simulation import Simulation, simulate, write_campaign
from campaigns import spreads, study
from command_line import bayestissue

# Of few draws: what is asked is whether everything works, not how exact it is.
SAMPLER = """
[sampler]
chains = 2
draws = 200
"""


def drops(people: int, *conditions: tuple[str, float, float]) -> Simulation:
    """Of each condition its name, mass and velocity."""
    names = ("trial", "mass_kg", "velocity_m_s")
    recording = {"noise_relative_to_peak": 0.005, "relative_mass_sd": 0.002, "velocity_sd_m_s": 0.005}
    design = {"conditions": [dict(zip(names, each, strict=True)) for each in conditions]}
    return study(spreads(impact=0.05), recording, people=people, design=design, seed=3)


def first_screen(run: Path) -> str:
    html = (run / "report.html").read_text(encoding="utf-8")
    html = re.sub(r"<style.*?</style>", "", html[: html.index("<nav")], flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("&nbsp;", " ")


def about(run: Path) -> dict:
    return json.loads((run / "run.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def one_impact(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The run of one impact, and what the command printed."""
    folder, simulation = tmp_path_factory.mktemp("one"), drops(1, ("only", 0.7, 1.5))
    data, model = folder / "data", folder / "model.toml"
    data.mkdir()
    write_campaign(data, simulate(simulation), simulation)
    assert bayestissue("check", data).status == 0
    model.write_text(f'name = "small"\nlikelihood = "a2"\n{SAMPLER}', encoding="utf-8")
    run = bayestissue("fit", data, "--model", model, "--out", folder / "run")
    # So few draws may well fail the diagnostics; then everything is written all the same.
    assert run.status in (0, 3), run.err
    return folder / "run", run.out


@pytest.mark.long
def test_one_impact_is_fitted_without_what_it_cannot_tell(one_impact: tuple[Path, str]) -> None:
    run, said = one_impact
    assert about(run)["model"]["formula"] == {"K": "1", "C": "1"}
    left_out = {each["term"]: each["reason"] for each in about(run)["terms_left_out"]}
    assert set(left_out) == {"log(mass_kg)", "(1|subject)", "(1|trial)"}
    for text in (said, first_screen(run)):
        assert "Left out of the formula: (1|subject), since there is one subject only" in text
        assert "log(mass_kg), since the mass is 0.7 kg in every impact" in text
        assert "One impact tells nothing of how impacts differ" in text


@pytest.mark.long
def test_of_one_impact_its_own_k_is_the_answer_and_near_the_truth(one_impact: tuple[Path, str]) -> None:
    run, _ = one_impact
    truth = pd.read_csv(run / "truth.csv").iloc[0]
    with xr.open_datatree(run / "posterior.nc", engine="h5netcdf") as tree:
        posterior = tree["posterior"].dataset.load()
    for q, column in (("K", "K_N_per_m"), ("C", "C_N_s_per_m")):
        assert abs(posterior[q].mean() - truth[column]) < 4.5 * posterior[q].std()
        assert f"sd_subject_{q}" not in posterior
        assert f"mass_exponent_{q}" not in posterior
        assert "this person" in posterior[f"{q}_new"].attrs["long_name"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("people", "conditions", "groups", "left_out"),
    [
        (2, [("a", 0.7, 1.5)], (), {"log(mass_kg)", "(1|subject)", "(1|trial)"}),
        (1, [("a", 0.5, 1.5), ("b", 1.0, 1.5)], (), {"(1|subject)", "(1|trial)"}),
        # A condition may have the name of a person.
        (3, [("a", 0.5, 1.5), ("s01", 1.0, 1.5)], ("subject",), {"(1|trial)"}),
        (3, [("slow", 0.7, 1.5), ("fast", 0.7, 2.0)], ("subject", "trial"), {"log(mass_kg)"}),
    ],
)
def test_what_a_design_does_not_tell_is_left_out_and_said(people, conditions, groups, left_out) -> None:
    """Before any fit; what the page says of it is tested on a run that is made up."""
    data = simulate(drops(people, *conditions)).dataset("few")
    prepared = prepare(data, ModelSpecification(name="m", likelihood="a2"), source="m.toml")
    said = " ".join(words for words in what_is_untold(data, prepared) if words.startswith("Left out"))
    for term in ("log(mass_kg)", "(1|subject)", "(1|trial)"):
        assert (term in left_out) == (f"{term}, since" in said), term
    for response in prepared.design.responses.values():
        assert response.groups == groups
        assert (response.log_mass is None) == ("log(mass_kg)" in left_out)


def test_impacts_too_short_to_be_fitted_are_told_and_can_be_left_out(tmp_path: Path, capsys) -> None:
    time = np.arange(-0.005, 0.06, 1 / 250)
    rows = pd.DataFrame({"impact": ["long", "short"], "subject": "a", "trial": "x", "velocity_m_s": 1.5})
    rows = rows.assign(mass_kg=[4.0, 0.7])
    traces = []
    # The short one bounces: of one blow alone the whole pulse would be enough, or could not be read.
    for name, mass in zip(rows["impact"], rows["mass_kg"], strict=True):
        omega_n, zeta = np.sqrt(3000 / mass), 25 / (2 * np.sqrt(3000 * mass))
        motion = impact_motion(np.maximum(time, 0), omega_n, zeta, 1.5)
        value = np.where(time >= 0, np.asarray(motion.deceleration), 0.0)
        if name == "short":
            value[time >= 0.02] = 0
            value += np.roll(value, 10)
        traces.append(pd.DataFrame({"impact": name, "time_s": time, "value": value}))
    folder, signal = tmp_path / "data", {"quantity": "deceleration", "unit": "m/s^2"}
    settings = {"name": "few", "signal": signal}
    write_dataset(folder, settings=settings, impacts=rows, traces=pd.concat(traces), trace_file="traces.csv")
    check(dataset=folder)
    assert "1 of 2 impacts too short to be fitted" in capsys.readouterr().out
    model = ModelSpecification(name="m", likelihood="a2")
    left = without_short(read_dataset(folder), model, "m.toml")
    assert left.impacts["impact"].to_list() == ["long"]
    assert len(left.traces) == 1
    assert [problem.impact for problem in left.left_out] == ["short"]
