from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from bayestissue.base.errors import InputError
from bayestissue.base.resources import shared
from bayestissue.model.hierarchy.priors import Correlation, HalfStudentT, Priors
from bayestissue.model.hierarchy.specification import read_specification


def test_the_model_file_that_comes_with_the_program_states_the_default_priors() -> None:
    specification = read_specification(shared("models", "published.toml"))
    assert specification.priors == Priors()
    assert specification.likelihood == "published-estimates"
    assert len(specification.comparison.formulas) == 6


def test_all_that_is_wrong_with_a_model_file_is_said_at_once(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(
        'name = "x"\nlikelihood = "guess"\n[sampler]\nchains = 1\ndraws = 1000000000\n'
        '[priors.sd_trial]\nK = { distribution = "half-normal", scale = -1.0 }\n'
        'C = { distribution = "cauchy", scale = 1.0 }\n',
        encoding="utf-8",
    )
    with pytest.raises(InputError) as caught:
        read_specification(path)
    said = str(caught.value)
    for word in ("published-estimates", "chains", "less than or equal to 100000", "priors.sd_trial.K"):
        assert word in said, word
    assert len(caught.value.problems) >= 4


def test_log_densities_are_those_of_the_stated_distributions() -> None:
    sites = {
        "mass_exponent_K": np.array([[0.2, -1.0]]),
        "sd_impact_C": np.array([[0.1, 2.0]]),
        "residual_correlation": np.array([[-0.5, 0.9]]),
        "subject_effect_K": np.zeros((1, 2, 10)),
    }
    found = jax.jit(Priors().log_densities)(sites)
    assert set(found) == {"mass_exponent_K", "sd_impact_C", "residual_correlation"}
    assert_allclose(found["mass_exponent_K"], stats.norm(0.5, 1).logpdf(sites["mass_exponent_K"]), rtol=1e-12)
    assert_allclose(found["sd_impact_C"], stats.halfnorm(scale=1).logpdf(sites["sd_impact_C"]), rtol=1e-12)
    r = sites["residual_correlation"]
    assert_allclose(found["residual_correlation"], np.log(0.75 * (1 - r**2)), rtol=1e-12)


def test_a_half_student_t_is_folded_and_a_flat_lkj_is_uniform() -> None:
    x = np.array([0.1, 0.5, 4.0])
    half = HalfStudentT(distribution="half-student-t", df=3, scale=0.5)
    assert_allclose(
        jax.jit(half.numpyro().log_prob)(x), np.log(2) + stats.t(3, scale=0.5).logpdf(x), rtol=1e-12
    )
    flat = Correlation(distribution="lkj", concentration=1)
    assert_allclose(jax.jit(flat.numpyro().log_prob)(np.array([-0.9, 0.3])), np.log(0.5), rtol=1e-12)


def test_a_discrepancy_is_the_impact_likelihood_s_alone(tmp_path: Path) -> None:
    assert read_specification(shared("models", "impact.toml")).discrepancy == "automatic"
    assert read_specification(shared("models", "arma.toml")).discrepancy == "none"
    path = tmp_path / "model.toml"
    for text, choice in (
        ('likelihood = "a2"\ndiscrepancy = "always"\n', "always"),
        ('likelihood = "impact"\ndiscrepancy = "always"\n[signal]\nwindow = 0.5\n', "always"),
        ('likelihood = "impact"\ndiscrepancy = "some"\n', "some"),
    ):
        path.write_text(f'name = "x"\n{text}', encoding="utf-8")
        with pytest.raises(InputError) as refused:
            read_specification(path)
        (problem,) = refused.value.problems
        assert (problem.column, problem.value, problem.row) == ("discrepancy", choice, 3)


def test_a_model_file_without_a_name_has_its_own(tmp_path: Path) -> None:
    path = tmp_path / "calves.toml"
    path.write_text('likelihood = "impact"\n', encoding="utf-8")
    assert read_specification(path).name == "calves"


def test_keys_of_an_earlier_sampler_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text('likelihood = "impact"\n[sampler]\npath = "exact"\nwarmup = 400\ndraws = 500\n')
    with pytest.raises(InputError) as refused:
        read_specification(path)
    assert {(problem.column, problem.code) for problem in refused.value.problems} == {
        ("sampler.path", "retired"),
        ("sampler.warmup", "retired"),
    }
