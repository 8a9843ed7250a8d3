"""The hierarchy over published estimates: a latent Gaussian model, of which lost tables are the only other part.

A printed estimate y of an impact is known exactly: y ~ N(X b, S), with S the covariance of an impact's
(log K, log C). The averages of a lost table are a factor over its trial, normal in the mean of its people's
expectations; but its spread depends on how much these differ, v = Var(X b) over the people, which is no
Gaussian function of b. Its Gaussian site holds v at a value; factor over site puts things right.

Written twice. `plain_model` says what is believed, top down. `sampled_model` is the same density in
coordinates made for sampling, and `marginal_model` that of the hyperparameters given the sites.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.effects import RESPONSES, cholesky_factor
from bayestissue.hierarchy.gaussian.conditional import information, score
from bayestissue.hierarchy.half_normal import HalfNormalSpread
from bayestissue.hierarchy.population import (
    Covariances,
    Effects,
    PopulationDesign,
    covariances_of,
    effects_of,
    expected,
)
from bayestissue.hierarchy.priors import HalfNormal, Priors
from bayestissue.hierarchy.published import PublishedObservations
from bayestissue.hierarchy.traces import sample_warped
from bayestissue.hierarchy.warp import SinhArcsinh
from bayestissue.likelihood.averages import (
    AveragesOfLognormals,
    PairCovariance,
    moments_of_people,
    pair_covariance,
    pair_log_density,
)


@dataclass(frozen=True, eq=False)
class EstimatesModel:
    """What is assumed: the parts of b and the priors. Competing formulas share it: see `common_effects`."""

    locations: Effects
    priors: Priors
    correlated: bool

    @property
    def spreads(self) -> tuple[str, ...]:
        """Names of the hyperparameters: standard deviations, and the residual correlation."""
        groups = sorted({name for name in self.locations.spread if name})
        return (*groups, "sd_impact_K", "sd_impact_C", *["residual_correlation"] * self.correlated)

    def prior_of(self, name: str) -> dist.Distribution:
        """The prior of one of `spreads`."""
        if name == "residual_correlation":
            return self.priors.residual_correlation.numpyro()
        prior = getattr(getattr(self.priors, name[:-2]), name[-1])
        return HalfNormalSpread(prior.scale) if isinstance(prior, HalfNormal) else prior.numpyro()


class EstimatesData(NamedTuple):
    """What the model reads, all of it arrays. A row is a surviving estimate, or the mean of a lost table.

    Attributes:
        design: X over rows; that of a lost table is the mean over its people.
        location_mean: prior mean of b.
        value: (log K, log C) of an estimate; (m_K, m_C) of a lost table, see `AveragesOfLognormals`.
        kept: 1, or 0 for a row that is held out.
        trial: of each row.
        roots: of each lost table, the cube roots of its variances of logs.
        people: of log K and of log C, X of each lost table's people less their mean.
        scatter: variance of X b over these people, at which the tables' sites are made.
        of_trial: 1 for each element of b that is an effect of a trial, else 0.
    """

    design: PopulationDesign
    location_mean: Float[Array, " location"]
    value: Float[Array, "row 2"]
    kept: Float[Array, " row"]
    trial: Int[Array, " row"]
    roots: Float[Array, "table 2"]
    people: tuple[Float[Array, "table person part"], ...]
    scatter: Float[Array, "table 2"]
    of_trial: Float[Array, " location"]


def common_effects(designs: Mapping[str, Design], priors: Priors) -> Effects:
    """One arrangement of b for all formulas, so that what is compiled for one serves every other.

    Each part is as wide as in the formula that needs most of it. A coefficient whose columns are zero keeps
    its prior and changes nothing else.
    """
    found = [effects_of(design, priors, ())[0] for design in designs.values()]
    names = dict.fromkeys(name for effects in found for name in effects.parts)
    parts: dict[str, slice] = {}
    chosen: list[tuple[Effects, int]] = []
    for response in RESPONSES:
        for name in (name for name in names if name.endswith(f"_{response}")):
            has = [effects for effects in found if name in effects.parts]
            widest = max(has, key=lambda effects: _width(effects.parts[name]))  # noqa: B023
            parts[name] = slice(len(chosen), len(chosen) + _width(widest.parts[name]))
            chosen += [(widest, place) for place in range(*widest.parts[name].indices(widest.size))]
    return Effects(
        parts,
        np.array([effects.mean[place] for effects, place in chosen]),
        np.array([effects.sd[place] for effects, place in chosen]),
        tuple(effects.spread[place] for effects, place in chosen),
    )


def _width(part: slice) -> int:
    return int(part.stop - part.start)


def estimates_data(
    design: Design, observations: PublishedObservations, model: EstimatesModel
) -> EstimatesData:
    """The observations and one formula's design, in the model's arrangement of b."""
    effects, matrices = effects_of(design, model.priors, ())
    whole = np.zeros((len(design.subject), model.locations.size))
    for name, part in effects.parts.items():
        begin = model.locations.parts[name].start
        column = np.concatenate(matrices, axis=1)[:, part]
        whole[:, begin : begin + column.shape[1]] = column
    end_of_K = max(part.stop for name, part in model.locations.parts.items() if name.endswith("_K"))
    columns = (whole[:, :end_of_K], whole[:, end_of_K:])
    cells, tables = observations.impact_cell, observations.averaged_cells
    rows = tuple(np.concatenate([part[cells], part[tables].mean(1)]) for part in columns)
    people = tuple(part[tables] - part[tables].mean(1, keepdims=True) for part in columns)
    of_trial = np.zeros(model.locations.size)
    for response in RESPONSES:
        if "trial" in design.responses[response].groups:
            of_trial[model.locations.parts[f"trial_effect_{response}"]] = 1
    return EstimatesData(
        PopulationDesign(rows, np.arange(len(rows[0]))),
        model.locations.mean,
        np.concatenate([observations.log_estimates, observations.averages[:, :2]]),
        np.ones(len(rows[0])),
        np.concatenate([design.trial[cells], design.trial[tables[:, 0]]]),
        observations.averages[:, 2:],
        people,
        np.zeros((len(tables), 2)),
        of_trial,
    )


def without_trial(data: EstimatesData, trial: int) -> EstimatesData:
    """The same with a trial's rows held out; they stay in place and say nothing."""
    return data._replace(kept=(np.asarray(data.trial) != trial).astype(float))


