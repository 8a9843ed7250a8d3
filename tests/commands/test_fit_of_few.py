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
from bayestissue.recordings.dataset import read_dataset
from bayestissue.studies.fitting import without_short
from command_line import bayestissue

DESIGN = """
name = "few"
seed = 3
[design]
subjects = {people}
{conditions}
[tissue]
K_N_per_m = 3000.0
C_N_s_per_m = 25.0
sd_impact_K = 0.05
sd_impact_C = 0.05
[recording]
sampling_rate_hz = 2000.0
noise_relative_to_peak = 0.005
relative_mass_sd = 0.002
velocity_sd_m_s = 0.005
[output]
traces = "csv"
"""
CONDITION = '[[design.conditions]]\ntrial = "{}"\nmass_kg = {}\nvelocity_m_s = {}'
# Of few draws: what is asked is whether everything works, not how exact it is.
MODEL = """
name = "small"
likelihood = "{likelihood}"
[sampler]
chains = 2
draws = 200
"""


def simulated(folder: Path, people: int, conditions: list[tuple[str, float, float]]) -> Path:
    """The dataset of a simulated campaign."""
    told = "\n".join(CONDITION.format(*each) for each in conditions)
    design = DESIGN.format(people=people, conditions=told)
    (folder / "spec.toml").write_text(design, encoding="utf-8")
    made = bayestissue("simulate", folder / "spec.toml", "--out", folder / "data", "--quiet")
    assert made.status == 0, made.err
    return folder / "data"


def fitted(
    folder: Path, people: int, conditions: list[tuple[str, float, float]], likelihood: str
) -> tuple[Path, str]:
    """The run of a simulated campaign, and what the command printed."""
    data = simulated(folder, people, conditions)
    assert bayestissue("check", data).status == 0
    (folder / "model.toml").write_text(MODEL.format(likelihood=likelihood), encoding="utf-8")
    run = bayestissue("fit", data, "--model", folder / "model.toml", "--out", folder / "run")
    # So few draws may well fail the diagnostics; then everything is written all the same.
    assert run.status in (0, 3), run.err
    return folder / "run", run.out


def written(folder: Path, quantity: str, unit: str, impacts: pd.DataFrame, traces: pd.DataFrame) -> Path:
    """A dataset's folder."""
    folder.mkdir()
    settings = f'name = "few"\n[signal]\nquantity = "{quantity}"\nunit = "{unit}"\n'
    (folder / "dataset.toml").write_text(settings, encoding="utf-8")
    impacts.to_csv(folder / "impacts.csv", index=False)
    traces.to_csv(folder / "traces.csv", index=False)
    return folder


def first_screen(run: Path) -> str:
    html = (run / "report.html").read_text(encoding="utf-8")
    html = re.sub(r"<style.*?</style>", "", html[: html.index("<nav")], flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("&nbsp;", " ")


def about(run: Path) -> dict:
    return json.loads((run / "run.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def one_impact(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    return fitted(tmp_path_factory.mktemp("one"), 1, [("only", 0.7, 1.5)], "a2")


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
    text = first_screen(run)
    shown = re.search(r"stiffness K ([\d ]+?) N/m", text)
    assert shown is not None
    assert abs(float(shown[1].replace(" ", "")) / float(np.median(posterior["K"])) - 1) < 0.01
    assert "New person" not in text
    assert "This impact, 90 % intervals" in text


@pytest.mark.long
def test_a_run_of_one_impact_can_be_compared_and_reported_anew(one_impact: tuple[Path, str]) -> None:
    run, _ = one_impact
    assert bayestissue("report", run, "--quiet").status == 0
    copy = run.with_name("copy")
    if not copy.exists():
        copy.mkdir()
        for path in run.iterdir():
            (copy / path.name).write_bytes(path.read_bytes())
    compared = bayestissue("compare", run, copy, "--out", run.with_name("compared"))
    assert compared.status == 0, compared.err
    assert "K of a new impact on this person at the reference mass (N/m)" in compared.out


@pytest.mark.slow
def test_a_mass_that_never_varies_costs_the_exponent_only(
    tmp_path: Path,
) -> None:
    """Before any fit; what the page says of it is tested on a run that is made up."""
    data = read_dataset(simulated(tmp_path, 3, [("slow", 0.7, 1.5), ("fast", 0.7, 2.0)]))
    prepared = prepare(data, ModelSpecification(name="m", likelihood="a2"), source="m.toml")
    said = what_is_untold(data, prepared)
    assert "Left out of the formula: log(mass_kg), since the mass is 0.7 kg in every impact." in said
    assert not any("(1|subject), since" in words for words in said)
    for response in prepared.design.responses.values():
        assert (response.log_mass, response.groups) == (None, ("subject", "trial"))


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
    folder = written(tmp_path / "data", "deceleration", "m/s^2", rows, pd.concat(traces))
    check(dataset=folder)
    assert "1 of 2 impacts too short to be fitted" in capsys.readouterr().out
    model = ModelSpecification(name="m", likelihood="a2")
    left = without_short(read_dataset(folder), model, "m.toml")
    assert left.impacts["impact"].to_list() == ["long"]
    assert len(left.traces) == 1
    assert [problem.impact for problem in left.left_out] == ["short"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("people", "conditions", "formula"),
    [
        (2, [("a", 0.7, 1.5)], "1"),
        (1, [("a", 0.5, 1.5), ("b", 1.0, 1.5)], "log(mass_kg)"),
        (1, [("a", 0.7, 1.0), ("b", 0.7, 1.5), ("c", 0.7, 2.0)], "1"),
        (3, [("a", 0.5, 1.5), ("s01", 1.0, 1.5)], "log(mass_kg) + (1|subject) + (1|trial)"),
    ],
)
@pytest.mark.parametrize("likelihood", ["arma", "impact"])
def test_other_shapes_are_fitted_too(
    people: int, conditions: list, formula: str, likelihood: str, tmp_path: Path
) -> None:
    run, _ = fitted(tmp_path, people, conditions, likelihood)
    assert about(run)["model"]["formula"]["K"] == formula


@pytest.mark.long
@pytest.mark.parametrize("people", [1, 3])
def test_recorded_displacements_of_few_impacts_are_fitted(people: int, tmp_path: Path) -> None:
    names = [f"s{number}" for number in range(people)]
    time = np.arange(0.0, 0.04, 5e-4)
    rng = np.random.default_rng(2)
    traces = []
    for name in names:
        K = 3000.0 * np.exp(0.05 * rng.standard_normal())
        omega_n, zeta = np.sqrt(K / 0.7), 25 / (2 * np.sqrt(K * 0.7))
        clean = np.asarray(impact_motion(time, omega_n, zeta, 1.5).displacement)
        noisy = clean + 1e-5 * rng.standard_normal(time.size)
        traces.append(pd.DataFrame({"impact": name, "time_s": time, "value": noisy}))
    impacts = pd.DataFrame({"impact": names, "subject": names, "trial": "a", "mass_kg": 0.7})
    data = written(tmp_path / "data", "displacement", "m", impacts, pd.concat(traces))
    assert bayestissue("check", data).status == 0
    (tmp_path / "model.toml").write_text(MODEL.format(likelihood="arma"), encoding="utf-8")
    run = bayestissue("fit", data, "--model", tmp_path / "model.toml", "--out", tmp_path / "run")
    assert run.status in (0, 3), run.err
    assert about(tmp_path / "run")["model"]["formula"] == {"K": "1", "C": "1"}
