from __future__ import annotations

from dataclasses import replace

import arviz as az
import numpy as np
import pytest
import xarray as xr

from bayestissue import Fit, read_run
from bayestissue.base.errors import InputError
from bayestissue.base.results.tables import columns_of
from bayestissue.inference.answers.questions import ask, ask_what_can_be, numbered, of_model
from cases import cases
from make_fit_run import make_fit_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    return read_run(make_fit_run(tmp_path_factory.mktemp("asked") / "run"))


@pytest.fixture(scope="module")
def draws(run: Fit) -> xr.Dataset:
    return run.posterior["posterior"].dataset


def test_a_claim_has_probability_prior_bayes_factor_and_error(run: Fit, draws: xr.Dataset) -> None:
    row = run.ask("K[subject=s1] / K[subject=s2] > 0.9").iloc[0]
    prior = run.posterior["prior"].dataset

    def true(of: xr.Dataset) -> np.ndarray:
        effect = of["subject_effect_K"]
        return (np.exp(effect.sel(subject="s1") - effect.sel(subject="s2")) > 0.9).to_numpy()

    p, p_0 = true(draws).mean(), true(prior).mean()
    assert row["posterior"] == pytest.approx(p)
    assert row["prior"] == pytest.approx(p_0)
    assert row["bayes_factor"] == pytest.approx(p / (1 - p) / (p_0 / (1 - p_0)))
    assert row["mcse"] == pytest.approx(float(az.mcse(true(draws).astype(float))), rel=1e-6)
    assert (row["draws"], row["prior_draws"]) == (200, 300)


def test_a_number_that_the_data_leave_as_it_was_says_so(run: Fit) -> None:
    as_before = replace(run.study, prior=run.study.draws)
    told = ask(as_before, numbered(["K[mass_kg=1.2]", "K[mass_kg=1.2] > 2400"]))
    assert told["note"].str.contains("largely prior: the two overlap by 100 %").tolist() == [True, False]
    assert (run.ask("K[mass_kg=1.2]")["note"] == "").all()


def test_an_expression_has_a_median_and_an_interval(run: Fit, draws: xr.Dataset) -> None:
    row = run.ask("K[subject=s1, mass_kg=1.4] / 1000").iloc[0]
    log = (
        draws["intercept_K"]
        + draws["subject_effect_K"].sel(subject="s1")
        + draws["mass_exponent_K"] * np.log(1.4 / run.study.recorded.reference_mass_kg)
    )
    expected = np.exp(log).to_numpy() / 1000
    assert [row["low"], row["median"], row["high"]] == pytest.approx(np.quantile(expected, [0.05, 0.5, 0.95]))
    assert row["mcse"] == pytest.approx(float(az.mcse(expected, method="median")), rel=1e-6)
    assert np.isnan(row["posterior"])


def test_what_quantities_mean(run: Fit, draws: xr.Dataset) -> None:
    people = draws["K_subject"]
    expected = {
        "K": np.exp(draws["intercept_K"]),
        "mean(K[subject])": np.exp(draws["intercept_K"] + draws["subject_effect_K"]).mean("subject"),
        "max(K_subject) - min(K_subject)": people.max("subject") - people.min("subject"),
        "K_new": draws["K_new"],
        "sd_subject_C": draws["sd_subject_C"],
        "K[impact=t0-s1]": draws["K"].sel(impact="t0-s1"),
        "subject_effect_K[subject=s3]": draws["subject_effect_K"].sel(subject="s3"),
        "mean(C[subject, trial=t1] / C[subject])": np.exp(draws["trial_effect_C"].sel(trial="t1")),
    }
    found = run.ask(*expected).set_index("question")["median"]
    for question, values in expected.items():
        assert found[question] == pytest.approx(float(values.median())), question


@pytest.mark.slow
def test_a_number_has_the_unit_of_its_quantities_where_they_share_one(run: Fit) -> None:
    expected = dict(cases(__file__, "units"))
    assert run.ask(*expected).set_index("question")["unit"].to_dict() == expected


def test_a_bayes_factor_that_draws_can_not_give_is_left_out_with_the_reason(run: Fit) -> None:
    table = run.ask("mass_exponent_K < 0.5", "K > 1", "K_new > 0")
    assert table["bayes_factor"].isna().all()
    assert table["note"].str.contains("Bayes factor").all()
    # Not one draw of 200 is against it, which is not to be sure of it.
    assert 0.003 < table["mcse"].max() < 0.006


def test_a_run_without_prior_draws_says_so(run: Fit) -> None:
    tree = xr.DataTree.from_dict({k: run.posterior[k].dataset for k in ("posterior", "constant_data")})
    row = replace(run, posterior=tree).ask("K > 2500").iloc[0]
    assert 0 < row["posterior"] < 1
    assert np.isnan(row["prior"])
    assert "no prior" in row["note"]


def test_all_that_is_wrong_is_told_with_its_place_and_near_names(run: Fit) -> None:
    asked = cases(__file__, "wrong")
    with pytest.raises(InputError) as error:
        run.ask(*(question for question, _ in asked))
    told = [str(problem) for problem in error.value.problems]
    for text, words in zip(told, [words for _, words in asked if words], strict=True):
        assert words in text
    assert told[0].splitlines()[1:] == ["    K[subject=s7] > 1", "    " + 10 * " " + "^"]


def test_a_model_files_question_without_an_answer_says_why(run: Fit) -> None:
    table = ask_what_can_be(run.study, of_model({"a": "K > 2500", "b": "K_strange > 1"}, "m.toml"))
    assert table.columns.tolist() == columns_of("questions")
    assert table["name"].tolist() == ["a", "b"]
    assert table["posterior"].notna().tolist() == [True, False]
    assert "K_strange" in table["note"][1]
    with pytest.raises(InputError, match=r"m.toml, questions.b, column 1"):
        ask(run.study, of_model({"a": "K > 2500", "b": "K_strange > 1"}, "m.toml"))