class Integrated(NamedTuple):
    """b integrated out, the hyperparameters given, a lost table's site in its factor's place.

    Attributes:
        log_density: of all rows.
        mean: of b given them.
        factor: lower Cholesky factor of b's precision.
    """

    log_density: Float[Array, ""]
    mean: Float[Array, " location"]
    factor: Float[Array, "location location"]


class Rows(NamedTuple):
    """Each row's density as a function of its v = X b: a constant and a normal of (centre - v)."""

    centre: Float[Array, "row 2"]
    covariance: PairCovariance
    constant: Float[Array, " row"]

    def log_density(self, about: Float[Array, "row 2"]) -> Float[Array, " row"]:
        """At v = ``about``."""
        return self.constant + pair_log_density(self.centre - about, self.covariance)


def _impact_factor(sites: Mapping[str, Array]) -> Float[Array, "2 2"]:
    sd_K, sd_C = sites["sd_impact_K"], sites["sd_impact_C"]
    return cholesky_factor(sd_K, sd_C, sites.get("residual_correlation", jnp.zeros_like(sd_K)))


def _rows(data: EstimatesData, sites: Mapping[str, Array], scatter: Float[Array, "table 2"]) -> Rows:
    """The estimates, and the lost tables with their people's expectations as far apart as ``scatter`` says."""
    factor, tables = _impact_factor(sites), len(data.roots)
    impacts = PairCovariance(factor[0, 0] ** 2, factor[0, 0] * factor[1, 0], (factor[1] ** 2).sum())
    estimates = len(data.value) - tables
    offset, sd, correlation = moments_of_people(
        jnp.zeros((tables, 2)), scatter, jnp.broadcast_to(factor, (tables, 2, 2)), data.people[0].shape[1]
    )
    means = pair_covariance(sd[:, :2], correlation[:, 0])
    roots = pair_log_density(data.roots - offset[:, 2:], pair_covariance(sd[:, 2:], correlation[:, 1]))
    covariance = jax.tree.map(
        lambda own, table: jnp.concatenate([jnp.broadcast_to(own, (estimates,)), table]), impacts, means
    )
    away = jnp.concatenate([jnp.zeros((estimates, 2)), offset[:, :2]])
    return Rows(data.value - away, covariance, jnp.concatenate([jnp.zeros(estimates), roots]))


