"""Chains whose proposals come from one fixed distribution about the mode: one density a draw, no slopes.

For a posterior of a dozen parameters that many data have made nearly normal, a Student-t fitted to it is so
near that most proposals are accepted. A trajectory of the No-U-Turn sampler would take a dozen slopes for
each of its draws, each of them three times the price of a value.
"""

from __future__ import annotations

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
from bayestissue.inference.samplers.psis import pareto_smoothed
from bayestissue.inference.samplers.sampling import Draws

DEGREES = 7.0
ROUNDS = 3
POINTS = 500


class IndependenceDraws(NamedTuple):
    """Draws, and the Pareto k of posterior over proposal: above 0.7 the proposals miss part of it."""

    draws: Draws
    pareto_k: float


@dataclass(frozen=True)
class Spreads:
    """The standard deviations' posterior given the summaries, to second order, unconstrained.

    ``mode`` has each site's value, ``covariance`` the inverse of the curvature there.
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
    names = tuple(sorted(start.mode))
    shapes = {name: np.shape(start.mode[name]) for name in names}
    assert not any(shapes.values()), "every site is a number"  # noqa: S101
    rng = np.random.default_rng([seed, 31])
    mean, covariance = np.array([float(start.mode[name]) for name in names]), start.covariance
    for _ in range(ROUNDS):
        points, log_weight, _ = _propose(model, arguments, names, mean, covariance, POINTS, rng)
        smoothed, _ = pareto_smoothed(log_weight)
        weight = np.exp(np.asarray(smoothed) - np.max(smoothed))
        weight = weight / weight.sum()
        if 1 / (weight**2).sum() < 5 * len(mean):
            covariance = 2 * covariance
            continue
        mean = weight @ points
        covariance = (points - mean).T @ ((points - mean) * weight[:, None])
    count = settings.chains * settings.transitions
    points, log_weight, density = _propose(model, arguments, names, mean, covariance, count, rng)
    _, k = pareto_smoothed(log_weight)
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
    sites = {name: points[place, column] for column, name in enumerate(names)}
    return IndependenceDraws(Draws(sites, statistics, settings.max_tree_depth), float(k))


def _propose(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    names: tuple[str, ...],
    mean: np.ndarray,
    covariance: np.ndarray,
    number: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "point site"], Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Points, log of posterior over proposal there, and the log of the posterior."""
    scale = covariance * (DEGREES - 2) / DEGREES
    proposal = multivariate_t(mean, scale, df=DEGREES, seed=rng)  # type: ignore[call-overload]
    points = proposal.rvs(number).reshape(number, len(mean))
    density = np.asarray(_log_density(model, names, jnp.asarray(points), arguments))
    density = np.where(np.isfinite(density), density, -np.inf)
    log_weight = density - proposal.logpdf(points)
    # What has no density is as good as never proposed, but Pareto smoothing wants numbers.
    return points, np.maximum(log_weight, log_weight.max() - 600), density


@partial(jax.jit, static_argnames=("model", "names"))
def _log_density(
    model: Callable[..., None], names: tuple[str, ...], points: Array, arguments: tuple[Any, ...]
) -> Array:
    def one(point: Array) -> Array:
        return -potential_energy(model, arguments, {}, dict(zip(names, point, strict=True)))

    return jax.lax.map(one, points)


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
