from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpy.testing import assert_array_equal

from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.samplers import nuts as chains
from bayestissue.inference.samplers.nuts import Start, run_chains

SETTINGS = Sampler(chains=2, warmup=200, draws=300)
START = Start({"mean": np.array(0.0), "z": np.zeros(2)}, "mean", np.array([[0.04]]))


def model(y):
    mean = numpyro.sample("mean", dist.Normal(0.0, 10.0))
    numpyro.sample("z", dist.Normal().expand([2]).to_event(1))
    numpyro.sample("y", dist.Normal(mean, 1.0), obs=y)


def run(y, **options):
    return run_chains(model, (jnp.asarray(y),), START, SETTINGS, 3, processes=False, **options)


@pytest.fixture(scope="module")
def y():
    return np.random.default_rng(1).normal(size=25)


def test_draws_are_of_the_posterior_and_its_shape(y):
    draws = run(y).sites
    assert draws["mean"].shape == (2, 300)
    assert draws["z"].shape == (2, 300, 2)
    # The posterior is N(mean of y, 1 / 25); 600 draws are worth at least 150 independent ones.
    assert draws["mean"].mean() == pytest.approx(y.mean(), abs=4 * 0.2 / np.sqrt(150))
    assert draws["mean"].std() == pytest.approx(0.2, rel=4 / np.sqrt(2 * 150))


def test_an_interrupted_run_goes_on_with_the_same_draws(y, tmp_path):
    whole = run(y, checkpoints=tmp_path).sites
    for path in tmp_path.glob("chain-1-segment-000[2-4].npz"):
        path.unlink()
    again = run(y, checkpoints=tmp_path).sites
    for name in whole:
        assert_array_equal(again[name], whole[name])


def test_other_data_of_the_same_shape_cost_no_compilation(y):
    first = run(y).sites["mean"]
    compiled = chains._compiled(model, "mean", ("z",), 200, SETTINGS.target_accept, 10)
    before = compiled.advance._cache_size()
    second = run(y + 5.0).sites["mean"]
    assert compiled.advance._cache_size() == before
    assert second.mean() - first.mean() == pytest.approx(5.0, abs=0.2)