def population(model: EstimatesModel, sites: dict[str, Array]) -> Covariances:
    """See `covariances_of`; a published mass is taken as exact."""
    return covariances_of(model.locations, sites, 0.0, ())


def integrated(model: EstimatesModel, data: EstimatesData, sites: dict[str, Array]) -> Integrated:
    """Integrate b out."""
    rows, sd = _rows(data, sites, data.scatter), population(model, sites).locations
    about = jnp.stack(expected(data.design, data.location_mean), axis=-1)
    precision = jax.tree.map(lambda entry: data.kept * entry, rows.covariance.inverse())
    weight = [[precision.KK, precision.KC], [precision.KC, precision.CC]]
    away = (rows.centre - about).T
    toward = [row[0] * away[0] + row[1] * away[1] for row in weight]
    factor = jnp.linalg.cholesky(information(data.design, weight) + jnp.diag(sd**-2.0))
    half = solve_triangular(factor, score(data.design, toward), lower=True)
    gained = (half**2).sum() / 2 - jnp.log(jnp.diagonal(factor)).sum() - jnp.log(sd).sum()
    shift = solve_triangular(factor, half, lower=True, trans=1)
    return Integrated(
        data.kept @ rows.log_density(about) + gained, data.location_mean + shift, factor
    )


class EffectsDraw(NamedTuple):
    """A draw of b, and what it says of the data.

    Attributes:
        b: the effects.
        scatter: variance of X b over each lost table's people.
        log_ratio: of the lost tables' factors over their sites, those held out left out.
        rows: log density of every row's data.
        trials: that of every trial's data together, its own effects integrated out, given all other effects.
    """

    b: Float[Array, " location"]
    scatter: Float[Array, "table 2"]
    log_ratio: Float[Array, ""]
    rows: Float[Array, " row"]
    trials: Float[Array, " trial"]


def draw_effects(
    model: EstimatesModel,
    data: EstimatesData,
    sites: dict[str, Array],
    standard: Float[Array, " location"],
    trials: int,
) -> EffectsDraw:
    """A draw of b from its conditional, by standard normals, and its densities.

    Args:
        model: the model.
        data: the rows.
        sites: the hyperparameters.
        standard: as many standard normals as b has elements.
        trials: how many trials there are.
    """
    found = integrated(model, data, sites)
    b = found.mean + solve_triangular(found.factor, standard, lower=True, trans=1)
    end = data.people[0].shape[-1]
    away = [part @ own for part, own in zip(data.people, (b[:end], b[end:]), strict=True)]
    scatter = jnp.stack([(each**2).sum(1) / (each.shape[1] - 1) for each in away], axis=-1)
    about = jnp.stack(expected(data.design, b), axis=-1)
    true, site = _rows(data, sites, scatter), _rows(data, sites, data.scatter)
    rows = true.log_density(about)
    shared = jnp.stack(expected(data.design, b * (1 - data.of_trial)), axis=-1)
    variance = _variance_of_trials(model, data, sites)
    return EffectsDraw(
        b,
        scatter,
        data.kept @ (rows - site.log_density(about)),
        rows,
        log_density_of_trials(true, shared, variance, data.trial, trials),
    )


