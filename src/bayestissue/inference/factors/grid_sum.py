"""What all traces together say of the mean and spread of a parameter that has a grid, as one polynomial.

Every trace's evidence for theta1 is an integral over a normal with the population's mean and standard
deviation: two numbers, whatever the number of traces. Their sum over all traces is therefore tabulated once.
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

from bayestissue.inference.factors.grid import LEAST_SD, PLACES, STEP, LikelihoodGrid

DEGREES = (31, 23)
BLOCK = 2048
# Spreads of artanh theta1 below `LEAST_SD` act like none at all: no trace tells theta1 that well.
_GREATEST_SD = 4.0
# Grid steps that a standard deviation must span for sums over the grid to be integrals.
_STEPS = 2.0
# From the mode down and up, as far as posterior standard deviations, or else as these.
_REACH = 15.0
_WIDEST = np.array([[3.0, 1.5], [2.5, 2.0]])


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
        place = (jnp.stack([mean, log_sd]) - self.middle) / self.reach
        inside = jnp.clip(place, -1.0, 1.0)
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
        np.linalg.inv(chebyshev.chebvander(each, degree)) for each, degree in zip(nodes, DEGREES, strict=True)
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
    some = LikelihoodGrid(jnp.asarray(grid.log_likelihood)[:, rows])
    weight = count / len(rows)
    rough = surface_of(some, *_rectangle(start, np.full(2, np.inf)))
    mode, sd = posterior(rough._replace(coefficients=rough.coefficients * weight))
    return surface_of(grid, *_rectangle(mode, sd * np.sqrt(weight)))


def _rectangle(mode: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mode = np.array([mode[0], np.clip(mode[1], np.log(LEAST_SD) + 0.1, np.log(_GREATEST_SD) - 0.1)])
    low, high = (mode + side * np.minimum(_REACH * sd, _WIDEST[:, i]) for i, side in enumerate((-1, 1)))
    low[1], high[1] = max(low[1], np.log(LEAST_SD)), min(high[1], np.log(_GREATEST_SD))
    return low, high
