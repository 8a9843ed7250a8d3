"""What the normal summaries leave out, put back by importance sampling.

Each trace's likelihood is compared with its summary at a few points drawn where the whole data set says
that its parameters are. From these points alone follow better summaries, and, for any population, the
factor by which the trace's true evidence differs from its summary's.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.stats import norm, qmc

from bayestissue.hierarchy.conditional import (
    Conditional,
    ImpactParts,
    Summaries,
    condition,
    impact_parts,
    impact_values,
    log_evidence_of,
)
from bayestissue.hierarchy.population import Spread, expected
from bayestissue.hierarchy.traces import TraceData, TraceModel, log_likelihood, population
from bayestissue.inference.compiling import compiled_quickly
from bayestissue.inference.trace_summaries import least_bend

POINTS = 64


class Expectation(NamedTuple):
    """Where the population puts each impact's parameters, its spreads and all summaries given.

    Attributes:
        spread: the population's spreads.
        conditional: of b and of each impact, given them.
        about: X b where b has its conditional mean.
    """

    spread: Spread
    conditional: Conditional
    about: list[Float[Array, " impact"]]


# Compiled once for the several passes that ask for it: it is the larger part of most of them.
@compiled_quickly("model")
def expectation(
    model: TraceModel, data: TraceData, summaries: Summaries, sites: dict[str, Any]
) -> Expectation:
    """The normal conditionals of `bayestissue.hierarchy.conditional` at one value of the spreads."""
    spread = population(model, sites)
    conditional = condition(data.design, spread, data.location_mean, summaries)
    return Expectation(spread, conditional, expected(data.design, conditional.mean))


class Points(NamedTuple):
    """Points at which likelihood and summary were compared.

    Attributes:
        u: the points.
        log_ratio: log of likelihood over summary.
    """

    u: Float[Array, "point impact parameter"]
    log_ratio: Float[Array, "point impact"]


def standard_points(size: int, number: int = POINTS) -> Float[np.ndarray, "point parameter"]:
    """Normal points that fill the space evenly: Sobol's sequence and its mirror image."""
    uniform = qmc.Sobol(size, seed=20).random(number // 2)
    half = norm.ppf(np.clip(uniform, 1e-9, 1 - 1e-9))
    return np.concatenate([half, -half])


@compiled_quickly("model")
def compare(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    parts: ImpactParts,
    about: list[Array],
    standard: Float[Array, "point parameter"],
) -> Points:
    """Compare where the population, with X b as given, and the summaries put each impact's parameters."""
    return compare_about(model, data, summaries, parts, about, standard)


def compare_about(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    parts: ImpactParts,
    about: list[Array],
    standard: Float[Array, "point parameter"],
) -> Points:
    """`compare`, to be called from within a compiled function."""
    count = summaries.centre.shape[0]

    def one(z: Array) -> tuple[Array, Array]:
        u = impact_values(parts, summaries, about, jnp.broadcast_to(z, (count, z.shape[0])))
        found = log_likelihood(model, data, u) - summaries.log_summary(u)
        return jnp.stack(u, axis=-1), jnp.where(jnp.isfinite(found), found, -jnp.inf)

    u, log_ratio = jax.lax.map(one, standard)
    return Points(u, log_ratio)


@compiled_quickly()
def refine(
    spread: Spread,
    summaries: Summaries,
    parts: ImpactParts,
    about: list[Array],
    points: Points,
    bent: bool | Array = False,
) -> Summaries:
    """Summaries whose product with the population's expectation has the mean and covariance of the truth.

    One step of expectation propagation (Minka 2001), the moments taken over the compared points. Where a
    moment leaves no positive precision to the trace along some axis, the trace being open on that side, its
    old summary stays; or, if that is to be ``bent``, it gets as little precision there as is believable, and
    only the mean is met. It stays too where the points tell too little.
    """
    return refine_about(spread, summaries, parts, about, points, bent)


def refine_about(
    spread: Spread,
    summaries: Summaries,
    parts: ImpactParts,
    columns: list[Array],
    points: Points,
    bent: bool | Array = False,
) -> Summaries:
    """`refine`, to be called from within a compiled function."""
    about = jnp.stack(columns, axis=-1)
    weight = jax.nn.softmax(points.log_ratio, axis=0)
    mean = jnp.einsum("pi,pia->ia", weight, points.u)
    away = points.u - mean
    covariance = jnp.einsum("pi,pia,pib->iab", weight, away, away)
    # The same points give the same error where the moments are known: those of the normal itself.
    plain = points.u - points.u.mean(0)
    own = jnp.einsum("pia,pib->iab", plain, plain) / plain.shape[0]
    size = points.u.shape[-1]
    prior = jnp.stack(
        [jnp.stack([parts.prior[a][b] + jnp.zeros(()) for b in range(size)]) for a in range(size)]
    )
    exact = jnp.linalg.inv(summaries.precision + prior)
    covariance = covariance + exact - own
    whole = jnp.linalg.inv(covariance)
    values, axes = jnp.linalg.eigh(whole - prior)
    enough = 1 / jnp.square(weight).sum(0) > points.u.shape[0] / 4
    usable = ((values[:, 0] > 0) | bent) & jnp.isfinite(values).all(1) & enough
    slope = (mean - about) @ prior
    along = jnp.einsum("iab,ia->ib", axes, slope)
    firm = jnp.maximum(values, least_bend(along))
    precision = jnp.einsum("iab,ib,icb->iac", axes, firm, axes)
    found = Summaries(mean, slope, precision, jnp.zeros_like(summaries.log_likelihood))
    mean_ratio = jax.nn.logsumexp(points.log_ratio, axis=0) - jnp.log(points.u.shape[0])
    # Equal evidence under this population, old and new: the level follows.
    level = mean_ratio + _evidence(spread, summaries, about) - _evidence(spread, found, about)
    usable &= jnp.isfinite(level)
    kept = (
        jnp.where(usable.reshape(-1, *[1] * (new.ndim - 1)), new, old)
        for new, old in zip(found._replace(log_likelihood=level), summaries, strict=True)
    )
    return Summaries(*kept)


def _evidence(spread: Spread, summaries: Summaries, about: Array) -> Array:
    columns = [about[:, a] for a in range(about.shape[1])]
    return log_evidence_of(impact_parts(spread, summaries), summaries, columns)


class Profile(NamedTuple):
    """Log likelihood of each impact's last parameter on an even grid, the others integrated out.

    For theta1, which a trace may leave open all the way to -1, and for what an element has besides K and C,
    which it leaves open where that is not needed: no normal describes such a likelihood.

    Attributes:
        first, step: of the grid.
        log_likelihood: relative to the summary, which has no word on the last parameter.
    """

    first: Array
    step: Array
    log_likelihood: Float[Array, "grid impact"]

    def at(self, value: Float[Array, "*batch impact"]) -> Float[Array, "*batch impact"]:
        """Cubic interpolation, level beyond the grid."""
        number = self.log_likelihood.shape[0]
        place = jnp.clip((value - self.first) / self.step, 0.0, number - 1.0)
        index = jnp.clip(jnp.floor(place).astype(int), 1, number - 3)
        t = place - index
        columns = jnp.arange(self.log_likelihood.shape[1])
        a, b, c, d = (self.log_likelihood[index + k, columns] for k in (-1, 0, 1, 2))
        bend = a * (-0.5) + 1.5 * b - 1.5 * c + 0.5 * d
        return ((bend * t + a - 2.5 * b + 2 * c - 0.5 * d) * t + (c - a) / 2) * t + b

    def over(
        self, mean: Float[Array, " draw"], sd: Float[Array, " draw"]
    ) -> Float[Array, "point draw impact"]:
        """The log likelihood at evenly likely points of each of some normals."""
        points = norm.ppf((np.arange(_EVEN) + 0.5) / _EVEN)[:, None, None]
        shape = (_EVEN, len(mean), self.log_likelihood.shape[1])
        values = jnp.broadcast_to(mean[:, None] + sd[:, None] * points, shape)
        return self.at(values)

    def log_evidence(self, mean: Array, sd: Array) -> Float[Array, " impact"]:
        """Log of the integral over a normal last parameter, by Gauss-Hermite quadrature."""
        points = mean + sd * jnp.asarray(_HERMITE_POINTS)[:, None]
        weights = jnp.asarray(_HERMITE_WEIGHTS / _HERMITE_WEIGHTS.sum())[:, None]
        return jax.nn.logsumexp(self.at(points), axis=0, b=weights)


def flat_profile(impacts: int) -> Profile:
    """A profile that says nothing."""
    first, step = jnp.asarray(_GRID[0]), jnp.asarray(_GRID[1] - _GRID[0])
    return Profile(first, step, jnp.zeros((len(_GRID), impacts)))


_DEEPEST = 200.0
_EVEN = 16
_GRID = np.linspace(-8.0, 8.0, 161)
_HERMITE_POINTS, _HERMITE_WEIGHTS = np.polynomial.hermite_e.hermegauss(32)


@partial(jax.jit, static_argnames="model")
def profile_last(
    model: TraceModel,
    data: TraceData,
    cleared: Summaries,
    parts: ImpactParts,
    about: list[Array],
    standard: Float[Array, "point parameter"],
) -> Profile:
    """Tabulate the last parameter's likelihood, of which the summaries are cleared."""
    return profile_about(model, data, cleared, parts, about, standard)


def cleared_of_last(summaries: Summaries) -> Summaries:
    """Summaries that say nothing of the last parameter."""
    last = summaries.centre.shape[1] - 1
    precision = jnp.asarray(summaries.precision).at[:, last, :].set(0.0).at[:, :, last].set(0.0)
    return summaries._replace(precision=precision, slope=jnp.asarray(summaries.slope).at[:, last].set(0.0))


def profile_about(
    model: TraceModel,
    data: TraceData,
    cleared: Summaries,
    parts: ImpactParts,
    about: list[Array],
    standard: Float[Array, "point parameter"],
) -> Profile:
    """`profile_last`, to be called from within a compiled function."""
    count, last = cleared.centre.shape[0], cleared.centre.shape[1] - 1

    def one(value: Array) -> Array:
        def ratio(z: Array) -> Array:
            u = impact_values(parts, cleared, about, jnp.broadcast_to(z, (count, last + 1)))
            u = [*u[:last], jnp.full(count, value)]
            found = log_likelihood(model, data, u) - cleared.log_summary(u)
            return jnp.where(jnp.isfinite(found), found, -1e6)

        ratios = jax.lax.map(ratio, standard)
        return jax.nn.logsumexp(ratios, axis=0) - jnp.log(standard.shape[0])

    table = jax.lax.map(one, jnp.asarray(_GRID))
    # Cubics overshoot at the foot of a cliff; so far down it does not matter.
    table = jnp.maximum(table, table.max(0) - _DEEPEST)
    return flat_profile(count)._replace(log_likelihood=table)
