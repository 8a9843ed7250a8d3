"""Draws as a chain leaves them, of a fit whose traces are Gaussian sites: exact, and made at once."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayestissue.base.impact_arrays import padded_impacts
from bayestissue.inference.chain.results import ChainDraws, constrained
from bayestissue.inference.chain.target import Target
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import Population
from bayestissue.model.hierarchy.trace_data import Prepared


def chain_of_sites(
    made: Prepared, sites: GaussianFactor, y: np.ndarray, rng: np.random.Generator
) -> ChainDraws:
    """Effects and impacts given hyperparameters ``y`` [chain, draw, hyperparameter], unconstrained."""
    target, shape = Target.from_prepared(made), y.shape[:2]
    padded = GaussianFactor(*map(jnp.asarray, padded_impacts(sites)))
    blocked, count = target.blocked(padded), len(sites.centre)

    @jax.jit
    @jax.vmap
    def one(y: Array, of_effects: Array, of_impacts: Array) -> tuple[Array, Array]:
        b = target.effects_at(target.given_sites(y, blocked), of_effects)
        mean = target.prior_mean(b)
        return b, jnp.stack(target.impact_given(y, padded).draw(list(mean), list(of_impacts)))

    number = shape[0] * shape[1]
    of_effects = rng.normal(size=(number, made.model.locations.size))
    of_impacts = rng.normal(size=(number, padded.centre.shape[1], len(padded.centre)))
    b, u = map(np.asarray, one(y.reshape(number, -1), of_effects, of_impacts))
    u = np.moveaxis(u, 1, 2)[:, :count]
    value = np.asarray(sites.log_density(u)).reshape(*shape, count)
    levels = {name: len(each.levels) for name, each in made.design.groupings.items()}
    nothing = {name: np.zeros((*shape, number)) for name, number in levels.items()}
    return ChainDraws(
        population=Population(constrained(made.model, y), b.reshape(*shape, -1)),
        log_likelihood=value.sum(-1),
        log_ratios={"impact": np.zeros(value.shape), **nothing},
        impact_draws=np.arange(shape[1]),
        u=u.reshape(*shape, *u.shape[1:]),
        acceptance={},
        sites=sites,
        end=None,  # type: ignore[arg-type]
        segments=0,
        segment=1,
        verdict=None,  # type: ignore[arg-type]
    )
