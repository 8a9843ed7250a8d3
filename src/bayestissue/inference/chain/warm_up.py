"""Where the chains begin, and what they learn before their draws count.

Every impact begins at its own best explanations, the hyperparameters overdispersed, where the impacts alone
put them. Then follow rounds of transitions: steps follow their acceptances; after each round the covariances
of y and of every u, and each site, are taken from what the chains have visited. A site becomes the parabola
nearest to the log likelihoods at those points, which are known already.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.inference.chain.moves import State, Steps, Tuning
from bayestissue.inference.chain.target import Target
from bayestissue.inference.factors.sites import DEEPEST, nearest_parabolas

# Where hyperparameters begin, and how far apart: a fifth of a prior's scale, give or take a few times.
_BEGIN, _APART, _ROOT = -1.5, 1.0, 0.5
# What keeps an estimated covariance from being singular, of the first one.
_SHRUNK, _OF_IMPACT = 0.02, 0.2


class WalkStart(NamedTuple):
    """How a walk of the hyperparameters begins.

    Attributes:
        y: of each chain, unconstrained and overdispersed.
        root: Cholesky factor of a covariance.
        step: length of a step, in units of it.
    """

    y: Float[np.ndarray, "chain hyperparameter"]
    root: Float[np.ndarray, "hyperparameter hyperparameter"]
    step: Float[np.ndarray, ""]


def walk_start(chains: int, number: int, rng: np.random.Generator) -> WalkStart:
    """Of so many chains and hyperparameters."""
    y = _BEGIN + _APART * rng.standard_normal((chains, number))
    # An array of numpy: one that jax makes of a number has another type, and would be compiled for apart.
    return WalkStart(y, _ROOT * np.eye(number), np.asarray(2.4 / np.sqrt(number)))


def root_of(
    y: Float[np.ndarray, "draw hyperparameter"], first: Float[np.ndarray, "hyperparameter hyperparameter"]
) -> Float[np.ndarray, "hyperparameter hyperparameter"]:
    """Cholesky factor of the covariance of draws, and of a little of the ``first`` one's."""
    number = y.shape[1]
    return np.linalg.cholesky(np.cov(y.T).reshape(number, number) + _SHRUNK * first @ first.T)


class Start(NamedTuple):
    """Where chains begin, and with what.

    Attributes:
        states: of each chain.
        steps: of each chain.
        tuning: of all of them.
    """

    states: list[State]
    steps: list[Steps]
    tuning: Tuning


def begin(target: Target, sites: GaussianFactor, chains: int, rng: np.random.Generator) -> Start:
    """Chains at the best explanation of each impact, another one in each chain where there are several.

    Args:
        target: the posterior.
        sites: of all impacts, [site, impact, ...]; where an impact has fewer the others say nothing.
        chains: how many there are.
        rng: for where the hyperparameters begin.
    """
    impacts, size = sites.centre.shape[1:]
    explained = (np.asarray(sites.log_scale) > -np.inf).sum(0)
    best = [chain % np.maximum(explained, 1) for chain in range(chains)]
    u = np.stack([np.asarray(sites.centre)[which, np.arange(impacts)].T for which in best])
    y, root, step = walk_start(chains, len(target.model.hyperparameters), rng)
    states = [
        State(jnp.asarray(y_of), target.data.location_mean, jnp.asarray(u_of), jnp.asarray(of_traces))
        for y_of, u_of, of_traces in zip(y, u, target.log_likelihoods(u), strict=True)
    ]
    of_impact = np.linalg.cholesky(np.linalg.inv(np.asarray(sites.precision[0]) + np.eye(size)))
    steps = Steps(np.full(impacts, 0.7), step, step)  # type: ignore[arg-type]
    return Start(states, [steps] * chains, Tuning(sites, root, of_impact))


def retuned(tuning: Tuning, first: Tuning, visited: Any, *, refit: bool) -> Tuning:
    """Covariances and sites from where all chains have been.

    Args:
        tuning: the present one.
        first: that of the start, which a covariance from few points leans on.
        visited: the second half of a round of all chains, with ``y``, ``u`` and ``log_likelihood`` of every
            trace, [draw, ...].
        refit: whether sites are made anew: each where there are twice as many distinct points as a parabola
            has terms, and one explanation.
    """
    u, value = np.asarray(visited.u).transpose(0, 2, 1), np.asarray(visited.log_likelihood)
    deviation = u - u.mean(0)
    of_impact = np.einsum("dia,dib->iab", deviation, deviation) / len(u)
    first_impact = first.impact_root @ np.swapaxes(first.impact_root, 1, 2)
    size, first_size = (np.trace(matrix, axis1=1, axis2=2) for matrix in (of_impact, first_impact))
    shrunk = np.minimum(1.0, size / first_size)[:, None, None] * first_impact
    impact_root = np.linalg.cholesky((1 - _OF_IMPACT) * of_impact + _OF_IMPACT * shrunk)
    sites = _refitted(tuning.sites, u, value) if refit else tuning.sites
    return Tuning(sites, root_of(np.asarray(visited.y), first.root), impact_root)


def _refitted(sites: GaussianFactor, u: np.ndarray, value: np.ndarray) -> GaussianFactor:
    size = u.shape[2]
    distinct = 1 + (np.diff(np.sort(value, axis=0), axis=0) != 0).sum(0)
    # A parabola has (1 + size) (2 + size) / 2 terms.
    enough = distinct > (1 + size) * (2 + size)
    if len(sites.centre) > 1:
        enough &= np.isneginf(np.asarray(sites.log_scale)[1])
    if not enough.any():
        return sites
    weight = (value > value.max(0) - DEEPEST).astype(float)
    nearest = nearest_parabolas(u[:, enough], value[:, enough], weight[:, enough])
    refitted = [np.array(leaf) for leaf in sites]
    for whole, part in zip(refitted, nearest, strict=True):
        whole[0, enough] = part
    return GaussianFactor(*map(jnp.asarray, refitted))
