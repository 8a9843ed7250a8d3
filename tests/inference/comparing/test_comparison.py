from __future__ import annotations

import arviz as az
import numpy as np
import pandas as pd
import xarray as xr
from numpy.testing import assert_allclose
from scipy.stats import norm

from bayestissue.inference.model_comparison import (
    BY_IMPACT,
    BY_TRIAL,
    COLUMNS,
    by_importance,
    by_trial,
)
from bayestissue.inference.results.cross_validation import prior_sensitivity


def test_by_trial_figures_worked_by_hand() -> None:
    table = by_trial({"worse": np.array([-2.0, -4.0, -3.0]), "better": np.array([-1.0, -2.0, -3.0])})
    assert list(table.columns) == COLUMNS
    assert list(table["model"]) == ["better", "worse"]
    assert set(table["scheme"]) == {BY_TRIAL}
    assert_allclose(table["elpd"], [-6, -9])
    # Standard error of a sum of three: √(3 · 1), each sample variance being 1.
    assert_allclose(table["se"], np.sqrt(3))
    # Differences −1, −2, 0: sum −3, variance 1.
    assert_allclose(table["elpd_difference"], [0, -3])
    assert_allclose(table["se_difference"], [0, np.sqrt(3)])
    assert table["warning"].str.contains("3 trials only").all()
    assert not by_trial({"one": np.linspace(-2, -1, 30)})["warning"].any()


def tree(log_likelihood: np.ndarray) -> xr.DataTree:
    dims = ("chain", "draw", "impact")
    return xr.DataTree.from_dict(
        {
            "posterior": xr.Dataset({"a": (dims[:2], np.zeros(log_likelihood.shape[:2]))}),
            "log_likelihood": xr.Dataset({"estimates": (dims, log_likelihood)}),
        }
    )


# Data y ~ N(0, 1), and draws of its mean under a flat prior.
RNG = np.random.default_rng(11)
Y = RNG.standard_normal(30)
MEAN = Y.mean() + RNG.standard_normal((4, 2000)) / np.sqrt(30)
RIGHT, WRONG = (norm(MEAN[..., None] + off, 1).logpdf(Y) for off in (0.0, 1.0))


def compared(scheme: str = BY_IMPACT, unit: str = "impacts", **models: np.ndarray) -> pd.DataFrame:
    trees = {name: tree(log_likelihood) for name, log_likelihood in models.items()}
    return by_importance(trees, scheme, unit).set_index("model")


def test_leave_one_impact_out_agrees_with_the_exact_answer() -> None:
    table = compared(wrong=WRONG, right=RIGHT)
    others = (Y.sum() - Y) / 29
    exact = norm(others, np.sqrt(1 + 1 / 29)).logpdf(Y).sum()
    assert list(table.index) == ["right", "wrong"]
    assert set(table["scheme"]) == {BY_IMPACT}
    # Thirty importance-sampled terms, each with a standard error near 1/√8000.
    assert_allclose(table.loc["right", "elpd"], exact, atol=4 * 30 / np.sqrt(8000) / 10)
    assert 0.5 < table.loc["right", "p_effective"] < 1.5
    assert table.loc["right", "weight"] > 0.95
    assert_allclose(table["weight"].sum(), 1, atol=1e-6)
    assert not table["warning"].any()


def test_weights_hold_where_the_densities_are_too_large_for_their_exponentials() -> None:
    # The log density of a trace of a few hundred samples in metres.
    table, bare = compared(wrong=WRONG + 4e3, right=RIGHT + 4e3), compared(wrong=WRONG, right=RIGHT)
    # The optimiser stops at a relative change of 1e-6 of a likelihood that is flat at its maximum.
    assert_allclose(table["weight"], bare["weight"], atol=1e-3)
    assert table.loc["right", "weight"] > 0.95


def test_a_model_alone_has_no_weight_and_few_people_are_warned_of() -> None:
    by_person = ("leave one subject out", "people")
    assert compared(*by_person, only=RIGHT)["weight"].isna().all()
    few = compared(*by_person, a=RIGHT[..., :9], b=RIGHT[..., :9])
    assert (few["warning"] == "9 people only: the standard errors are rough").all()


def test_draws_that_are_nearly_all_one_are_scored_and_not_trusted() -> None:
    # What a correction leaves where it trusts a single draw of each chain.
    stuck = np.broadcast_to(WRONG[:, :1], RIGHT.shape).copy()
    table = compared(stuck=stuck, right=RIGHT)
    assert list(table.index) == ["right", "stuck"]
    # Four draws, each as often: the harmonic mean of their densities.
    expected = -np.log(np.mean(np.exp(-stuck[:, 0]), axis=0)).sum()
    assert_allclose(table.loc["stuck", "elpd"], expected, rtol=1e-9)
    assert table.loc["stuck", "warning"].startswith("30 of 30 impacts with Pareto k above 0.7")
    assert not table.loc["right", "warning"]


def test_the_sensitivity_to_priors_and_data_is_arviz_s() -> None:
    rng = np.random.default_rng(0)
    dims = ("chain", "draw")
    mean, sd = rng.standard_normal((2, 4, 500))
    tree = xr.DataTree.from_dict(
        {
            "posterior": xr.Dataset({"mean": (dims, mean), "sd": (dims, np.exp(sd))}),
            "log_prior": xr.Dataset({"mean": (dims, -8 * mean**2), "sd": (dims, -0.1 * sd**2)}),
            "log_likelihood": xr.Dataset(
                {
                    "trace": (
                        (*dims, "impact"),
                        norm(mean[..., None], np.exp(sd)[..., None]).logpdf([0.1, 2.0]),
                    )
                }
            ),
        }
    )
    with np.errstate(invalid="ignore"):
        found = prior_sensitivity(tree).set_index("variable")
        expected = az.psense_summary(tree, round_to=4)
    pd.testing.assert_frame_equal(found, expected, check_names=False)
    assert "potential prior-data conflict" in set(found["diagnosis"])
