"""Where the chains begin, and what they learn before their draws count.

Every impact begins at its own best explanations, the hyperparameters overdispersed, where the impacts alone
put them. Then follow rounds of transitions: steps follow their acceptances; after each round the covariances
of y and of every u, and each site, are taken from the second half of all that the chains have visited. A
site becomes the parabola nearest to the log likelihoods at those points, which are known already.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.inference.chain.moves import State, Steps, StudentT, Tuning, Visited
from bayestissue.inference.chain.target import Target
from bayestissue.inference.factors.sites import DEEPEST, nearest_parabolas
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor

# Where hyperparameters begin, and how far apart: a fifth of a prior's scale, give or take a few times.
_BEGIN, _APART, _ROOT, _STEP = -1.5, 1.0, 0.5, 0.5
# The first walks of impacts and levels: their length, and how often an impact goes by one.
_WALK, _WALKS = 0.7, 0.3
# How far what all impacts have in common of a parameter may be open.
_COMMON = 0.1
# What keeps an estimated covariance from being singular: of its own diagonal, and where nothing moved; of
# each impact's first one.
_SHRUNK, _LEAST, _OF_IMPACT = 0.02, 1e-8, 0.2


def walk_start(
    chains: int, number: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "chain hyperparameter"], StudentT, Float[np.ndarray, ""]]:
    """Of so many chains and hyperparameters where these begin, unconstrained and overdispersed.

    With what the steps of a walk stand on, and their length.
    """
    y = _BEGIN + _APART * rng.standard_normal((chains, number))
    # An array of numpy: one that jax makes of a number has another type, and would be compiled for apart.
    return y, StudentT(np.full(number, _BEGIN), _ROOT * np.eye(number)), np.asarray(_STEP)


def nearest_t(y: Float[np.ndarray, "draw hyperparameter"]) -> StudentT:
    """The t of the draws' mean and covariance, the latter's scale as a normal's would be."""
    return StudentT(y.mean(0), covariance_root(y))


def covariance_root(draws: Float[np.ndarray, "draw *batch one"]) -> Float[np.ndarray, "*batch one one"]:
    """Cholesky factor of the draws' covariance, and a little of its diagonal."""
    covariance = _covariance(draws)
    variance = np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), _LEAST)
    diagonal = variance[..., None] * np.eye(draws.shape[-1])
    return np.linalg.cholesky((1 - _SHRUNK) * covariance + _SHRUNK * diagonal)


def _covariance(draws: Float[np.ndarray, "draw *batch one"]) -> Float[np.ndarray, "*batch one one"]:
    deviation = draws - draws.mean(0)
    return np.einsum("d...a,d...b->...ab", deviation, deviation) / len(draws)


def begin(
    target: Target, sites: GaussianFactor, chains: int, rng: np.random.Generator
) -> tuple[list[tuple[State, Steps]], Tuning]:
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
    y, near, length = walk_start(chains, len(target.model.hyperparameters), rng)
    states = [
        State(jnp.asarray(y_of), target.data.location_mean, jnp.asarray(u_of), jnp.asarray(value))
        for y_of, u_of, value in zip(y, u, target.log_likelihoods(u), strict=True)
    ]
    of_impact = np.linalg.cholesky(np.linalg.inv(np.asarray(sites.precision[0]) + np.eye(size)))
    of_impact = _per_inertia(target, np.asarray(sites.centre[0]), of_impact)
    inner, levels = target.level_effects.shape
    walks = np.full(impacts, _WALK), np.full(impacts, _WALKS)
    steps = Steps(*walks, length, length, np.full(levels, _WALK))  # type: ignore[arg-type]
    of_level = np.broadcast_to(_ROOT * np.eye(inner), (levels, inner, inner))
    common = StudentT(np.zeros(2), np.full(2, _COMMON))
    return [(state, steps) for state in states], Tuning(
        sites, near, of_impact, of_level, common, _along(target, sites)
    )


def _per_inertia(
    target: Target,
    centre: Float[np.ndarray, "impact parameter"],
    root: Float[np.ndarray, "impact parameter parameter"],
) -> Float[np.ndarray, "impact parameter parameter"]:
    """The root of a covariance in the coordinates that `by_walk` steps in: see `Target.per_inertia`."""
    if target.added_mass is None:
        return root

    def along(column: Array) -> Array:
        return jax.jvp(target.per_inertia, (jnp.asarray(centre.T),), (column,))[1]

    return np.asarray(jax.vmap(along, in_axes=2, out_axes=2)(jnp.moveaxis(root, 0, 1))).swapaxes(0, 1)


