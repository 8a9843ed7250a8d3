"""A run of the chain: its draws follow from the seed, a stop changes nothing, both explanations are seen."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from numpy.testing import assert_array_equal
from numpyro.distributions import biject_to

from bayestissue.base import runtime
from bayestissue.inference.chain import draws as chain
from bayestissue.inference.chain.chain_settings import ChainSettings
from bayestissue.inference.chain.draws import ChainJob, chain_draws
from bayestissue.inference.chain.results import ChainDraws, ChainEnd
from bayestissue.inference.chain.run import read_arrays, write_arrays
from bayestissue.inference.chain.target import Target
from bayestissue.inference.samplers.sampling import convergence
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import Sampler
from gaussian_traces import TOLD, GaussianTarget, MixtureTarget, from_prior, prepared, target_of

PEOPLE = {"subject": list("aabb"), "trial": ["x", "y"] * 2, "mass_kg": [0.5, 1.0] * 2}
K = "log(mass_kg) + (1|subject)"
# What is asked of a stop needs few transitions.
SHORT = ChainSettings(segment=20, most_rounds=1, first_look=2)
FEW = Sampler(chains=2, transitions=100)


@pytest.fixture(scope="module")
def people() -> GaussianTarget:
    """Two people, each hit twice, whose traces were drawn from the prior."""
    return from_prior(target_of(prepared(K, PEOPLE)), jax.random.PRNGKey(4))[0]


def drawn(
    target: Target,
    sites: GaussianFactor,
    monkeypatch: pytest.MonkeyPatch,
    seed: int = 1,
    sampler: Sampler = FEW,
    settings: ChainSettings | None = None,
    checkpoints: Path | None = None,
) -> ChainDraws:
    """Draws of a target that stands for that of a fit; its sites [site, impact, ...]."""
    monkeypatch.setattr(chain.Target, "from_prepared", lambda _: target)
    count = int(target.present.sum())
    here = GaussianFactor(*(np.asarray(leaf)[:, :count] for leaf in sites))
    table = {name: values[:count] for name, values in PEOPLE.items()}
    job = ChainJob(prepared(K if count > 1 else "1", table), sampler, seed, checkpoints=checkpoints)
    return next(chain_draws(job, here, settings))


@pytest.mark.slow
def test_draws_follow_from_the_seed_and_a_stop_changes_none(people, monkeypatch, tmp_path: Path):
    sites = jax.tree.map(lambda leaf: leaf[None], people.traces)
    with monkeypatch.context() as patch:
        # Of chains one after the other; those that follow are side by side.
        patch.setattr(runtime, "cores", lambda: 1)
        whole = drawn(people, sites, monkeypatch, settings=SHORT, checkpoints=tmp_path)
    monkeypatch.setattr(runtime, "cores", lambda: 2)
    segments = sorted(tmp_path.iterdir())
    assert len(segments) == 2 * whole.end.segments
    # As if killed amid the warm-up, and amid what follows; and with nothing to do.
    for left in (3, len(segments) - 5, len(segments)):
        for path in sorted(tmp_path.iterdir(), key=lambda path: path.name[-8:])[left:]:
            path.unlink()
        again = drawn(people, sites, monkeypatch, settings=SHORT, checkpoints=tmp_path)
        jax.tree.map(assert_array_equal, again.population, whole.population)
        for name in ("u", "log_likelihood"):
            assert_array_equal(getattr(again, name), getattr(whole, name))
    other = drawn(people, sites, monkeypatch, seed=2, settings=SHORT)
    assert not np.array_equal(other.population.b, whole.population.b)
    few = whole.thinned(10)
    assert few.population.b.shape[:2] == (2, 10)
    assert_array_equal(few.u[:, -1], whole.u[:, -1])


@pytest.mark.slow
def test_what_goes_on_is_the_longer_run(people, monkeypatch, tmp_path: Path):
    sites = jax.tree.map(lambda leaf: leaf[None], people.traces)
    # Neither is ended by its draws: the first has 5 segments, both together 12.
    long, short, rest = (Sampler(chains=2, effective=100_000, transitions=20 * n) for n in (12, 5, 7))
    whole = drawn(people, sites, monkeypatch, sampler=long, settings=SHORT)
    first = drawn(people, sites, monkeypatch, sampler=short, settings=SHORT)
    first.end.write(tmp_path / "chain.npz")
    end = ChainEnd.read(tmp_path / "chain.npz")
    second = next(chain_draws(ChainJob(prepared(K, PEOPLE), rest, 1), end, SHORT))
    count = second.shape[1]
    assert count == 20 * (7 - int(SHORT.dropped * 7))
    of_whole = jax.tree.map(lambda values: values[:, -count:], whole.population)
    jax.tree.map(assert_array_equal, second.population, of_whole)
    for name in ("log_likelihood", "u"):
        assert_array_equal(getattr(second, name), getattr(whole, name)[:, -count:])
    assert (int(second.end.segments), second.segments) == (int(whole.end.segments), 7)
    assert "of earlier runs" in second.record()["words"]


def test_arrays_that_were_changed_are_known(tmp_path: Path):
    """Another shape of one array ended in a traceback, where the run had lost the mark of its files."""
    path, tree = tmp_path / "chain.npz", {"u": np.zeros((2, 3)), "y": np.ones(2)}
    write_arrays(path, tree)
    jax.tree.map(assert_array_equal, read_arrays(path, tree), tree)
    with np.load(path) as stored:
        changed = dict(stored) | {"['u']": np.zeros((2, 2))}
    np.savez(path, **changed)
    with pytest.raises(ValueError, match=r"chain\.npz"):
        read_arrays(path, tree)


@pytest.mark.long
def test_a_trace_with_two_explanations_gets_both_with_their_probabilities(monkeypatch):
    alone = prepared("1", {"subject": ["a"], "mass_kg": [0.8]})
    plain = from_prior(target_of(alone), jax.random.PRNGKey(5))[0]
    apart = jnp.asarray(12 * TOLD)
    traces = plain.traces
    both = GaussianFactor(
        jnp.stack([traces.centre, traces.centre + apart]),
        jnp.zeros((2, *traces.shift.shape)),
        jnp.stack([traces.precision, traces.precision]),
        jnp.stack([traces.log_scale, traces.log_scale - 1.0]),
    )
    target = MixtureTarget(**{**vars(plain), "traces": both})
    draws = drawn(target, both, monkeypatch, settings=ChainSettings(first_look=40), sampler=Sampler(chains=2))
    nearer = ((draws.u[..., 0, :] - np.asarray(both.centre[0, 0])) / apart).mean(-1) > 0.5
    size = convergence(nearer[None].astype(float)).ess_mean[0]
    expected, error = probability_of_second(target)
    assert 0.02 < expected < 0.98
    assert abs(nearer.mean() - expected) < 4 * np.hypot(np.sqrt(expected * (1 - expected) / size), error)


def probability_of_second(target: MixtureTarget) -> tuple[float, float]:
    """By the evidence of either, averaged over the prior of the hyperparameters; and its standard error."""

    def evidence(key: Array) -> Array:
        keys = jax.random.split(key, len(target.model.hyperparameters))
        values = [
            (biject_to(prior.support).inv(prior.sample(key)))
            for prior, key in zip(map(target.model.prior_of, target.model.hyperparameters), keys, strict=True)
        ]
        y = jnp.stack(values)
        of_each = [
            target.given_sites(y, target.blocked(jax.tree.map(lambda leaf: leaf[n], target.traces)))  # noqa: B023
            for n in range(2)
        ]
        return jnp.stack([each.log_density - target.log_prior(y) for each in of_each])

    log_evidence = np.asarray(jax.jit(jax.vmap(evidence))(jax.random.split(jax.random.PRNGKey(8), 20_000)))
    weights = np.exp(log_evidence - np.nanmax(log_evidence))
    weights = np.where(np.isfinite(weights), weights, 0.0)
    second = weights[:, 1].sum() / weights.sum()
    residual = weights[:, 1] - second * weights.sum(1)
    return float(second), float(residual.std() / weights.sum(1).mean() / np.sqrt(len(weights)))
