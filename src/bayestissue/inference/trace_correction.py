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
    ImpactParts,
    Summaries,
    condition,
    impact_parts,
    impact_values,
    log_evidence_of,
)
from bayestissue.hierarchy.population import Spread, expected
from bayestissue.hierarchy.traces import TraceData, TraceModel, log_likelihood, population
from bayestissue.likelihood import small

POINTS = 64


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


@partial(jax.jit, static_argnames="model")
def compare(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    sites: dict[str, Any],
    standard: Float[Array, "point parameter"],
) -> Points:
    """Compare where the population with these spreads, and the summaries, put each impact's parameters."""
    spread = population(model, sites)
    conditional = condition(data.design, spread, data.location_mean, summaries)
    about = expected(data.design, conditional.mean)
    return compare_about(model, data, summaries, conditional.parts, about, standard)


def compare_about(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    parts: ImpactParts,
    about: list[Array],
    standard: Float[Array, "point parameter"],
) -> Points:
    """`compare` for given X b and impacts' parts."""
    count = summaries.centre.shape[0]

    def one(z: Array) -> tuple[Array, Array]:
        u = impact_values(parts, summaries, about, jnp.broadcast_to(z, (count, z.shape[0])))
        found = log_likelihood(model, data, u) - summaries.log_summary(u)
        return jnp.stack(u, axis=-1), jnp.where(jnp.isfinite(found), found, -jnp.inf)

    u, log_ratio = jax.lax.map(one, standard)
    return Points(u, log_ratio)


@partial(jax.jit, static_argnames="model")
def refine(
    model: TraceModel, data: TraceData, summaries: Summaries, sites: dict[str, Any], points: Points
) -> Summaries:
    """Summaries whose product with the population's expectation has the mean and covariance of the truth.

    One step of expectation propagation (Minka 2001), the moments taken over the compared points; where a
    moment leaves no positive precision to the trace, its old summary stays.
    """
    spread = population(model, sites)
    conditional = condition(data.design, spread, data.location_mean, summaries)
    return refine_about(spread, summaries, conditional.parts, expected(data.design, conditional.mean), points)


def refine_about(
    spread: Spread, summaries: Summaries, parts: ImpactParts, expectation: list[Array], points: Points
) -> Summaries:
    """`refine` for given X b and impacts' parts."""
    about = jnp.stack(expectation, axis=-1)
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
    precision = whole - prior
    values = jnp.linalg.eigvalsh(precision)
    enough = 1 / jnp.square(weight).sum(0) > points.u.shape[0] / 4
    usable = (values[:, 0] > 0) & jnp.isfinite(values).all(1) & enough
    slope = (mean - about) @ prior
    found = Summaries(mean, slope, precision, jnp.zeros_like(summaries.log_likelihood))
    mean_ratio = jax.nn.logsumexp(points.log_ratio, axis=0) - jnp.log(points.u.shape[0])
    # Equal evidence under this population, old and new: the level follows.
    level = mean_ratio + _evidence(spread, summaries, about) - _evidence(spread, found, about)
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

    For theta1, which a trace may leave open all the way to -1: no normal describes such a likelihood.

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

    def log_evidence(self, mean: Array, sd: Array) -> Float[Array, " impact"]:
        """Log of the integral over a normal last parameter, by Gauss-Hermite quadrature."""
        points = mean + sd * jnp.asarray(_HERMITE_POINTS)[:, None]
        weights = jnp.asarray(_HERMITE_WEIGHTS / _HERMITE_WEIGHTS.sum())[:, None]
        return jax.nn.logsumexp(self.at(points), axis=0, b=weights)


def flat_profile(impacts: int) -> Profile:
    """A profile that says nothing."""
    first, step = jnp.asarray(_GRID[0]), jnp.asarray(_GRID[1] - _GRID[0])
    return Profile(first, step, jnp.zeros((len(_GRID), impacts)))


_GRID = np.linspace(-8.0, 8.0, 161)
_HERMITE_POINTS, _HERMITE_WEIGHTS = np.polynomial.hermite_e.hermegauss(32)


@partial(jax.jit, static_argnames="model")
def profile_last(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    sites: dict[str, Any],
    standard: Float[Array, "point parameter"],
) -> tuple[Summaries, Profile]:
    """Tabulate the last parameter's likelihood, and clear the summaries of it."""
    cleared, spread = cleared_of_last(summaries), population(model, sites)
    conditional = condition(data.design, spread, data.location_mean, cleared)
    about = expected(data.design, conditional.mean)
    return cleared, profile_about(model, data, cleared, conditional.parts, about, standard)


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
    """The table of `profile_last` for given X b and impacts' parts."""
    count, last = cleared.centre.shape[0], cleared.centre.shape[1] - 1

    def one(value: Array) -> Array:
        def ratio(z: Array) -> Array:
            u = impact_values(parts, cleared, about, jnp.broadcast_to(z, (count, last + 1)))
            u = [*u[:last], jnp.full(count, value)]
            found = log_likelihood(model, data, u) - cleared.log_summary(u)
            return jnp.where(jnp.isfinite(found), found, -1e6)

        ratios = jax.vmap(ratio)(standard)
        return jax.nn.logsumexp(ratios, axis=0) - jnp.log(standard.shape[0])

    table = jnp.maximum(jax.lax.map(one, jnp.asarray(_GRID)), -1e6)
    return flat_profile(count)._replace(log_likelihood=table)


