"""Of several transitions one draw is kept; what the others tell of the sampler is not lost."""

from __future__ import annotations

import numpy as np

from bayestissue.inference.results.labels import labelled_statistics
from bayestissue.inference.samplers.sampling import Draws


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
    every, kept = labelled_statistics(whole, of_transitions=True), labelled_statistics(whole.thinned(4))
    assert int(every["diverging"].sum()) == int(whole.statistics["diverging"].sum()) > 0
    np.testing.assert_array_equal(
        kept["diverging"], whole.statistics["diverging"].reshape(2, 3, 4).any(axis=-1)
    )


def test_without_thinning_nothing_changes() -> None:
    whole = _draws()
    np.testing.assert_array_equal(whole.thinned(1).sites["x"], whole.sites["x"])
    assert labelled_statistics(whole).identical(labelled_statistics(whole, of_transitions=True))
