"""The hierarchy over published estimates: a latent Gaussian model, lost tables its only other factors.

A printed estimate y of an impact is known exactly: y ~ N(X b, S), with S the covariance of an impact's
(log K, log C). The averages of a lost table are a factor over its trial, normal in the mean of its people's
expectations; but its spread depends on how much these differ, v = Var(X b) over the people, which is no
Gaussian function of b. Its Gaussian site holds v at a value; factor over site puts things right.

`integrated` is what the chain asks of it; the tests have the same model from the top down, for numpyro.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.gaussian.arrangement import (
    PopulationDesign,
    arrange,
    expected,
    expected_by_cell,
)
from bayestissue.model.hierarchy.gaussian.effects import (
    Covariances,
    EffectsPosterior,
    integrate_effects,
)
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import EffectPart, EffectParts, effects_of
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.model.hierarchy.responses import RESPONSES
from bayestissue.model.hierarchy.trace_models import Hierarchy, hyperparameters_at
from bayestissue.model.likelihood import small
from bayestissue.thesis.reanalysis.observations import (
    PublishedObservations,
    moments_of_people,
    pair_covariance,
)

# Hyperparameters without constraints, all effects b, and of each lost table something of K and of C.
Coordinates = Float[Array, " hyperparameter"]
Effects = Float[Array, " location"]
PairPerTable = Float[Any, "table 2"]


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=["locations", "priors", "correlated"])
@dataclass(frozen=True)
class EstimatesModel(Hierarchy):
    """What is assumed: the parts of b and the priors. Competing formulas share it: see `common_effects`."""

    locations: EffectParts
    priors: Priors
    correlated: bool
    # Published masses are taken as exact.
    log_mass_sd = 0.0


class EstimatesData(NamedTuple):
    """What the model reads, all of it arrays. A row is the mean of a lost table, or an estimate.

    Attributes:
        design: X over rows; that of a lost table is the mean over its people.
        location_mean: prior mean of b.
        value: (log K, log C) of an estimate; (m_K, m_C) of a lost table, see `average_statistics`.
        included: 1, or 0 for a row that is held out.
        roots: of each lost table, the cube roots of its variances of logs.
        people: of log K and of log C, X of each lost table's people less their mean.
        scatter: variance of X b over these people, at which the tables' sites are made.
    """

    design: PopulationDesign
    location_mean: Float[Any, " location"]
    value: Float[Any, "impact 2"]
    included: Float[Any, " impact"]
    roots: PairPerTable
    people: tuple[Float[Any, "table person part"], ...]
    scatter: PairPerTable


def common_effects(designs: Iterable[Design], priors: Priors) -> EffectParts:
    """One arrangement of b for all formulas, so that what is compiled for one serves every other.

    Each part is as wide as in the formula that needs most of it. A coefficient whose columns are zero keeps
    its prior and changes nothing else.
    """
    each_effects = [effects_of(design, priors, ())[0] for design in designs]
    widest: dict[str, EffectPart] = {}
    for part in (part for effects in each_effects for part in effects.blocks):
        previous = widest.setdefault(part.name, part)
        widest[part.name] = max(part, previous, key=lambda candidate: candidate.width)
    # All of log K's parts before those of log C.
    return EffectParts(tuple(sorted(widest.values(), key=lambda part: RESPONSES.index(part.name[-1]))))


def estimates_data(
    design: Design, observations: PublishedObservations, model: EstimatesModel
) -> EstimatesData:
    """The observations and one formula's design, in the model's arrangement of b."""
    effects, matrices = effects_of(design, model.priors, ())
    columns_of_formula, begin = np.concatenate(matrices, axis=1), model.locations.parts["intercept_C"].start
    whole = np.zeros((len(columns_of_formula), model.locations.size))
    for name, part in effects.parts.items():
        start = model.locations.parts[name].start
        whole[:, start : start + part.stop - part.start] = columns_of_formula[:, part]
    columns = (whole[:, :begin], whole[:, begin:])
    cells, tables = observations.impact_cell, observations.averaged_cells
    rows = tuple(np.concatenate([part[tables].mean(1), part[cells]]) for part in columns)
    return EstimatesData(
        arrange(rows, np.arange(len(rows[0])), model.locations.groups),
        model.locations.mean,
        np.concatenate([observations.averages[:, :2], observations.log_estimates]),
        np.ones(len(rows[0])),
        observations.averages[:, 2:],
        tuple(part[tables] - part[tables].mean(1, keepdims=True) for part in columns),
        np.zeros((len(tables), 2)),
    )


def without(data: EstimatesData, rows: Bool[np.ndarray, " impact"]) -> EstimatesData:
    """The data with some rows held out: these stay in place and do not enter the density."""
    return data._replace(included=np.where(rows, 0.0, data.included))


class Rows(NamedTuple):
    """Each row's density as a function of its v = X b: a constant and a normal of (centre - v)."""

    centre: Float[Array, "2 impact"]
    covariance: Float[Array, "2 2 impact"]
    constant: Float[Array, " impact"]

    def log_density(self, expectation: Float[Array, "2 impact"]) -> Float[Array, " impact"]:
        """At v = ``expectation``."""
        return self.constant + small.normal_log_density(self.centre - expectation, self.covariance)


