"""Sites judged by draws of the population, fitted anew about them, and what they leave out to second order.

What a trace's true evidence adds to its site's is a smooth function of what the population says of the
impact. Small as it is for one trace, over many it adds up to more than weights could put right. But with many
impacts the posterior of the population is narrow beside the scatter of the impacts, which is the scale on
which these functions bend: their expansions about the posterior's middle, added up cell by cell, go into the
marginal density itself. Whether that is done is decided by the importance weights of some draws.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.hierarchy.gaussian.conditional import flat_covariances, given_covariances
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, population
from bayestissue.inference.execution.chunks import Progress, in_blocks, silent
from bayestissue.inference.factors.conditional import (
    POINTS,
    ConditionalPrior,
    PopulationDraws,
    of_cells,
    population_draws,
)
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    log_corrections,
    log_evidence_corrections,
    ratios_among,
)
from bayestissue.inference.factors.sites import regression_sites
from bayestissue.inference.posterior.approximate import LAST, Approximation
from bayestissue.inference.samplers.psis import relative_variance

# Of weights that vary by a quarter, as those of 100,000 impacts did, 40 draws have a Pareto k above the
# threshold of their number 27 times of 100; so many had none of 400 times.
CHECKS = 192
_MOST_TIMES = 2


class Ratios(NamedTuple):
    """Importance ratios of draws of the population.

    Attributes:
        log_weight: log of the true evidence over the one that draws are made with, up to a constant.
        of_impacts: log of each trace's evidence over its site's.
        varies: relative variance of each impact's likelihood over its site, where it is compared.
    """

    log_weight: Float[np.ndarray, " draw"]
    of_impacts: Float[np.ndarray, "draw impact"]
    varies: Float[np.ndarray, " impact"]


def draws_at(
    prepared: Prepared,
    approximation: Approximation,
    y: Float[np.ndarray, "draw coordinate"],
    standard: Float[np.ndarray, "draw location"],
) -> tuple[PopulationDraws, Float[np.ndarray, "draw location"]]:
    """Draws of the population from coordinates and standard normals; and the standard effects they have."""
    raw, z_b = approximation.coordinates.raw(y), np.array(standard)
    if approximation.grid is not None:
        z_b[:, -1] = raw.pop(LAST)
    return population_draws(prepared.model, approximation.data(prepared.data), raw, z_b), z_b


def to_second_order(
    prepared: Prepared, approximation: Approximation, count: int, rng: np.random.Generator
) -> PopulationDraws:
    """Draws of the population to second order, which cost no chain; of the first b has its mean."""
    size = len(approximation.coordinates.names)
    y = rng.multivariate_normal(np.zeros(size), approximation.coordinates.covariance, count)
    z_b = rng.standard_normal((count, prepared.model.locations.size))
    y[0], z_b[0] = 0.0, 0.0
    return draws_at(prepared, approximation, y, z_b)[0]


def importance_weights(
    prepared: Prepared,
    approximation: Approximation,
    draws: PopulationDraws,
    compared: PopulationDraws,
    progress: Progress = silent,
) -> Ratios:
    """Importance ratios of draws of the population.

    Args:
        prepared: model and data.
        approximation: of the traces, with the second-order factor where that is part of the density.
        draws: to be weighted.
        compared: others, of which some give the points at which traces and sites are compared.
        progress: told how many blocks of impacts are done.
    """
    model, data = prepared.model, prepared.data
    cell = np.asarray(data.design.cell)
    at, mixture = (ratios.priors(data.design) for ratios in (draws, compared.subset(POINTS)))

    def one(part: TraceData, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sites, grid = approximation.of_rows(rows)
        points = ratios_among(model, part, sites, of_cells(mixture, cell[rows]), grid)
        log_ratio = log_evidence_corrections(sites, points, of_cells(at, cell[rows]))
        return np.where(np.isfinite(log_ratio), log_ratio, -np.inf).T, relative_variance(points.log_ratio)

    ratios, varies = in_blocks(data, one, progress=progress)
    whole = ratios.sum(0)
    if approximation.second_order is not None:
        whole = whole - np.asarray(_second_order(model, data.design, approximation.second_order, draws))
    return Ratios(whole, ratios.T, varies)


def refitted(
    prepared: Prepared,
    approximation: Approximation,
    draws: PopulationDraws,
    seed: int,
    progress: Progress = silent,
) -> Approximation:
    """Regression sites about draws of the population; a grid of the last parameter is not made anew.

    If the marginal density has no mode with the new sites, the approximation is returned as it was.
    """
    cell, priors = np.asarray(prepared.data.design.cell), draws.priors(prepared.data.design)

    def one(part: TraceData, rows: np.ndarray) -> GaussianFactor:
        rng = np.random.default_rng([seed, 41, int(rows[0])])
        sites, _ = approximation.of_rows(rows)
        return regression_sites(prepared.model, part, sites, of_cells(priors, cell[rows]), rng)

    sites = in_blocks(prepared.data, one, progress=progress)
    means = {name: values.mean() for name, values in draws.raw.items()}
    try:
        return replace(approximation, sites=sites, second_order=None).near(prepared, means)
    except FloatingPointError:
        # If few draws are effective, they may be far from what the traces say.
        return approximation


def with_second_order(
    prepared: Prepared, approximation: Approximation, seed: int, limit: float, progress: Progress = silent
) -> Approximation:
    """The approximation with what its sites leave out to second order.

    That is added where log weights scatter by more than ``limit``. Each factor is made about the posterior's
    middle under the one before; one by which weights scatter more is left out.
    """
    rng, best, least = np.random.default_rng([seed, 25]), approximation, np.inf
    for number in range(1 + _MOST_TIMES):
        draws = to_second_order(prepared, approximation, CHECKS, rng)
        weight = importance_weights(prepared, approximation, draws, draws, progress).log_weight
        weight = weight[np.isfinite(weight)]
        scatter = weight.std() if 2 * len(weight) > CHECKS else np.inf
        if number and not scatter < least:
            break
        best, least = approximation, scatter
        if scatter < limit or number == _MOST_TIMES:
            break
        second_order = second_order_factor(prepared, approximation, draws, progress=progress)
        middle = {name: values[0] for name, values in draws.raw.items()}
        try:
            approximation = replace(approximation, second_order=second_order).near(prepared, middle)
        except FloatingPointError:
            # Weights of few points leave a factor that is none.
            break
    return best


def second_order_factor(
    prepared: Prepared, approximation: Approximation, draws: PopulationDraws, *, progress: Progress = silent
) -> GaussianFactor:
    """The second-order factor about one population.

    Args:
        prepared: model and data.
        approximation: of the traces.
        draws: of the population: the first is the one about which it is made, and of all some give the
            points at which traces and sites are compared.
        progress: told how many blocks of impacts are done.
    """
    model, data = prepared.model, prepared.data
    design, cell = data.design, np.asarray(data.design.cell)
    mixture, middle = (part.priors(design) for part in (draws.subset(POINTS), draws.rows(slice(1))))
    prior_mean = middle.mean[0]
    at = np.asarray(flat_covariances(population(model, {k: v[0] for k, v in draws.sites.items()})))

    def one(part: TraceData, rows: np.ndarray) -> tuple[Array, Array]:
        here = np.concatenate([prior_mean[cell[rows]], np.broadcast_to(at, (len(rows), len(at)))], axis=1)
        sites, grid = approximation.of_rows(rows)
        return _expand(sites, ratios_among(model, part, sites, of_cells(mixture, cell[rows]), grid), here)

    slope, bend = in_blocks(data, one, progress=progress)
    shift, precision = (design.to_cells(jnp.asarray(np.moveaxis(x, 0, -1))) for x in (slope, -bend))
    common = np.broadcast_to(at[:, None], (len(at), len(prior_mean)))
    centre = jnp.asarray(np.concatenate([prior_mean.T, common]))
    return GaussianFactor(centre, shift, precision, jnp.zeros(len(prior_mean)))


@jax.jit
def _second_order(
    model: TraceModel, design: PopulationDesign, factor: GaussianFactor, draws: PopulationDraws
) -> Float[Array, " draw"]:
    """Log of the second-order factor at some draws, but for a constant."""

    def one(draw: tuple[dict[str, Array], Array]) -> Array:
        of_mean = given_covariances(factor, population(model, draw[0]))
        return of_mean.recentred(expected_by_cell(design, draw[1])).log_scale.sum()

    return jax.lax.map(one, (draws.sites, draws.b))


@jax.jit
def _expand(
    sites: GaussianFactor, points: ImportanceRatios, middle: Float[Array, "impact v"]
) -> tuple[Array, Array]:
    """Slopes and bends of each impact's correction at the middle."""
    slope = jax.grad(lambda v: _correction(points, sites, v).sum())

    def bent(direction: Array) -> Array:
        return jax.jvp(slope, (middle,), (jnp.broadcast_to(direction, middle.shape),))[1]

    return slope(middle), jax.lax.map(bent, jnp.eye(middle.shape[1])).transpose(1, 2, 0)


def _correction(points: ImportanceRatios, sites: GaussianFactor, v: Array) -> Array:
    """Each impact's correction, as a function of what the population says of it."""
    size = sites.centre.shape[1]
    kk, kc, cc = v[:, size : size + 3].T
    prior = Covariances((kk, kc, cc), tuple(jnp.sqrt(v[:, size + 3 :]).T), jnp.zeros(0)).of_impact()
    return log_corrections(sites, points, ConditionalPrior(v[:, :size], jnp.moveaxis(prior, -1, 0)))