def retuned(target: Target, tuning: Tuning, first: Tuning, visited: Visited, *, refit: bool) -> Tuning:
    """Covariances and sites from where all chains have been.

    Args:
        target: the posterior.
        tuning: the present one.
        first: that of the start, which a covariance from few points leans on.
        visited: by all chains, [draw, ...].
        refit: whether sites are made anew: each where there are twice as many distinct points as a parabola
            has terms.
    """
    u, value = np.asarray(visited.u), np.asarray(visited.traces)
    shown = np.array(target.per_inertia(u))
    common = tuning.common
    if target.common is not None:
        # What all have in common of it moves by itself.
        mean = shown[:, target.common, np.asarray(target.present)].mean(1, keepdims=True)
        shown[:, target.common] -= mean
        at = target.common_spread
        both = np.stack([mean[:, 0], mean[:, 0] if at is None else np.asarray(visited.y)[:, at]])
        common = StudentT(both.mean(1), np.maximum(both.std(1), _LEAST))
    of_impact = _covariance(shown.transpose(0, 2, 1))
    u = u.transpose(0, 2, 1)
    first_impact = first.impact_root @ np.swapaxes(first.impact_root, 1, 2)
    size, first_size = (np.trace(matrix, axis1=1, axis2=2) for matrix in (of_impact, first_impact))
    shrunk = np.minimum(1.0, size / first_size)[:, None, None] * first_impact
    impact_root = np.linalg.cholesky((1 - _OF_IMPACT) * of_impact + _OF_IMPACT * shrunk)
    sites = _refitted(tuning.sites, u, value) if refit else tuning.sites
    b = np.asarray(visited.b)
    of_levels = np.append(b, np.zeros((len(b), 1)), axis=1)[:, np.asarray(target.level_effects).T]
    return Tuning(
        sites, nearest_t(np.asarray(visited.y)), impact_root, covariance_root(of_levels), common, tuning.along
    )


def _along(target: Target, sites: GaussianFactor) -> Float[np.ndarray, "parameter impact"]:
    """How an impact's parameters go along with the one that all have in common, where its site is highest.

    Where tissue moves along, `Target.per_inertia` has it.
    """
    which, (impacts, size) = target.common, sites.centre.shape[1:]
    along = np.zeros((size, impacts))
    if which is not None:
        along[which] = 1.0
    if which is not None and target.added_mass is None:
        others, P = np.arange(size) != which, np.asarray(sites.precision[0])
        known = P[:, others][:, :, others] + np.eye(size - 1)
        along[others] = -np.linalg.solve(known, P[:, others, which, None])[..., 0].T
    return along


def _refitted(sites: GaussianFactor, u: np.ndarray, value: np.ndarray) -> GaussianFactor:
    """Each site from the points that are nearest to its centre, if there are enough of them."""
    size = u.shape[2]
    refitted = GaussianFactor(*(np.array(leaf) for leaf in sites))
    distance = ((u - refitted.centre[:, None]) ** 2).sum(-1)
    distance = np.where(np.isneginf(refitted.log_scale)[:, None], np.inf, distance)
    for number, of_site in enumerate(distance):
        nearest = of_site <= distance.min(0)
        inside = np.where(nearest, value, -np.inf)
        counts = inside > inside.max(0) - DEEPEST
        # Where a chain stays its point comes again.
        ordered = np.sort(np.where(counts, value, value.min(0) - 1), axis=0)
        distinct = (np.diff(ordered, axis=0) != 0).sum(0)
        # A parabola has (1 + size) (2 + size) / 2 terms.
        enough = distinct > (1 + size) * (2 + size)
        if not enough.any():
            continue
        weight = counts.astype(float)
        parabolas = nearest_parabolas(u[:, enough], value[:, enough], weight[:, enough])
        for whole, part in zip(refitted, parabolas, strict=True):
            whole[number, enough] = part
    return GaussianFactor(*map(jnp.asarray, refitted))