def _variance_of_trials(
    model: EstimatesModel, data: EstimatesData, sites: dict[str, Array]
) -> Float[Array, " 2"]:
    """Of a trial's effect on log K and on log C; 0 where the formula has none."""
    values = []
    for response in RESPONSES:
        part = model.locations.parts.get(f"trial_effect_{response}")
        none = jnp.zeros(())
        values.append(none if part is None else sites[f"sd_trial_{response}"] ** 2 * data.of_trial[part.start])
    return jnp.stack(values)


def log_density_of_trials(
    rows: Rows,
    about: Float[Array, "row 2"],
    variance: Float[Array, " 2"],
    trial: Int[Array, " row"],
    trials: int,
) -> Float[Array, " trial"]:
    """Log density of all of a trial's rows together, an effect that they share integrated out.

    Of n rows of one covariance S about v + e, with e ~ N(0, T): their differences say nothing of e, and their
    mean is N(v, S / n + T).

    Args:
        rows: the rows, those of a trial with one covariance.
        about: v, without the trial's effect.
        variance: the diagonal of T.
        trial: of each row.
        trials: how many there are.
    """

    def total(values: Array) -> Array:
        return jax.ops.segment_sum(values, trial, trials)

    count = total(jnp.ones(len(trial)))
    away = rows.centre - about
    mean = total(away) / count[:, None]
    own = jax.tree.map(lambda entry: total(entry) / count, rows.covariance)
    of_mean = jax.tree.map(lambda entry: entry / count, own)
    moved = PairCovariance(of_mean.KK + variance[0], of_mean.KC, of_mean.CC + variance[1])
    return (
        total(rows.log_density(about))
        - pair_log_density(mean, of_mean)
        + pair_log_density(mean, moved)
    )


def marginal_model(model: EstimatesModel, data: EstimatesData, warp: SinhArcsinh) -> None:
    """The numpyro model of the hyperparameters alone, in the coordinates that ``warp`` is the map from."""
    sites, _ = sample_warped(model, warp)
    numpyro.factor("estimates", integrated(model, data, sites).log_density)


def sampled_model(model: EstimatesModel, data: EstimatesData, warp: SinhArcsinh, trials: int) -> None:
    """`plain_model` over standard normals, which `draw_effects` makes b of."""
    sites, _ = sample_warped(model, warp)
    normal = dist.Normal().expand([model.locations.size]).to_event(1)
    standard = numpyro.sample("standard_locations", normal)
    numpyro.factor("estimates", integrated(model, data, sites).log_density)
    numpyro.factor("tables", draw_effects(model, data, sites, standard, trials).log_ratio)


def plain_model(model: EstimatesModel, data: EstimatesData) -> None:
    """The model from the top down: hyperparameters, b, every estimate, and the averages of the lost tables."""
    sites = {name: numpyro.sample(name, model.prior_of(name)) for name in model.spreads}
    sd = population(model, sites).locations
    b = numpyro.sample("locations", dist.Normal(data.location_mean, sd).to_event(1))
    about = jnp.stack(expected(data.design, b), axis=-1)
    tables, factor, end = len(data.roots), _impact_factor(sites), data.people[0].shape[-1]
    estimates = len(data.value) - tables
    with numpyro.plate("impact", estimates):
        each = dist.MultivariateNormal(about[:estimates], scale_tril=factor)
        numpyro.sample("estimates", each.mask(data.kept[:estimates] > 0), obs=data.value[:estimates])
    people = jnp.stack([data.people[0] @ b[:end], data.people[1] @ b[end:]], axis=-1)
    with numpyro.plate("averaged_trial", tables):
        lost = AveragesOfLognormals(about[estimates:, None] + people, factor)
        events = jnp.concatenate([data.value[estimates:], data.roots], axis=-1)
        numpyro.sample("averages", lost.mask(data.kept[estimates:] > 0), obs=events)