class Ratios(NamedTuple):
    """Likelihood over summary of each impact, wherever the posterior lets its parameters be.

    The spread of the noise between impacts may be next to nothing, and each draw of the population then asks
    for another value of the noise than all others: no set of points serves them all. So the dependence on
    the noise is tabulated apart, everything else integrated out, and the points lie at one noise.

    Attributes:
        u: points, [point, impact, parameter], the noise of each impact at its reference.
        log_density: log density of the other parameters there, given that noise, up to a constant.
        log_ratio: log of likelihood over summary there.
        reach: of the table of noise, on either side of the reference.
        coefficients: of the log ratio's Chebyshev polynomials in the noise.
    """

    u: Float[Array, "point impact parameter"]
    log_density: Float[Array, "point impact"]
    log_ratio: Float[Array, "point impact"]
    reach: Float[Array, " impact"]
    coefficients: Float[Array, "power impact"]

    def log_mean_over_noise(self, mean: Array, sd: Array) -> Float[Array, " impact"]:
        """Log of the mean of the tabulated ratio under a normal noise."""
        away = mean - self.u[0, :, NOISE] + sd * jnp.asarray(_NOISE_POINTS)[:, None]
        x = jnp.clip(away / self.reach, -1.0, 1.0)
        before, now = jnp.ones_like(x), x
        total = self.coefficients[0] + self.coefficients[1] * now
        for coefficient in self.coefficients[2:]:
            before, now = now, 2 * x * now - before
            total = total + coefficient * now
        return jax.nn.logsumexp(total, axis=0, b=jnp.asarray(_NOISE_WEIGHTS)[:, None])


NOISE = 2
_NODES = 7
_POINTS_A_NODE = 16
_NOISE_POINTS, _NOISE_WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_NOISE_WEIGHTS = _NOISE_WEIGHTS / _NOISE_WEIGHTS.sum()


@partial(jax.jit, static_argnames="model")
def compare_over(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    draws: tuple[dict[str, Array], Array],
    standard: Float[Array, "point parameter"],
    profile: Profile | None = None,
) -> Ratios:
    """Compare at one point from each of several draws of the population, (spreads, b).

    The points' density is the mixture over these draws, so that wherever the posterior lets an impact's
    parameters be, there are points. A last parameter that has a profile is left out of them: what is
    compared is the rest, whatever that parameter is.
    """
    sites, b = draws
    spreads = jax.lax.map(partial(population, model), sites)
    abouts = jax.lax.map(partial(expected, data.design), b)
    return compare_over_about(model, data, summaries, spreads, abouts, standard, profile)


def compare_over_about(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    spreads: Spread,
    abouts: list[Float[Array, "draw impact"]],
    standard: Float[Array, "point parameter"],
    profile: Profile | None = None,
) -> Ratios:
    """`compare_over` for the spreads and X b of each draw."""
    size = summaries.centre.shape[1]
    known = size if profile is None else size - 1
    lasts = abouts[-1] + spreads.nuisance[-1][:, None] * standard[:, -1:]

    def conditional(part: tuple[Spread, list[Array]]) -> tuple[Array, Array]:
        spread, about = part
        return _conditional(impact_parts(spread, summaries), summaries, about, known)

    shifts, factors = jax.lax.map(conditional, (spreads, abouts))
    noise, noise_sd = _noise_of(shifts, factors)
    reference = noise.mean(0)
    reach = jnp.abs(noise - reference).max(0) + 4 * noise_sd.max(0)

    def ratio(away: Array, shift: Array, factor: Array, z: Array, last: Array) -> tuple[Array, Array]:
        """At a noise so far from the centre; the others from their conditional."""
        others = _given_noise(shift, factor, away, z)
        columns = [*others[:NOISE], away, *others[NOISE:]]
        u = [summaries.centre[:, a] + columns[a] for a in range(known)]
        whole = u if profile is None else [*u, last]
        found = log_likelihood(model, data, whole) - summaries.log_summary(whole)
        if profile is not None:
            found = found - profile.at(last)
        return jnp.stack(u, axis=-1), jnp.where(jnp.isfinite(found), found, -jnp.inf)

    rows = (shifts, factors, standard[:, : known - 1], lasts)
    u, log_ratio = jax.lax.map(lambda row: ratio(reference, *row), rows)

    def add(total: Array, part: tuple[Array, Array]) -> tuple[Array, None]:
        return jnp.logaddexp(total, _log_normal(u, summaries, *part)), None

    start = jnp.full(log_ratio.shape, -jnp.inf)
    log_density, _ = jax.lax.scan(add, start, (shifts, factors))
    nodes = jnp.asarray(np.polynomial.chebyshev.chebpts1(_NODES))
    few = jax.tree.map(lambda each: each[:: max(1, len(standard) // _POINTS_A_NODE)], rows)

    def at_node(node: Array) -> Array:
        ratios = jax.lax.map(lambda row: ratio(reference + node * reach, *row)[1], few)
        return jax.nn.logsumexp(ratios, axis=0)

    table = jax.lax.map(at_node, nodes)
    # Where no point has any likelihood the polynomial must not be torn by minus infinity.
    table = jnp.maximum(table - table.max(0), _LEAST_RATIO)
    coefficients = jnp.asarray(_chebyshev()) @ table
    return Ratios(u, log_density, log_ratio, reach, coefficients)


_LEAST_RATIO = -50.0


def _chebyshev() -> np.ndarray:
    """From values at the nodes to coefficients."""
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)
    return np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, _NODES - 1))


