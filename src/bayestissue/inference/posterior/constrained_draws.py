"""From the sampler's standard normals back to what they stand for."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.derived import named_sites
from bayestissue.hierarchy.gaussian.covariances import Covariances, SharedMassError
from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.population import of_impacts
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import (
    TraceData,
    TraceModel,
    gaussian,
    physical,
    population,
    trace_distribution,
)
from bayestissue.inference.execution.compiling import compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.conditional import normals
from bayestissue.inference.factors.conditional_prior import conditional_priors
from bayestissue.inference.posterior.scores import LikelihoodApproximation, of_draws
from bayestissue.inference.quantities.elements import element_quantities, measured_of
from bayestissue.inference.samplers.sampling import ConstrainedDraws, Draws

# Draws of one call, so that one compilation serves any number.
DRAWS = 256


def constrained_draws(
    prepared: Prepared,
    summaries: Sites,
    draws: Draws,
    key: Array,
    *,
    told: LikelihoodApproximation | None = None,
) -> ConstrainedDraws:
    """Map all draws back.

    Args:
        prepared: the fit.
        summaries: in whose coordinates the draws are.
        draws: of the sampler.
        key: of what is drawn besides.
        told: of the traces' likelihoods, for the log densities; these summaries unless given.
    """
    model, data = prepared.model, prepared.data
    shape = next(iter(draws.sites.values())).shape[:2]
    flat = {name: np.asarray(v).reshape(-1, *v.shape[2:]) for name, v in draws.sites.items()}
    expected = conditional_priors(model, gaussian(data, summaries), flat, flat["standard_locations"])
    u = normals(summaries, expected.anchors).at(flat["standard_impacts"])
    keys = jax.vmap(jax.random.split)(jax.random.split(jax.random.fold_in(key, 11), shape[0] * shape[1]))
    rows = (expected.sites, expected.b, expected.about, u, keys[:, 0], keys[:, 1])
    b, impacts = in_calls(partial(constrain_rows, model, data), rows, DRAWS)
    scores = of_draws(prepared, told or LikelihoodApproximation(summaries), expected)
    sites, b, impacts, scores = jax.tree.map(
        lambda v: np.asarray(v).reshape(*shape, *v.shape[1:]), (expected.sites, b, impacts, scores)
    )
    return ConstrainedDraws(named_sites(model.locations, prepared.design, sites, b), impacts, scores)


@compiled_sooner()
def constrain_rows(
    model: TraceModel,
    data: TraceData,
    sites: dict[str, Array],
    b: Float[Array, "draw location"],
    about: Float[Array, "draw impact parameter"],
    u: Float[Array, "draw impact parameter"],
    of_mass: Array,
    of_errors: Array,
    number: int,
) -> tuple[Array, dict[str, Float[Array, "draw impact ..."]]]:
    """Locations at people's true masses, and every impact's quantities, of the first so many draws.

    ``of_mass`` and ``of_errors`` are keys of the errors of mass and of all other errors.
    """

    def one(place: Any) -> tuple[Array, dict[str, Array]]:
        own = {name: values[place] for name, values in sites.items()}
        spread, columns, here = population(model, own), list(u[place].T), list(about[place].T)
        locations, mass_error = _mass_error(model, data, spread, b[place], columns, here, of_mass[place])
        return locations, impact_quantities(model, data, columns, mass_error, of_errors[place])

    return first_rows(one, DRAWS, number)


def impact_quantities(
    model: TraceModel, data: TraceData, u: list[Array], mass_error: Array, key: Array
) -> dict[str, Array]:
    """What an impact's parameters stand for, and a draw of the chain's errors given them.

    Args:
        model: the model.
        data: the dataset.
        u: each impact's parameters, K and C at the recorded mass.
        mass_error: of the log mass.
        key: of the chain's errors.
    """
    at, distribution = physical(model, data, u), trace_distribution(model, data, u)
    measured = measured_of(distribution, key)
    impacts = {
        "K": jnp.exp(u[0] + mass_error),
        "C": jnp.exp(u[1] + mass_error),
        "omega_n": at.omega_n,
        "zeta": at.zeta,
        "mass": jnp.exp(data.log_mass + mass_error),
        "chain_error": measured.chain_error,
        **({"sigma_d": jnp.exp(at.log_sigma)} if model.kind == "impact" else {}),
        **({} if model.kind == "impact" else {"sigma_a": jnp.exp(at.log_sigma)}),
        "parameters": jnp.stack(u, axis=-1),
    }
    impacts |= element_quantities(model, data, u, mass_error, measured)
    if model.kind != "impact":
        impacts["theta1"] = distribution.differences()[2]
    return impacts


def _mass_error(
    model: TraceModel,
    data: TraceData,
    spread: Covariances,
    b: Array,
    u: list[Array],
    about: list[Array],
    key: Array,
) -> tuple[Array, Array]:
    """People's effects in b put at their true mass, and each impact's error of the log mass.

    Everything seen is log K - e and log C - e. Where e is an impact's own, Var(e) is part of the covariance
    of u; where it is a person's, of that of the person's effects, from which it is taken apart here. Either
    way e is normal given what is seen.
    """
    b, error = at_true_masses(spread, b, key)
    if error is not None:
        return b, of_impacts(data.design, spread, error)
    return b, impact_error(model, spread, u, about, key)


def at_true_masses(spread: Covariances, b: Array, key: Array) -> tuple[Array, Float[Array, " person"] | None]:
    """People's effects in b put at their true mass, and the errors that all impacts of a person share."""
    if spread.shared is None:
        return b, None
    error = error_of_people(spread.locations, spread.shared, b, key)
    return b.at[spread.shared.effect_on_K].add(error).at[spread.shared.effect_on_C].add(error), error


def impact_error(
    model: TraceModel, spread: Covariances, u: list[Array], about: list[Array], key: Array
) -> Array:
    """The error of the log mass where it is each impact's own, given u and its expectation."""
    kk, kc, cc = spread.own
    variance = model.log_mass_sd**2
    determinant = kk * cc - kc**2
    pull_K, pull_C = variance * (cc - kc) / determinant, variance * (kk - kc) / determinant
    mean = -pull_K * (u[0] - about[0]) - pull_C * (u[1] - about[1])
    left = jnp.maximum(variance * (1 - pull_K - pull_C), 0.0)
    return mean + jnp.sqrt(left) * jax.random.normal(key, mean.shape)


def error_of_people(sd: Array, shared: SharedMassError, b: Array, key: Array) -> Array:
    """The error e given what is seen of a person's effects, f = s - e, all of them normal and independent.

    Its mean is -v (C f_K + K f_C) / (K C + v (K + C)), with variances v of e, K of s_K and C of s_C.
    """
    K, C = sd[shared.effect_on_K] ** 2, sd[shared.effect_on_C] ** 2
    over = shared.variance / (K * C + shared.variance * (K + C))
    mean = -over * (C * b[shared.effect_on_K] + K * b[shared.effect_on_C])
    return mean + jnp.sqrt(over * K * C) * jax.random.normal(key, mean.shape)
