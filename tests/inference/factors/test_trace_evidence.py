"""Log densities for cross-validation are the traces' own, whatever stands for the traces meanwhile."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp

from bayestissue.inference.chain.results import ChainDraws
from bayestissue.inference.factors.conditional import conditional_priors
from bayestissue.inference.factors.scores import log_densities
from bayestissue.inference.samplers.sampling import flat
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.trace_data import Prepared
from chain_of_sites import chain_of_sites
from gaussian_traces import prepared

pytestmark = pytest.mark.slow

PEOPLE = {"subject": list("aabbcc"), "trial": ["x", "y"] * 3, "mass_kg": [0.5, 1.0] * 3}
DRAWS = 4000


@pytest.fixture(scope="module")
def made() -> Prepared:
    """Three people, each hit twice."""
    return prepared("log(mass_kg) + (1|subject)", PEOPLE)


@pytest.fixture(scope="module")
def chains(made: Prepared) -> ChainDraws:
    """Draws, independent, of a posterior whose traces are normal."""
    rng = np.random.default_rng(3)
    centre = np.array([8.0, 3.0, -5.0]) + 0.2 * rng.normal(size=(6, 3))
    precision = np.broadcast_to(np.diag([1 / 0.1**2, 1 / 0.2**2, 1 / 0.2**2]), (6, 3, 3))
    traces = GaussianFactor(centre, np.zeros((6, 3)), precision, np.zeros(6))
    y = rng.normal(-1.5, 0.3, (4, DRAWS // 4, len(made.model.hyperparameters)))
    return chain_of_sites(made, traces, y, rng)


def scores_by(made: Prepared, chains: ChainDraws, sites: GaussianFactor) -> dict[str, np.ndarray]:
    u = chains.u.reshape(DRAWS, 6, 3)
    ratio = np.asarray(chains.sites.log_density(u)) - np.asarray(sites.log_density(u))
    return scored(made, chains, sites, ratio)


def scored(
    made: Prepared, chains: ChainDraws, sites: GaussianFactor, ratio: np.ndarray
) -> dict[str, np.ndarray]:
    """The scores, likelihoods over sites being these at every draw."""
    ratio = ratio.reshape(*chains.shape, 6)
    groups = {
        name: np.stack([ratio[..., each.code == n].sum(-1) for n in range(len(each.levels))], axis=-1)
        for name, each in made.design.groupings.items()
    }
    scores = log_densities(made, sites, chains.population, {"impact": ratio, **groups}, np.arange(6))
    of_all: dict[str, np.ndarray] = flat(scores)
    return of_all


@pytest.mark.parametrize("scheme", ["trace", "traces_of_subject"])
def test_leaving_out_gives_the_same_whatever_the_sites_are(made, chains, scheme) -> None:
    """By sites that are the traces nothing is left to the draws; by others it is that on average.

    What leaving out weighs draws by is one over a score. Given the population its mean is the same by any
    sites, and so the mean over the draws.
    """
    exact = scores_by(made, chains, chains.sites)[scheme]
    # Off by half of what a trace tells, and wider: a weight's variance is finite.
    off = jax.tree.map(jnp.asarray, chains.sites)._replace(
        centre=chains.sites.centre + np.array([0.05, -0.1, 0.1]),
        precision=0.8 * chains.sites.precision,
        log_scale=np.full(6, 0.3),
    )
    by_others = scores_by(made, chains, GaussianFactor(*map(np.asarray, off)))[scheme]
    difference = np.exp(exact - by_others) - 1
    error = difference.std(0) / np.sqrt(DRAWS)
    # Twelve means of independent draws at most: one in a thousand runs is beyond 4.
    assert (np.abs(difference.mean(0)) < 4 * error).all()
    assert (error < 0.05).all()


def test_an_impact_s_density_is_its_likelihood_integrated_over_the_population(made, chains) -> None:
    """By points of the population, with no site."""
    scores, rng = scores_by(made, chains, chains.sites)["trace"], np.random.default_rng(1)
    priors = conditional_priors(made.model, made.data.design, chains.population, np.arange(6))
    mean, precision = flat((priors.mean, priors.precision))
    for draw in (0, 1000, 3999):
        root = np.linalg.cholesky(np.linalg.inv(precision[draw, 0]))
        u = mean[draw] + np.matvec(root, rng.standard_normal((40_000, 6, 3)))
        value = np.asarray(chains.sites.log_density(u))
        direct = logsumexp(value, axis=0) - np.log(len(u))
        weight = np.exp(value - direct)
        error = weight.std(0) / np.sqrt(len(u))
        assert (np.abs(direct - scores[draw]) < 5 * error).all()


def test_an_impact_without_a_density_takes_only_its_own_groups(made: Prepared, chains: ChainDraws) -> None:
    ratio = np.zeros((DRAWS, 6))
    whole = scored(made, chains, chains.sites, ratio)
    ratio[:, 0] = -np.inf
    without = scored(made, chains, chains.sites, ratio)
    expected = whole["traces_of_subject"].copy()
    expected[:, made.design.groupings["subject"].code[0]] = -np.inf
    np.testing.assert_array_equal(without["traces_of_subject"], expected)