def log_corrections(
    ratios: Ratios, summaries: Summaries, parts: ImpactParts, about: list[Array]
) -> Float[Array, " impact"]:
    """Log of each trace's true evidence over its summary's, given X b and the spreads, up to a constant.

    The mean of likelihood over summary under the normal conditional of u: that of the table over the noise,
    times that of the points, reweighted, over the other parameters.
    """
    shift, factor = _conditional(parts, summaries, about, ratios.u.shape[-1])
    log_weight = _log_normal(ratios.u, summaries, shift, factor) - ratios.log_density
    weighted, weight = (jax.nn.logsumexp(w, axis=0) for w in (log_weight + ratios.log_ratio, log_weight))
    noise, noise_sd = _noise_of(shift, factor)
    return weighted - weight + ratios.log_mean_over_noise(summaries.centre[:, NOISE] + noise, noise_sd)


def pareto_smoothed(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Log importance weights with their greatest smoothed, and the Pareto k of these (Vehtari et al. 2024).

    Args:
        log_weight: [draw].
    """
    from arviz_stats.base import array_stats

    # The library takes log likelihoods to leave out, whose weights are their inverses.
    smoothed, k = array_stats.psislw(-np.asarray(log_weight))
    return np.asarray(smoothed), float(k)


def _noise_of(shift: Array, factor: Array) -> tuple[Array, Array]:
    """Mean, less the summaries' centre, and standard deviation of the noise under `_conditional`."""
    diagonal = factor[..., -1, -1, :]
    return shift[..., -1, :] / diagonal, 1 / diagonal


def _given_noise(shift: Array, factor: Array, away: Array, z: Array) -> list[Array]:
    """The other parameters, less the centre, from standard normals, the noise being ``away`` from it."""
    others = factor.shape[0] - 1
    lower = [[factor[a, b] for b in range(a + 1)] for a in range(others)]
    right = [shift[a] - factor[others, a] * away + z[a] for a in range(others)]
    return small.backward_solve(lower, right)


def _conditional(
    parts: ImpactParts, summaries: Summaries, about: list[Array], size: int
) -> tuple[Float[Array, "parameter impact"], Float[Array, "parameter parameter impact"]]:
    """The normal conditional of an impact's first ``size`` parameters: L^-1 (g + D (X b - m)) and L.

    L L' = P + D, with the noise as the last row, so that the rows before it belong to the others' conditional
    given the noise. Parameters beyond have no part in the summaries.
    """
    order = [*range(NOISE), *range(NOISE + 1, size), NOISE]
    own = small.entries(summaries.precision)
    factor = small.cholesky([[own[a][b] + parts.prior[a][b] for b in order] for a in order])
    away = [about[a] - summaries.centre[:, a] for a in range(size)]
    pulled = [small.dot(parts.prior[a][:size], away) for a in range(size)]
    shift = small.forward_solve(factor, [summaries.slope[:, a] + pulled[a] for a in order])
    zero = jnp.zeros_like(shift[0])
    lower = [[factor[a][b] + zero if b <= a else zero for b in range(size)] for a in range(size)]
    return jnp.stack(shift), jnp.stack([jnp.stack(row) for row in lower])


def _log_normal(u: Array, summaries: Summaries, shift: Array, factor: Array) -> Array:
    """Log density of the parameters but the noise at the points, given their noise, up to a constant.

    L' (u - m) - L^-1 (...) is standard normal.
    """
    size = u.shape[-1]
    order = [*range(NOISE), *range(NOISE + 1, size), NOISE]
    moved = [u[..., a] - summaries.centre[:, a] for a in order]
    total = jnp.log(jnp.stack([factor[a, a] for a in range(size - 1)])).sum(0)
    for a in range(size - 1):
        z = sum(factor[b, a] * moved[b] for b in range(a, size)) - shift[a]
        total = total - z**2 / 2
    return total
