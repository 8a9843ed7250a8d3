"""Of several transitions one draw is kept; what the others tell of the sampler is not lost."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist

from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.results.labels import labelled_statistics, statistics_of_transitions
from bayestissue.inference.samplers.sampling import Draws, PosteriorSampler


def _draws(transitions: int = 12) -> Draws:
    rng = np.random.default_rng(0)
    shape = (2, transitions)
    statistics = {
        "diverging": rng.random(shape) < 0.2,
        "num_steps": rng.integers(1, 16, shape),
        "accept_prob": rng.random(shape),
        "energy": rng.standard_normal(shape),
        "potential_energy": rng.standard_normal(shape),
    }
    return Draws({"x": rng.standard_normal((*shape, 3))}, statistics, 10)


def test_the_last_transition_of_each_block_is_the_draw() -> None:
    whole = _draws()
    kept = whole.thinned(3)
    np.testing.assert_array_equal(kept.sites["x"], whole.sites["x"][:, [2, 5, 8, 11]])
    found = labelled_statistics(kept)
    assert found.sizes == {"chain": 2, "draw": 4}
    np.testing.assert_array_equal(found["energy"], whole.statistics["energy"][:, 2::3])
    blocks = whole.statistics["num_steps"].reshape(2, 4, 3)
    np.testing.assert_array_equal(found["n_steps"], blocks.sum(-1))
    assert found.attrs["max_tree_depth"] == 10


def test_no_divergence_is_lost() -> None:
    whole = _draws()
    every, kept = statistics_of_transitions(whole), labelled_statistics(whole.thinned(4))
    assert int(every["diverging"].sum()) == int(whole.statistics["diverging"].sum()) > 0
    np.testing.assert_array_equal(
        kept["diverging"], whole.statistics["diverging"].reshape(2, 3, 4).any(axis=-1)
    )


def test_without_thinning_nothing_changes() -> None:
    whole = _draws()
    np.testing.assert_array_equal(whole.thinned(1).sites["x"], whole.sites["x"])
    assert labelled_statistics(whole).identical(statistics_of_transitions(whole))


def test_a_sampler_keeps_as_many_draws_as_it_was_asked_for() -> None:
    def model(y: jnp.ndarray) -> None:
        numpyro.sample("y", dist.Normal(numpyro.sample("mean", dist.Normal(0.0, 3.0)), 1.0), obs=y)

    settings = Sampler(chains=2, warmup=100, draws=100, thinning=3)
    (found,) = PosteriorSampler(model, settings).run(0, [(jnp.zeros(3),)])
    assert found.sites["mean"].shape == (2, 100)
    assert found.statistics["diverging"].shape == (2, 300)
