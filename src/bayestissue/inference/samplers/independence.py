"""Chains whose proposals come from one fixed distribution about the mode: one density a draw, no slopes.

For a posterior of a dozen parameters that many data have made nearly normal, a Student-t fitted to it is so
near that most proposals are accepted. A trajectory of the No-U-Turn sampler would take a dozen slopes for
each of its draws, each of them three times the price of a value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpyro.infer.util import potential_energy
from scipy.stats import multivariate_t

from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.execution.compiling import first_rows, in_calls
from bayestissue.inference.samplers.psis import pareto_smoothed
from bayestissue.inference.samplers.sampling import Draws

# Sites in the order of their coordinates, and each one's shape.
Layout = tuple[tuple[str, tuple[int, ...]], ...]

DEGREES = 7.0
# Proposals follow the moments of so many points that often, and then, if need be, those of all points.
ROUNDS, TRIES = 3, 2
PARETO_LIMIT = 0.7
# So many at once: to adapt the proposals, and in each call of what is compiled.
POINTS = 500


class IndependenceDraws(NamedTuple):
    """Draws, and the Pareto k of posterior over proposal: above 0.7 the proposals miss part of it."""

    draws: Draws
    pareto_k: float


@dataclass(frozen=True)
class Spreads:
    """The posterior of the hyperparameters given the sites, to second order, unconstrained.

    ``mode`` has each site's value, ``covariance`` the inverse of the curvature there, over the coordinates of
    the sites in alphabetical order.
    """

    mode: Mapping[str, np.ndarray]
    covariance: np.ndarray


def independence_chains(
    model: Callable[..., None], arguments: tuple[Any, ...], start: Spreads, settings: Sampler, seed: int
) -> IndependenceDraws:
    """Draw from a numpyro ``model`` by Metropolis-Hastings with independent proposals (Tierney 1994).

    The Student-t begins with the mode and the curvature there; its location and scale then follow the
    importance-weighted moments of what it proposed (Cappé et al. 2004).

    Args:
        model: a numpyro model.
        arguments: of the model, arrays that are traced.
        start: posterior mode and covariance.
        settings: how many chains and draws.
        seed: of all of it.
    """
    layout = tuple((name, np.shape(start.mode[name])) for name in sorted(start.mode))
    rng = np.random.default_rng([seed, 31])
    mean, covariance = np.concatenate([np.ravel(start.mode[name]) for name, _ in layout]), start.covariance
    count = settings.chains * settings.transitions
    for number in range(ROUNDS + TRIES):
        size = POINTS if number < ROUNDS else count
        points, log_weight, density = _propose(model, arguments, layout, mean, covariance, size, rng)
        smoothed, k = pareto_smoothed(log_weight)
        if number == ROUNDS + TRIES - 1 or (number >= ROUNDS and k < PARETO_LIMIT):
            break
        weight = np.exp(np.asarray(smoothed) - np.max(smoothed))
        weight = weight / weight.sum()
        if 1 / (weight**2).sum() < 5 * len(mean):
            covariance = 2 * covariance
            continue
        mean = weight @ points
        covariance = (points - mean).T @ ((points - mean) * weight[:, None])
    shape = (settings.chains, settings.transitions)
    share = np.exp(log_weight - log_weight.max())
    begin = rng.choice(count, size=settings.chains, p=share / share.sum())
    uniform = np.log(rng.uniform(size=shape))
    place, accepted = _accept(
        jnp.asarray(log_weight), jnp.arange(count).reshape(shape), jnp.asarray(begin), jnp.asarray(uniform)
    )
    place = np.asarray(place)
    energy = -density[place]
    statistics = {
        "diverging": np.zeros(shape, bool),
        "num_steps": np.ones(shape, int),
        "accept_prob": np.asarray(accepted),
        "energy": energy,
        "potential_energy": energy,
    }
    sites = _parts(points[place], layout)
    return IndependenceDraws(Draws(sites, statistics, settings.max_tree_depth), float(k))


def _propose(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    layout: Layout,
    mean: np.ndarray,
    covariance: np.ndarray,
    number: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "point site"], Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Points, log of posterior over proposal there, and the log of the posterior."""
    scale = covariance * (DEGREES - 2) / DEGREES
    proposal = multivariate_t(mean, scale, df=DEGREES, seed=rng)  # type: ignore[call-overload]
    points = proposal.rvs(number).reshape(number, len(mean))
    density = log_densities(model, arguments, layout, points)
    density = np.where(np.isfinite(density), density, -np.inf)
    log_weight = density - proposal.logpdf(points)
    # What has no density is as good as never proposed, but Pareto smoothing wants numbers.
    return points, np.maximum(log_weight, log_weight.max() - 600), density


def log_densities(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    layout: Layout,
    points: Float[np.ndarray, "point coordinate"],
) -> Float[np.ndarray, " point"]:
    """Log density of a numpyro ``model`` at unconstrained points, up to a constant.

    Args:
        model: a numpyro model; the same object is compiled once.
        arguments: of the model, arrays that are traced.
        layout: the sites in the order of their coordinates, and each one's shape.
        points: any number of them.
    """
    own = partial(_log_densities, model, layout, arguments)
    return np.asarray(in_calls(own, (points,), POINTS))


@partial(jax.jit, static_argnames=("model", "layout"))
def _log_densities(
    model: Callable[..., None], layout: Layout, arguments: tuple[Any, ...], points: Array, number: Array
) -> Array:
    def one(place: Array) -> Array:
        return -potential_energy(model, arguments, {}, _parts(points[place], layout))

    return first_rows(one, POINTS, number)


def _parts(points: Any, layout: Layout) -> dict[str, Any]:
    """The sites of points, whose coordinates are along the last axis."""
    found, begin = {}, 0
    for name, shape in layout:
        end = begin + math.prod(shape)
        found[name] = points[..., begin:end].reshape(*points.shape[:-1], *shape)
        begin = end
    return found


@jax.jit
def _accept(log_weight: Array, proposed: Array, begin: Array, log_uniform: Array) -> tuple[Array, Array]:
    """Places of the draws among the points, and the probability with which each was accepted."""

    def step(now: Array, part: tuple[Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        new, chance = part
        gain = log_weight[new] - log_weight[now]
        now = jnp.where(chance < gain, new, now)
        return now, (now, jnp.exp(jnp.minimum(gain, 0.0)))

    _, (places, accepted) = jax.lax.scan(step, begin, (proposed.T, log_uniform.T))
    return places.T, accepted.T