def _rows(data: EstimatesData, covariances: Covariances, scatter: PairPerTable) -> Rows:
    """The estimates, and the lost tables with their people's expectations ``scatter`` apart."""
    tables, estimates, residual = len(data.roots), len(data.value) - len(data.roots), covariances.pair_matrix
    factor = jnp.broadcast_to(jnp.linalg.cholesky(residual), (tables, 2, 2))
    offset, sd, correlation = moments_of_people(
        jnp.zeros((tables, 2)), scatter, factor, data.people[0].shape[1]
    )
    means, roots = (pair_covariance(sd[:, a : a + 2].T, correlation[:, a // 2]) for a in (0, 2))
    constant = small.normal_log_density((data.roots - offset[:, 2:]).T, roots)
    covariance = jnp.concatenate([means, jnp.broadcast_to(residual[..., None], (2, 2, estimates))], axis=-1)
    centre = jnp.asarray(data.value).T.at[:, :tables].add(-offset[:, :2].T)
    return Rows(centre, covariance, jnp.append(constant, jnp.zeros(estimates)))


def _sums(data: EstimatesData, rows: Rows) -> GaussianFactor:
    """What the rows that are kept say of X b, as a constant, a slope and a curvature at b's prior mean."""
    expectation = expected(data.design, data.location_mean)
    precision = data.included * small.stacked(small.inverse(rows.covariance))
    shift = jnp.stack(small.times(precision, rows.centre - expectation))
    constant = data.included * rows.log_density(expectation)
    sums = (data.design.to_cells(values) for values in (shift, precision, constant))
    return GaussianFactor(expected_by_cell(data.design, data.location_mean), *sums)


class Integrated(NamedTuple):
    """All rows that are kept, b integrated out and a site in each lost table's place.

    Attributes:
        conditional: of b.
        log_density: of the rows and the hyperparameters.
    """

    conditional: EffectsPosterior
    log_density: Float[Any, ""]


def integrated(model: EstimatesModel, data: EstimatesData, y: Coordinates) -> Integrated:
    """See `Integrated`; ``y`` are the hyperparameters' unconstrained coordinates."""
    hyperparameters, log_prior = hyperparameters_at(model, y)
    covariances = model.covariances(hyperparameters)
    sums = _sums(data, _rows(data, covariances, data.scatter))
    conditional, log_density = integrate_effects(data.design, covariances, sums)
    return Integrated(conditional, jnp.where(jnp.isfinite(log_density), log_prior + log_density, -jnp.inf))


def leave_one_out(model: EstimatesModel, data: EstimatesData, y: Coordinates) -> Float[Array, " impact"]:
    """Log density of each row given all others that are kept, b integrated out and the tables by their sites.

    With residual e about the mean of X b given all rows, C its covariance there and S the row's own, the row
    given the others is normal about y - S (S - C)^-1 e with covariance S (S - C)^-1 S.
    """
    covariances = model.covariances(hyperparameters_at(model, y)[0])
    rows = _rows(data, covariances, data.scatter)

    # By Fisher's identity the slopes are the moments of X b, less its prior mean.
    slopes_at = jax.grad(lambda sums: integrate_effects(data.design, covariances, sums)[1])
    slopes = slopes_at(_sums(data, rows))
    # The density reads one half of each precision alone.
    squares = -(slopes.precision + slopes.precision.swapaxes(0, 1))[..., data.design.cell]
    moved = slopes.shift[:, data.design.cell]
    residual = rows.centre - expected(data.design, data.location_mean) - moved
    row_covariance = rows.covariance
    turned = small.product(row_covariance, small.inverse(row_covariance - squares + moved[:, None] * moved))
    covariance = small.product(turned, row_covariance)
    return rows.constant + small.normal_log_density(small.times(turned, residual), covariance)


class Densities(NamedTuple):
    """What the data say of a draw of everything.

    Attributes:
        scatter: variance of X b over each lost table's people.
        log_ratio: of the lost tables' factors over their sites.
        rows: log density of every row's data, kept or not.
    """

    scatter: PairPerTable
    log_ratio: Float[Any, ""]
    rows: Float[Any, " impact"]


def densities(model: EstimatesModel, data: EstimatesData, y: Coordinates, b: Effects) -> Densities:
    """See `Densities`."""
    covariances = model.covariances(hyperparameters_at(model, y)[0])
    at_sites = _rows(data, covariances, data.scatter)
    people = people_deviations(data, b)
    scatter = (people**2).sum(1) / (people.shape[1] - 1)
    expectation = expected(data.design, b)
    rows = _rows(data, covariances, scatter).log_density(expectation)
    log_ratio = data.included @ (rows - at_sites.log_density(expectation))
    return Densities(scatter, log_ratio, rows)


def people_deviations(data: EstimatesData, b: Effects) -> Float[Array, "table person 2"]:
    """X b of each lost table's people less their mean."""
    begin = data.people[0].shape[-1]
    return jnp.stack([data.people[0] @ b[:begin], data.people[1] @ b[begin:]], axis=-1)
