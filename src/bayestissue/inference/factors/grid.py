"""The likelihood of a parameter that traces may leave open, where no normal describes it: a grid of values.

What all traces together say of the mean and the standard deviation of such a parameter is a function of two
numbers, whatever the number of traces. Of many traces it is tabulated once, as one polynomial: `GridSum`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.stats import norm
from jaxtyping import Float
from numpy.polynomial import chebyshev
from scipy.interpolate import pchip_interpolate
from scipy.special import logsumexp

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.factors.conditional import ConditionalPrior, normals
from bayestissue.inference.factors.likelihoods import log_likelihoods

PLACES = np.linspace(-8.0, 8.0, 161)
STEP = float(PLACES[1] - PLACES[0])
# The narrowest likelihood of a last parameter, as its standard deviation: cubics between places 0.1 apart are
# off by some tenths there, and by anything below. No trace tells theta1 so well.
LEAST_SD, _FEW_NARROW = 0.025, 0.1
_DEEPEST = 200.0
# Stands for the log of no likelihood.
_NONE = -1e6
# Where only the place is asked for, every so many points of the grid are enough.
_ROUGHLY = 4
# At most 1.6 of a likelihood's standard deviations apart where that is a fourth of its population's or more:
# the integral's relative error is below 1e-3 then.
_HERMITE_POINTS, _HERMITE_WEIGHTS = np.polynomial.hermite_e.hermegauss(64)
DEGREES = (31, 23)
BLOCK = 2048
# Spreads of artanh theta1 below `LEAST_SD` act like none at all: no trace tells theta1 that well.
_GREATEST_SD = 4.0
# Grid steps that a standard deviation must span for sums over the grid to be integrals.
_STEPS = 2.0
# From the mode down and up, as far as posterior standard deviations, or else as these.
_REACH = 15.0
_WIDEST = np.array([[3.0, 1.5], [2.5, 2.0]])


class LikelihoodGrid(NamedTuple):
    """Log likelihood of each impact's last parameter at `PLACES`, the others integrated out.

    For theta1, which a trace may leave open all the way to -1, and for what an element has besides K and C,
    which it leaves open where that is not needed: no normal describes such a likelihood.

    Attributes:
        log_likelihood: relative to the site, which is level along the last parameter.
    """

    log_likelihood: Float[Array, "grid impact"]

    def at(self, value: Float[Array, "*batch impact"]) -> Float[Array, "*batch impact"]:
        """Cubic interpolation, level beyond the grid."""
        number = self.log_likelihood.shape[0]
        position = jnp.clip((value - PLACES[0]) / STEP, 0.0, number - 1.0)
        index = jnp.clip(jnp.floor(position).astype(int), 1, number - 3)
        t = position - index
        columns = jnp.arange(self.log_likelihood.shape[1])
        a, b, c, d = (self.log_likelihood[index + k, columns] for k in (-1, 0, 1, 2))
        bend = a * (-0.5) + 1.5 * b - 1.5 * c + 0.5 * d
        return ((bend * t + a - 2.5 * b + 2 * c - 0.5 * d) * t + (c - a) / 2) * t + b

    @property
    def resolved(self) -> bool:
        """Whether the likelihoods are finite, and wide enough not to fall between the places.

        Where they do, the nearest place stands for each, and impacts that share it for a population without
        spread. A few such among many have their parameter off by half a step, and matter little.
        """
        table = np.asarray(self.log_likelihood)
        if not np.isfinite(table).all():
            return False
        top_index = np.clip(table.argmax(0), 1, len(table) - 2)
        before, top, after = (np.take_along_axis(table, (top_index + k)[None], 0)[0] for k in (-1, 0, 1))
        narrow = 2 * top - before - after > (STEP / LEAST_SD) ** 2
        return bool(narrow.mean() < _FEW_NARROW)

    def total(self, mean: Array, sd: Array) -> Float[Array, ""]:
        """The log evidence of all impacts together."""
        return self.log_evidence(mean, sd).sum()

    def log_evidence(self, mean: Array, sd: Array) -> Float[Array, " impact"]:
        """Log of the integral over a normal last parameter, by Gauss-Hermite quadrature."""
        points = mean + sd * jnp.asarray(_HERMITE_POINTS)[:, None]
        weights = jnp.asarray(_HERMITE_WEIGHTS / _HERMITE_WEIGHTS.sum())[:, None]
        return jax.nn.logsumexp(self.at(points), axis=0, b=weights)


def without_last(sites: GaussianFactor) -> GaussianFactor:
    """Sites that say nothing of the last parameter."""
    shift, precision = np.array(sites.shift), np.array(sites.precision)
    shift[:, -1], precision[:, -1], precision[:, :, -1] = 0.0, 0.0, 0.0
    return sites._replace(precision=precision, shift=shift)


def integrated_likelihood_grid(
    model: TraceModel,
    data: TraceData,
    sites: GaussianFactor,
    prior: ConditionalPrior,
    standard: Float[np.ndarray, "point parameter"],
    *,
    coarse: bool = False,
) -> LikelihoodGrid:
    """Tabulate the last parameter's likelihood, of which the sites are cleared.

    ``coarse`` is enough to tell where it is greatest, at a quarter of the cost.
    """
    grid = PLACES[:: _ROUGHLY if coarse else 1]
    u = normals(sites, prior).at(standard[:, None])
    number, impacts, size = u.shape
    moved = np.repeat(u[None], len(grid), axis=0)
    moved[..., -1] = grid[:, None, None]
    density = log_likelihoods(model, data, moved.reshape(-1, impacts, size))
    ratios = density.reshape(-1, number, impacts) - sites.log_density(u)
    table = logsumexp(np.maximum(ratios, _NONE), axis=1) - np.log(number)
    # Cubics overshoot where a steep fall ends; so far down it does not matter.
    table = np.maximum(table, table.max(0) - _DEEPEST)
    if coarse:
        table = pchip_interpolate(grid, table, PLACES)
    return LikelihoodGrid(jnp.asarray(table))


class GridSum(NamedTuple):
    """Chebyshev polynomials over a rectangle of (mean, log sd).

    Attributes:
        middle: of the rectangle.
        reach: from there to its sides.
        coefficients: of T_i(mean) T_j(log sd).
    """

    middle: Float[Array, " pair"]
    reach: Float[Array, " pair"]
    coefficients: Float[Array, "power power"]

    def total(self, mean: Array, sd: Array) -> Float[Array, ""]:
        """The log evidence of all impacts together."""
        return self.at(mean, jnp.log(sd))

    def at(self, mean: Array, log_sd: Array) -> Array:
        """The value at a point; outside of the rectangle that of the nearest edge."""
        scaled = (jnp.stack([mean, log_sd]) - self.middle) / self.reach
        inside = jnp.clip(scaled, -1.0, 1.0)
        by_mean, by_sd = (_powers(inside[i], degree) for i, degree in enumerate(DEGREES))
        return by_mean @ self.coefficients @ by_sd


def _powers(x: Array, degree: int) -> Array:
    def step(pair: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        before, now = pair
        return (now, 2 * x * now - before), before

    return jax.lax.scan(step, (jnp.ones_like(x), x), None, length=degree + 1)[1]


def surface_of(grid: LikelihoodGrid, low: np.ndarray, high: np.ndarray) -> GridSum:
    """Tabulate over the rectangle from ``low`` to ``high`` of (mean, log sd)."""
    middle, reach = (low + high) / 2, (high - low) / 2
    nodes = [chebyshev.chebpts1(degree + 1) for degree in DEGREES]
    means, log_sds = (middle[i] + reach[i] * nodes[i] for i in range(2))
    count = grid.log_likelihood.shape[1]
    table = np.zeros((len(means), len(log_sds)))
    for begin in range(0, count, BLOCK):
        part = LikelihoodGrid(jnp.asarray(grid.log_likelihood[:, begin : begin + BLOCK]))
        for column, sd in enumerate(np.exp(log_sds)):
            finer = int(2 ** np.ceil(np.log2(max(1.0, _STEPS * STEP / sd))))
            table[:, column] += np.asarray(_evidence(part, jnp.asarray(means), jnp.asarray(sd), finer))
    by_mean, by_sd = (
        np.linalg.inv(chebyshev.chebvander(node, degree)) for node, degree in zip(nodes, DEGREES, strict=True)
    )
    return GridSum(jnp.asarray(middle), jnp.asarray(reach), jnp.asarray(by_mean @ table @ by_sd.T))


@partial(jax.jit, static_argnames="finer")
def _evidence(grid: LikelihoodGrid, means: Array, sd: Array, finer: int) -> Array:
    """Log evidence of all impacts for each mean: a sum over the grid, refined so that sd spans its steps."""
    number = (grid.log_likelihood.shape[0] - 1) * finer + 1
    places = PLACES[0] + STEP / finer * jnp.arange(number)
    width = (grid.log_likelihood.shape[1],)
    likelihood = jax.lax.map(lambda value: grid.at(jnp.full(width, value)), places)
    greatest = likelihood.max(axis=0)
    weight = jnp.exp(-(((places - means[:, None]) / sd) ** 2) / 2)
    # A mean near the end of the grid has the rest of its normal beyond, where the grid is level.
    edges = norm.cdf(-(means - places[0]) / sd), norm.cdf((means - places[-1]) / sd)
    inside = weight * (1 - edges[0] - edges[1])[:, None] / weight.sum(axis=1, keepdims=True)
    whole = inside.at[:, 0].add(edges[0]).at[:, -1].add(edges[1])
    return (jnp.log(whole @ jnp.exp(likelihood - greatest)) + greatest).sum(axis=1)


def grid_sum_around(
    grid: LikelihoodGrid, posterior: Callable[[GridSum], tuple[np.ndarray, np.ndarray]], start: np.ndarray
) -> GridSum:
    """A surface that reaches many standard deviations about the posterior's mode.

    Some of the impacts, weighted up, tell first where that is.

    Args:
        grid: of all impacts.
        posterior: from a surface to the posterior's mode and standard deviations of (mean, log sd) under it.
        start: a first guess of the mode.
    """
    count = grid.log_likelihood.shape[1]
    rows = np.unique(np.linspace(0, count - 1, min(count, BLOCK)).astype(int))
    sample = LikelihoodGrid(jnp.asarray(grid.log_likelihood)[:, rows])
    weight = count / len(rows)
    rough = surface_of(sample, *_rectangle(start, np.full(2, np.inf)))
    mode, sd = posterior(rough._replace(coefficients=rough.coefficients * weight))
    return surface_of(grid, *_rectangle(mode, sd * np.sqrt(weight)))


def _rectangle(mode: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mode = np.array([mode[0], np.clip(mode[1], np.log(LEAST_SD) + 0.1, np.log(_GREATEST_SD) - 0.1)])
    low, high = (mode + side * np.minimum(_REACH * sd, _WIDEST[:, i]) for i, side in enumerate((-1, 1)))
    low[1], high[1] = max(low[1], np.log(LEAST_SD)), min(high[1], np.log(_GREATEST_SD))
    return low, high
