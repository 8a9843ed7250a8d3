"""The fit command on a small campaign: results whole, refusals before work, and going on after a kill."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import norm

from bayestissue import fit, read_dataset, read_run
from campaigns import FOUR_BY_FOUR
from command_line import bayestissue

pytestmark = pytest.mark.slow

MODEL = """
name = "small"
likelihood = "a2"
[questions]
stiff = "K > 1000"
between_people = "max(K[subject]) / min(K[subject])"
[sampler]
chains = 2
draws = {draws}
"""

ALWAYS_KEPT = {
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "bayestissue", *map(str, arguments)]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "spec.toml").write_text(FOUR_BY_FOUR, encoding="utf-8")
    made = bayestissue("simulate", folder / "spec.toml", "--out", folder / "data", "--quiet")
    assert made.status == 0, made.err
    return folder


def model_file(campaign: Path, draws: int = 300) -> Path:
    model = campaign / f"of-{draws}.toml"
    model.write_text(MODEL.format(draws=draws), encoding="utf-8")
    return model


@pytest.fixture(scope="module")
def finished(campaign: Path) -> Path:
    out = campaign / "finished"
    fitted = bayestissue("fit", campaign / "data", "--model", model_file(campaign), "--out", out)
    # So few draws may well fail the diagnostics; then everything is written all the same.
    assert fitted.status in (0, 3), fitted.err
    return out


def test_a_fit_writes_what_the_interface_names(finished: Path) -> None:
    names = {"posterior.nc", "summary.csv", "diagnostics.json", "run.json", "report.html"}
    assert names <= {path.name for path in finished.iterdir()}
    with xr.open_datatree(finished / "posterior.nc", engine="h5netcdf") as tree:
        groups = {
            "posterior",
            "sample_stats",
            "log_likelihood",
            "log_prior",
            "prior",
            "prior_predictive",
            "posterior_predictive",
            "observed_data",
            "constant_data",
        }
        assert groups <= set(tree.children)
        posterior = tree["posterior"].dataset
        for name in ("K", "C", "omega_n", "zeta", "theta1", "sigma_a"):
            assert posterior[name].dims == ("chain", "draw", "impact")
        assert posterior["subject_effect_K"].dims == ("chain", "draw", "subject")
        assert posterior["K"].attrs["unit"] == "N/m"
        for name in ("mass_exponent_K", "sd_trial_C", "K_new"):
            assert posterior[name].dims == ("chain", "draw")


def test_a_run_says_where_its_dataset_lies_and_knows_it_again(finished: Path, campaign: Path) -> None:
    run = read_run(finished)
    assert run.about["dataset_folder"] == "../data"
    assert run.dataset_folder == (campaign / "data").resolve()
    assert run.about["whole_hash"] == run.about["input_hash"] == read_dataset(campaign / "data").whole_hash


def test_the_model_files_questions_are_answered(finished: Path) -> None:
    asked = pd.read_csv(finished / "questions.csv").set_index("name")
    assert asked.loc["stiff", "posterior"] > 0.99
    run = read_run(finished)
    prior = run.posterior["prior"].dataset["intercept_K"].to_numpy() > np.log(1000)
    assert asked.loc["stiff", "prior"] == pytest.approx(prior.mean())
    # The model's prior of log K is normal about 5 with standard deviation 3.
    expected = norm.sf(np.log(1000), 5, 3)
    assert asked.loc["stiff", "prior"] == pytest.approx(expected, abs=4 * asked.loc["stiff", "prior_mcse"])
    assert asked.loc["stiff", "prior_draws"] == 1000
    assert 1 < asked.loc["between_people", "median"] < 3
    assert "What was asked" in (finished / "report.html").read_text(encoding="utf-8")
    level = run.posterior["posterior"].dataset["subject"].to_numpy()[0]
    found = run.ask(f"K[subject={level}]", f"K_subject[subject={level}]")
    assert found["median"][0] == pytest.approx(found["median"][1])


def test_a_question_that_these_data_can_not_answer_stops_the_fit_before_it_begins(campaign: Path) -> None:
    text = model_file(campaign).read_text(encoding="utf-8")
    model = campaign / "wrong.toml"
    model.write_text(text.replace("K > 1000", "K[subject=nobody] > 1"), encoding="utf-8")
    told = bayestissue("fit", campaign / "data", "--model", model, "--out", campaign / "never")
    assert told.status == 2
    assert "wrong.toml, questions.stiff, column 11" in told.err
    assert not (campaign / "never").exists()


def test_a_finished_fit_goes_on(finished: Path, campaign: Path, tmp_path: Path) -> None:
    model, out = model_file(campaign, draws=500), tmp_path / "longer"
    goes_on = ("--model", model, "--continue", finished, "--quiet")
    fitted = bayestissue("fit", campaign / "data", "--out", out, *goes_on)
    assert fitted.status in (0, 3), fitted.err
    first, second = (read_run(folder).about["route"] for folder in (finished, out))
    assert second["earlier_segments"] == first["warm_up_segments"] + first["segments"]
    before, after = (
        read_run(folder).posterior["posterior"].dataset["K"].to_numpy() for folder in (finished, out)
    )
    assert not set(before.ravel()) & set(after.ravel())
    # Two parts of one chain agree within Monte Carlo errors, each of at least 400 effective draws.
    error = before.std((0, 1)) * np.sqrt(2 / 400)
    assert (np.abs(before.mean((0, 1)) - after.mean((0, 1))) < 4.5 * error).all()
    # In the folder itself, from Python too.
    fit(campaign / "data", model, continue_from=out).report(out, overwrite=True)
    assert read_run(out).about["route"]["earlier_segments"] > second["earlier_segments"]


def test_what_can_not_go_on_is_refused_with_all_that_differs(
    finished: Path, campaign: Path, tmp_path: Path
) -> None:
    other, model = tmp_path / "other", tmp_path / "model.toml"
    text = model_file(campaign).read_text(encoding="utf-8")
    model.write_text(text.replace("chains = 2", "chains = 3").replace('"a2"', '"arma"'), encoding="utf-8")
    shutil.copytree(finished, other)
    (other / "chain.npz").unlink()
    arguments = ("fit", campaign / "data", "--out", tmp_path / "never")
    refused = bayestissue(*arguments, "--model", model, "--continue", finished)
    assert refused.status == 2
    assert 'column likelihood: found "arma"' in refused.err
    assert "column sampler.chains: found 3" in refused.err
    refused = bayestissue(*arguments, "--model", model_file(campaign), "--continue", other)
    assert refused.status == 2
    assert "chain.npz" in refused.err
    assert not (tmp_path / "never").exists()


def test_draws_obey_the_conversion(finished: Path) -> None:
    with xr.open_datatree(finished / "posterior.nc", engine="h5netcdf") as tree:
        draws = tree["posterior"].dataset.load()
    np.testing.assert_allclose(draws["K"], draws["mass"] * draws["omega_n"] ** 2, rtol=1e-10)
    damping = 2 * draws["zeta"] * draws["omega_n"] * draws["mass"]
    np.testing.assert_allclose(draws["C"], damping, rtol=1e-10)


def test_the_truth_is_within_reach(finished: Path, campaign: Path) -> None:
    truth = pd.read_csv(campaign / "data" / "truth.csv").set_index("impact")
    summary = pd.read_csv(finished / "summary.csv").set_index(["variable", "label"])
    for quantity, column in (("K", "K_N_per_m"), ("C", "C_N_s_per_m")):
        found = summary.loc[quantity]
        distance = (found["mean"] - truth.loc[found.index, column]) / found["sd"]
        # The greatest of 32 standard normals is beyond 4.5 once in 4600 campaigns.
        assert distance.abs().max() < 4.5


def test_the_sources_make_the_variance_that_was_drawn(finished: Path) -> None:
    table = pd.read_csv(finished / "interval_sources.csv").set_index(["source", "level"]).sort_index()
    drawn = table.loc[("as drawn", "impact"), "share"]
    # Of spreads that 16 impacts tell badly the sources take the median alone.
    assert drawn.between(0.7, 1.4).all()
    assert "What makes the intervals" in (finished / "report.html").read_text(encoding="utf-8")


def test_wrong_models_are_refused_before_anything_is_written(campaign: Path) -> None:
    model = campaign / "wrong.toml"
    model.write_text(
        'name = "w"\nlikelihood = "a2"\n[formula]\nK = "log(mass_kg) + energy_J + velocity_m_s"\n',
        encoding="utf-8",
    )
    refused = bayestissue("fit", campaign / "data", "--model", model, "--out", campaign / "refused")
    assert refused.status == 2
    assert "E = ½MV²" in refused.err
    assert not (campaign / "refused").exists()


@pytest.mark.long
def test_ten_kills_leave_the_draws_as_they_would_have_been(campaign: Path, tmp_path: Path) -> None:
    """Each tenth of a run's life has a kill at a random moment, and each resumed run the same draws."""
    model = model_file(campaign, draws=200)
    # What is compiled is kept, so that a life is summaries, sampling and writing rather than compilation.
    kept = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "compiled"), **ALWAYS_KEPT}
    environment = os.environ | kept
    whole, out = tmp_path / "whole", tmp_path / "killed"

    def fit(to: Path) -> list[str]:
        return command("fit", campaign / "data", "--model", model, "--out", to, "--quiet")

    for _ in range(2):
        shutil.rmtree(whole, ignore_errors=True)
        began = time.monotonic()
        assert subprocess.run(fit(whole), env=environment, check=False).returncode in (0, 3)  # noqa: S603
        lasted = time.monotonic() - began
    random = np.random.default_rng(5)
    for tenth in range(10):
        while True:
            began, moment = time.monotonic(), (tenth + random.uniform()) / 10 * lasted
            if killed(fit(out), environment, moment, hard=tenth % 2 == 0) and not out.exists():
                break
            # Lives differ in length: one that had its results before its moment is no kill.
            lasted = min(lasted, time.monotonic() - began)
            shutil.rmtree(out)
        resumed = subprocess.run(fit(out), env=environment, check=False)  # noqa: S603
        assert resumed.returncode in (0, 3)
        assert_same_draws(whole, out)
        assert not (out.parent / f".{out.name}.unfinished").exists()
        shutil.rmtree(out)


def killed(arguments: list[str], environment: dict[str, str], after_s: float, *, hard: bool) -> bool:
    """Whether a run could be ended after some seconds, as by the power going off, or by being asked to."""
    process = subprocess.Popen(arguments, env=environment, start_new_session=True)  # noqa: S603
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        if hard:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.send_signal(signal.SIGTERM)
        process.wait()
    print(f"{'SIGKILL' if hard else 'SIGTERM'} after {after_s:.1f} s: status {process.returncode}")  # noqa: T201
    return process.returncode not in (0, 3)


def assert_same_draws(first: Path, second: Path) -> None:
    with (
        xr.open_datatree(first / "posterior.nc", engine="h5netcdf") as one,
        xr.open_datatree(second / "posterior.nc", engine="h5netcdf") as other,
    ):
        for name, values in one["posterior"].data_vars.items():
            np.testing.assert_array_equal(values, other["posterior"][name], err_msg=str(name))
