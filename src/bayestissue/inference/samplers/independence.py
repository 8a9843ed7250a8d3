"""Chains whose proposals come from one fixed distribution about the mode: one density a draw, no slopes.

For a posterior of a dozen parameters that many data have made nearly normal, a Student-t fitted to it is so
near that most proposals are accepted. A trajectory of the No-U-Turn sampler would take a dozen slopes for
each of its draws, each of them three times the price of a value.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpyro.infer.util import potential_energy
from scipy.stats import multivariate_t

from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.execution.compiling import FULLY, by_row
from bayestissue.inference.samplers.psis import below_greatest, effective_size, pareto_smoothed
from bayestissue.inference.samplers.sampling import Draws

DEGREES = 7.0
ROUNDS = 3
POINTS = 500
# So many for a transition make consecutive draws nearly independent down to this effective share.
MOST_PROPOSALS = 8
LEAST_EFFECTIVE = 3 / (MOST_PROPOSALS + 2)


class IndependenceDraws(NamedTuple):
    """Draws by independent proposals.

    Attributes:
        draws: of the chains.
        pareto_k: of posterior over proposal: above 0.7 the proposals miss part of the posterior.
        effective: effective number of the proposals, weighted by it, over their number.
    """

    draws: Draws
    pareto_k: float
    effective: float


def independence_chains(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    site: str,
    covariance: Float[np.ndarray, "coordinate coordinate"],
    settings: Sampler,
    seed: int,
) -> IndependenceDraws:
    """Draw from a numpyro ``model`` by Metropolis-Hastings with independent proposals (Tierney 1994).

    The Student-t begins at 0 with the curvature there; its location and scale then follow the
    importance-weighted moments of what it proposed (Cappé et al. 2004).

    Args:
        model: a numpyro model.
        arguments: of the model, arrays that are traced.
        site: the model's only one, unconstrained coordinates in which the posterior is nearly normal about 0.
        covariance: of these, to second order.
        settings: how many chains and draws.
        seed: of all of it.
    """
    rng = np.random.default_rng([seed, 31])
    mean = np.zeros(len(covariance))
    for _ in range(ROUNDS):
        points, log_weight, _ = _propose(model, arguments, site, mean, covariance, POINTS, rng)
        smoothed, _ = pareto_smoothed(log_weight)
        weight = np.exp(np.asarray(smoothed) - np.max(smoothed))
        weight = weight / weight.sum()
        if 1 / (weight**2).sum() < 5 * len(mean):
            covariance = 2 * covariance
            continue
        mean = weight @ points
        covariance = (points - mean).T @ ((points - mean) * weight[:, None])
    count = settings.chains * settings.transitions
    proposals = [_propose(model, arguments, site, mean, covariance, count, rng)]
    # A chain stays where it is until a proposal is accepted: the more of them are refused, the more are made
    # for each transition, so that consecutive draws are nearly independent.
    times = int(np.clip(np.ceil(3 / _effective_share(proposals[0][1]) - 2), 1, MOST_PROPOSALS))
    if times > 1:
        proposals.append(_propose(model, arguments, site, mean, covariance, (times - 1) * count, rng))
    points, log_weight, density = (np.concatenate(parts) for parts in zip(*proposals, strict=True))
    _, k = pareto_smoothed(log_weight)
    shape = (settings.chains, settings.transitions)
    share = np.exp(log_weight - log_weight.max())
    begin = rng.choice(len(points), size=settings.chains, p=share / share.sum())
    proposed = jnp.arange(len(points)).reshape(settings.chains, -1)
    uniform = jnp.asarray(np.log(rng.uniform(size=proposed.shape)))
    places, chances = _accept(jnp.asarray(log_weight), proposed, jnp.asarray(begin), uniform)
    chosen = np.asarray(places)[:, times - 1 :: times]
    accepted = np.asarray(chances).reshape(*shape, times).mean(-1)
    energy = -density[chosen]
    statistics = {
        "diverging": np.zeros(shape, bool),
        "num_steps": np.ones(shape, int),
        "accept_prob": accepted,
        "energy": energy,
        "potential_energy": energy,
    }
    draws = Draws({site: points[chosen]}, statistics, settings.max_tree_depth)
    return IndependenceDraws(draws, float(k), _effective_share(log_weight))


def _effective_share(log_weight: Float[np.ndarray, " point"]) -> float:
    """Effective number of weighted points over their number."""
    return float(effective_size(np.exp(below_greatest(log_weight))) / len(log_weight))


def _propose(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    site: str,
    mean: np.ndarray,
    covariance: np.ndarray,
    number: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "point coordinate"], Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Points, log of posterior over proposal there, and the log of the posterior."""
    scale = covariance * (DEGREES - 2) / DEGREES
    proposal = multivariate_t(mean, scale, df=DEGREES, seed=rng)  # type: ignore[call-overload]
    points = proposal.rvs(number).reshape(number, len(mean))
    density = log_densities(model, arguments, site, points)
    density = np.where(np.isfinite(density), density, -np.inf)
    log_weight = density - proposal.logpdf(points)
    # What has no density is as good as never proposed, but Pareto smoothing wants numbers.
    return points, np.maximum(log_weight, log_weight.max() - 600), density


@by_row(POINTS, constant=3, static_argnames=("model", "site"), options=FULLY)
def log_densities(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    site: str,
    point: Float[Array, " coordinate"],
) -> Float[Array, ""]:
    """Log density of a numpyro ``model`` of one unconstrained site at any number of its points.

    Up to a constant.
    """
    return -potential_energy(model, arguments, {}, {site: point})


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
