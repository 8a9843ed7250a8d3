"""Where the chains begin, and what they learn before their draws count.

Every impact begins at its own best explanations, the hyperparameters overdispersed, where the impacts alone
put them. Then follow rounds of transitions: steps follow their acceptances; after each round the covariances
of y and of every u, and each site, are taken from what the chains have visited. A site becomes the parabola
nearest to the log likelihoods at those points, which are known already.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.inference.chain.moves import State, Steps, Tuning, centred
from bayestissue.inference.chain.settings import ChainSettings
from bayestissue.inference.chain.target import Target
from bayestissue.inference.execution.compiling import compiled_quickly
from bayestissue.inference.factors.sites import _DEEPEST, _POINTS_A_TERM, _nearest

# Transitions of `centred` alone with which a chain begins, three times over.
_FIRST, _TURNS = 200, 3
# What keeps an estimated covariance from being singular, of the first one.
_SHRUNK, _OF_IMPACT = 0.02, 0.2


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


def begin(target: Target, settings: ChainSettings, sites: GaussianFactor, keys: Array) -> Start:
    """Chains at the best explanation of each impact, another one in each chain where there are several.

    Args:
        target: the posterior.
        settings: of the run.
        sites: of all impacts, [site, impact, ...]; where an impact has fewer the others say nothing.
        keys: of each chain.
    """
    number, size = len(target.model.hyperparameters), sites.centre.shape[2]
    present = np.asarray(sites.log_scale) > -np.inf
    count = present.sum(0)
    best = [chain % np.maximum(count, 1) for chain in range(len(keys))]
    starts = [jnp.asarray(sites.centre[which, np.arange(len(which))].T) for which in best]
    impact_root = jnp.broadcast_to(jnp.eye(size), (sites.centre.shape[1], size, size))
    root, step = 0.5 * jnp.eye(number), jnp.asarray(2.4 / np.sqrt(number))
    like = jnp.zeros(len(target.present))
    states = [State(jnp.full(number, -1.5), target.data.location_mean, u, like) for u in starts]
    lengths = [step] * len(keys)
    for turn in range(_TURNS):
        tuning, paths = Tuning(sites, root, impact_root), []
        for chain, key in enumerate(keys):
            states[chain], lengths[chain], path = _centred_alone(
                target, settings, tuning, states[chain], lengths[chain], jax.random.fold_in(key, turn)
            )
            paths.append(np.asarray(path)[_FIRST // 2 :])
        covariance = np.cov(np.concatenate(paths).T.reshape(number, -1))
        root = jnp.linalg.cholesky(covariance.reshape(number, number) + 1e-3 * np.eye(number))
    log_likelihood = compiled_quickly(Target.log_likelihood)
    states = [state._replace(log_likelihood=log_likelihood(target, state.u)) for state in states]
    middle = jnp.stack([state.y for state in states]).mean(0)
    D = np.asarray(target.covariances(middle).of_impact())
    of_impact = np.linalg.cholesky(np.linalg.inv(np.asarray(sites.precision[0]) + D))
    steps = [Steps(jnp.full(len(like), 0.7), length, step) for length in lengths]
    return Start(states, steps, Tuning(sites, root, jnp.asarray(of_impact)))


@partial(compiled_quickly, static_argnames="settings")
def _centred_alone(
    target: Target, settings: ChainSettings, tuning: Tuning, state: State, length: Array, key: Array
) -> tuple[State, Array, Float[Array, "transition hyperparameter"]]:
    def one(carried: tuple[State, Array], key: Array) -> Any:
        state, length = carried
        steps = Steps(jnp.zeros(()), length, length)
        state, rate = centred(target, settings, tuning, steps, state, key)
        return (state, length * jnp.exp(0.2 * (rate - settings.population_acceptance))), state.y

    (state, length), path = jax.lax.scan(one, (state, length), jax.random.split(key, _FIRST))
    return state, length, path


def retuned(tuning: Tuning, first: Tuning, visited: State, *, refit: bool) -> Tuning:
    """Covariances and sites from where all chains have been.

    Args:
        tuning: the present one.
        first: that of the start, which a covariance from few points leans on.
        visited: the second half of a round of all chains, [draw, ...].
        refit: whether sites are made anew: each where there are twice as many distinct points as a parabola
            has terms, and one explanation.
    """
    y, u = np.asarray(visited.y), np.asarray(visited.u).transpose(0, 2, 1)
    value = np.asarray(visited.log_likelihood)
    number = y.shape[1]
    covariance = np.cov(y.T).reshape(number, number) + _SHRUNK * np.asarray(first.root @ first.root.T)
    deviation = u - u.mean(0)
    of_impact = np.einsum("dia,dib->iab", deviation, deviation) / len(u)
    first_impact = np.asarray(first.impact_root @ first.impact_root.mT)
    size, first_size = (np.trace(matrix, axis1=1, axis2=2) for matrix in (of_impact, first_impact))
    shrunk = np.minimum(1.0, size / first_size)[:, None, None] * first_impact
    impact_root = np.linalg.cholesky((1 - _OF_IMPACT) * of_impact + _OF_IMPACT * shrunk)
    sites = _refitted(tuning.sites, u, value) if refit else tuning.sites
    return Tuning(sites, jnp.linalg.cholesky(covariance), jnp.asarray(impact_root))


def _refitted(sites: GaussianFactor, u: np.ndarray, value: np.ndarray) -> GaussianFactor:
    size = u.shape[2]
    distinct = np.array([len(np.unique(column)) for column in value.T])
    enough = distinct > _POINTS_A_TERM * (1 + size) * (2 + size) / 2
    if len(sites.centre) > 1:
        enough &= np.isneginf(np.asarray(sites.log_scale)[1])
    if not enough.any():
        return sites
    weight = (value > value.max(0) - _DEEPEST).astype(float)
    nearest = _nearest(u[:, enough], value[:, enough], weight[:, enough])
    refitted = [np.array(leaf) for leaf in sites]
    for whole, part in zip(refitted, nearest, strict=True):
        whole[0, enough] = part
    return GaussianFactor(*map(jnp.asarray, refitted))
