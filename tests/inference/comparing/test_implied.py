from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.stats import norm

from bayestissue.inference.comparing import FinishedRun, comparable_draws, implied, mixture
from bayestissue.results.tables import columns_of

DRAWS = 4000
PEOPLE = np.array(["s0", "s1", "s0"])


def run(name: str, variables: dict[str, float], element: str = "kelvin_voigt") -> FinishedRun:
    """Draws of three impacts, each log-normal about a value of its own with 1 %."""
    rng = np.random.default_rng(len(name))
    of_impact = np.array([0.9, 1.0, 1.2])
    posterior = xr.Dataset(
        {
            variable: (
                ("chain", "draw", "impact"),
                value * of_impact * np.exp(0.01 * rng.standard_normal((2, DRAWS // 2, 3))),
            )
            for variable, value in variables.items()
        }
    )
    constants = xr.Dataset({"impact_subject": (("impact",), PEOPLE)})
    tree = xr.DataTree.from_dict({"posterior": posterior, "constant_data": constants})
    return FinishedRun(name, {"likelihood": "impact", "element": element}, tree)


def weights(**of_runs: float) -> pd.DataFrame:
    rows = [("leave one impact out", "deceleration", name, weight) for name, weight in of_runs.items()]
    return pd.DataFrame(rows, columns=["scheme", "data", "model", "weight"])


def test_quantiles_are_those_of_the_mixture() -> None:
    rng = np.random.default_rng(3)
    draws = [xr.DataArray(m + rng.standard_normal((4, 2500)), dims=("chain", "draw")) for m in (0.0, 3.0)]
    # A run of fewer draws weighs no less for it.
    found = mixture({"a": (0.75, draws[0]), "b": (0.25, draws[1][:, :500])}).iloc[0]

    def below(x: float) -> float:
        return 0.75 * norm.cdf(x) + 0.25 * norm.cdf(x - 3)

    for name, p in (("eti90_low", 0.05), ("median", 0.5), ("eti90_high", 0.95)):
        true = brentq(lambda x, p=p: below(x) - p, -9, 9)
        # Shares of 10,000 draws of one and 2000 of the other, seen through the mixture's density.
        density = 0.75 * norm.pdf(true) + 0.25 * norm.pdf(true - 3)
        variance = 0.75**2 * 0.25 / 10_000 + 0.25**2 * 0.25 / 2000
        assert_allclose(found[name], true, atol=4 * np.sqrt(variance) / density)


def test_all_weight_on_one_run_gives_its_own_figures() -> None:
    one, other = run("one", {"K": 1000.0, "C": 20.0}), run("other", {"K": 2000.0, "C": 30.0})
    table = implied([one, other], weights(one=1.0, other=0.0))
    assert list(table.columns) == columns_of("implied")
    by_name = table.set_index(["variable", "label"])
    # Each geometric mean of three log-normal draws of 1 %.
    middle = 1000 * np.prod([0.9, 1.0, 1.2]) ** (1 / 3)
    se = 0.01 / np.sqrt(3)
    row = by_name.loc[("K_secant_of_impacts", "")]
    assert_allclose(row["median"], middle, rtol=4 * 1.25 * se / np.sqrt(DRAWS))
    width = 2 * 1.645 * se * middle
    # A 5 % quantile's standard error is 2.11 standard deviations over the root of the draws.
    assert_allclose(
        row["eti90_high"] - row["eti90_low"], width, rtol=4 * np.sqrt(2) * 2.11 / 3.29 / np.sqrt(DRAWS)
    )
    assert_allclose(by_name.loc[("C_equivalent_of_subject", "s1"), "median"], 20.0, rtol=1e-2)
    assert row["unit"] == "N/m"
    assert row["runs"] == 1


def test_what_means_the_same_is_mixed_and_not_the_elements_own_k() -> None:
    side = run("side", {"K": 1000.0, "C": 20.0})
    series = run("series", {"K": 5000.0, "K_secant": 1100.0, "C": 90.0, "C_equivalent": 21.0}, "maxwell")
    table = implied([side, series], weights(side=0.5, series=0.5)).set_index(["variable", "label"])
    row = table.loc[("K_secant_of_impacts", "")]
    middle = np.prod([0.9, 1.0, 1.2]) ** (1 / 3)
    assert 1000 * middle < row["median"] < 1100 * middle
    # Half of the draws of each lie beyond the other's.
    assert_allclose([row["eti90_low"], row["eti90_high"]], [middle * 1000, middle * 1100], rtol=0.02)


def test_nothing_is_told_where_runs_that_weigh_lack_it() -> None:
    whole, bare = run("whole", {"K": 1000.0, "C": 20.0}), run("bare", {"C": 30.0})
    names = set(implied([whole, bare], weights(whole=0.6, bare=0.4))["variable"])
    assert names == {"C_equivalent_of_impacts", "C_equivalent_of_subject"}
    assert "K_secant_of_impacts" in set(implied([whole, bare], weights(whole=0.999, bare=0.001))["variable"])


def test_runs_without_weights_imply_nothing() -> None:
    table = implied([run("only", {"K": 1.0, "C": 1.0})], weights(only=np.nan))
    assert list(table.columns) == columns_of("implied")
    assert table.empty


@pytest.mark.parametrize("dimension", ["draw", "kept_draw"])
def test_people_are_the_means_of_their_own_impacts(dimension: str) -> None:
    values = np.array([100.0, 300.0, 400.0])
    posterior = xr.Dataset({"K": (("chain", dimension, "impact"), np.tile(values, (2, 3, 1)))})
    found = comparable_draws(posterior, PEOPLE)
    assert found["K_secant_of_impacts"].dims == ("chain", dimension)
    assert_allclose(found["K_secant_of_impacts"], np.prod(values) ** (1 / 3))
    assert_allclose(found["K_secant_of_subject"].sel(subject="s0"), 200.0)
    assert_allclose(found["K_secant_of_subject"].sel(subject="s1"), 300.0)
