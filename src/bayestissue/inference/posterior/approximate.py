"""What a fit of traces needs before its chains: first guesses, sites, the hyperparameters' posterior mode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
from jax import Array
from jaxtyping import Float
from numpyro.infer.util import potential_energy

from bayestissue.elements import element
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.hierarchy.gaussian.conditional import Data, log_marginal
from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import (
    COORDINATES,
    TraceData,
    TraceModel,
    constrained,
    gaussian,
    population,
    sample_warped,
    with_normal_errors,
)
from bayestissue.hierarchy.warp import SinhArcsinh
from bayestissue.inference.execution.chunks import Progress, map_impacts, silent
from bayestissue.inference.execution.compiling import compiled_quickly
from bayestissue.inference.factors.conditional import (
    ConditionalPrior,
    of_cells,
    population_draws,
    standard_points,
)
from bayestissue.inference.factors.grid import (
    BLOCK,
    PLACES,
    GridSum,
    LikelihoodGrid,
    grid_sum_around,
    integrated_likelihood_grid,
    without_last,
)
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.factors.sites import laplace_sites, weak_prior
from bayestissue.inference.points.fit import PointFit, fit_points
from bayestissue.inference.samplers.coordinates import (
    Coordinates,
    coordinates_about,
    covariance_about,
    find_mode,
    unwarped,
)
from bayestissue.padding import bucket, padded_zeros
from bayestissue.signal import Displacements

# A grid integrates the other parameters over so many points: few where impacts are many.
PROFILE_POINTS, FEW = 32, 4
# Points of all impacts together that a grid is integrated over.
_GRID_POINTS = 160_000
LAST = "standard_last"
# Of artanh theta1 or a log, the standard deviation up to which its likelihood passes for a normal.
_WELL_TOLD = 0.3
# Steps of that log; where a likelihood is a normal so narrow, it is lower there by 50.
_FAR, _CLEARLY_LESS = np.array([0.0, -3.0, 3.0]), 10.0
_NEAREST = 0.99


def marginal_model(
    model: TraceModel, data: Data, grid: LikelihoodGrid | GridSum | None, warp: SinhArcsinh
) -> None:
    """The numpyro model of the standard deviations alone, everything else integrated out.

    With a grid of the last parameter, its mean is sampled too, since only a normal integrates in closed
    form. That mean is the last element of b, and so depends on the last standard normal alone, which is the
    last of the coordinates that ``warp`` is the map from.
    """
    sites, last = sample_warped(model, warp)
    covariances = population(model, sites)
    numpyro.factor("sites", log_marginal(data, covariances))
    if grid is not None:
        (z,) = last
        # The sites are cleared of the last parameter, and leave its mean as its prior has it.
        mean = data.mean[-1] + covariances.locations[-1] * z
        numpyro.factor("grid", grid.total(mean, covariances.nuisance[-1]) - z**2 / 2)


def first_guess(prepared: Prepared) -> Float[np.ndarray, "impact parameter"]:
    """Each impact's parameters: K and C from its point estimate, or of decelerations from its motion.

    Where these give no K it is from the time to peak, and where they give no C that of light damping.
    """
    signal, which = prepared.signal, element(prepared.model.element)
    if prepared.model.kind == "impact":
        (K, C), fit = _of_motion(signal), None
    else:
        centred = signal.equilibrium.any()
        gravity = None if centred else signal.gravity
        fit = fit_points(signal.x, signal.n_samples, signal.dt, signal.mass, gravity=gravity)
        K, C = fit.K, fit.C
    stiffness = np.where(np.isfinite(K) & (K > 0), K, signal.mass * (np.pi / 2 / signal.time_to_peak) ** 2)
    lightly = 0.1 * np.sqrt(stiffness * signal.mass)
    damping = np.where(np.isfinite(C) & (0.02 * lightly < C), C, lightly)
    guess = which.guess(jnp.asarray(stiffness), jnp.asarray(damping), jnp.asarray(signal.mass))
    columns = [*(np.log(np.asarray(values)) for values in guess), _noise(prepared, fit)]
    columns += [np.full(len(stiffness), np.log(parameter.typical)) for parameter in which.extra]
    columns += [np.full(len(stiffness), prepared.model.priors.discrepancy.mean)] * prepared.model.discrepancy
    correlation = prepared.model.priors.atanh_noise_correlation.mean
    columns += [np.full(len(stiffness), correlation)] * prepared.model.autoregressive
    if fit is not None and prepared.model.kind == "arma":
        # artanh has no value at -1 and 1, where point estimates like to lie.
        columns.append(np.arctanh(np.clip(fit.theta1, -_NEAREST, _NEAREST)))
    return np.stack(columns, axis=1)


def _of_motion(signal: Displacements) -> Float[np.ndarray, "2 impact"]:
    """K and C by least squares of M d on penetration and velocity, as integrated from d."""
    # Since contact: where x is measured from elsewhere, that is no part of the force.
    moved = np.stack([signal.x + signal.equilibrium[:, None], signal.v], axis=-1)
    inside = (np.arange(moved.shape[1]) < signal.n_samples[:, None]) & (signal.clipped == 0)
    moved = np.where(inside[..., None], moved, 0.0)
    squares = np.einsum("isa,isb->iab", moved, moved)
    products = np.einsum("isa,is->ia", moved, signal.mass[:, None] * signal.deceleration)
    return (np.linalg.pinv(squares, hermitian=True) @ products[..., None])[..., 0].T


def _noise(prepared: Prepared, fit: PointFit | None) -> np.ndarray:
    log_peak = np.asarray(prepared.data.log_peak)
    if fit is None:
        return np.log(np.maximum(prepared.signal.noise_sd, 1e-12)) - log_peak
    spectral = np.sqrt(1 + fit.theta1**2) if prepared.model.kind == "arma" else 1.0
    return np.log(np.maximum(fit.sigma_a, 1e-300) * spectral) - log_peak


@dataclass(frozen=True)
class Approximation:
    """All that the sampler needs to know of the traces beforehand.

    Attributes:
        sites: of the traces.
        coordinates: of the hyperparameters, and behind them, where there is a grid, of the last location's
            standard normal: traces whose theta1 is at -1 leave it a wall on one side and nothing but its
            prior on the other.
        grid: what the traces say of a last parameter that they leave open; see `TraceModel.may_have_grid`.
        marginal_grid: the same as the marginal density asks for it: of many impacts tabulated together.
        second_order: of what the sites leave out, where that is part of the marginal density.
        expansions: of every likelihood at its own maximum, see `expanded`.
    """

    sites: GaussianFactor
    coordinates: Coordinates
    grid: LikelihoodGrid | None
    marginal_grid: LikelihoodGrid | GridSum | None = None
    second_order: GaussianFactor | None = None
    expansions: GaussianFactor | None = None

    @classmethod
    def of_sites(cls, sites: GaussianFactor) -> Approximation:
        """Of sites alone: what scores ask, which need no coordinates."""
        return cls(sites, coordinates=None, grid=None)  # type: ignore[arg-type]

    def data(self, data: TraceData) -> Data:
        """What the marginal density asks of the dataset."""
        return replace(gaussian(data, self.sites), second_order=self.second_order)

    def density(self, prepared: Prepared) -> MarginalDensity:
        """The marginal density of the hyperparameters."""
        return MarginalDensity(prepared.model, self.data(prepared.data), self.marginal_grid)

    def near(self, prepared: Prepared, values: Mapping[str, Any]) -> Approximation:
        """With coordinates about the mode of its own density, sought from these values on.

        Raises:
            FloatingPointError: the density has no mode.
        """
        density = self.density(prepared)
        start = np.array([values.get(name, 0.0) for name in density.names])
        if density.grid is not None:
            start = density.at_best_last(start)
        return replace(self, coordinates=density.coordinates(density.mode(start)))

    def of_rows(self, rows: np.ndarray) -> tuple[GaussianFactor, LikelihoodGrid | None]:
        """Some impacts' sites, and their grid of the last parameter if there is one."""
        sites, grid = rows_of(self.sites, rows), self.grid
        if grid is not None:
            grid = LikelihoodGrid(jnp.asarray(np.asarray(grid.log_likelihood)[:, rows]))
        return sites, grid


# Of the last location's standard normal, at which its density is looked at.
_PLACES = np.linspace(-8.0, 8.0, 321)


@compiled_quickly
def _value_and_slope(
    model: TraceModel,
    y: Array,
    data: Data,
    grid: LikelihoodGrid | GridSum | None,
    warp: SinhArcsinh,
) -> tuple[Array, Array]:
    """Minus the log density of the hyperparameters' coordinates, and its gradient."""
    numpyro_model = partial(marginal_model, model)

    def potential(y: Array) -> Array:
        return potential_energy(numpyro_model, (data, grid, warp), {}, {COORDINATES: y})

    return jax.value_and_grad(potential)(y)


@dataclass(frozen=True)
class MarginalDensity:
    """The posterior of the hyperparameters given the sites, b and every impact's parameters integrated out.

    Attributes:
        model: whose hyperparameters they are.
        data: with the sites.
        grid: of the last parameter, whose mean is then a coordinate too.
    """

    model: TraceModel
    data: Data
    grid: LikelihoodGrid | GridSum | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coordinates: the hyperparameters, and with a grid the last location's standard normal."""
        return self.model.hyperparameters + (LAST,) * (self.grid is not None)

    def potential(self, y: np.ndarray, warp: SinhArcsinh | None = None) -> tuple[float, np.ndarray]:
        """Minus the log density at coordinates ``y``, and its gradient."""
        value, slope = _value_and_slope(self.model, y, self.data, self.grid, warp or unwarped(len(y)))
        return float(value), np.asarray(slope)

    def mode(self, start: np.ndarray | None = None) -> np.ndarray:
        """Where the density of the unwarped coordinates is greatest."""
        return find_mode(self.model, self.names, self.potential, start)

    def coordinates(self, mode: np.ndarray) -> Coordinates:
        """Coordinates in which the posterior is nearly normal."""
        return coordinates_about(self.names, self.potential, mode)

    def with_sites(self, data: TraceData, sites: GaussianFactor) -> MarginalDensity:
        """The same given other sites."""
        return replace(self, data=gaussian(data, sites))

    def with_grid(self, grid: LikelihoodGrid, mode: np.ndarray) -> MarginalDensity:
        """With the last parameter's grid; that of many impacts as one table about the mode."""
        if grid.log_likelihood.shape[1] <= BLOCK:
            # An impact of zeros adds nothing.
            return replace(self, grid=padded_zeros(grid, -1))
        sd = population(self.model, self._hyperparameters(mode)).nuisance[-1]
        start = np.array([self.last_mean(mode), np.log(float(sd))])
        return replace(self, grid=grid_sum_around(grid, partial(self._of_last, mode), start))

    def _of_last(self, start: np.ndarray, grid: GridSum) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mode and standard deviations of the last parameter's mean and log spread, by a grid."""
        density = replace(self, grid=grid)
        mode = density.mode(start)
        error = np.sqrt(np.diagonal(covariance_about(lambda y: density.potential(y)[1], mode)))
        last = self.model.hyperparameters[-1]
        log_sd = np.log(float(density._hyperparameters(mode)[last]))
        # A standard deviation's unconstrained coordinate is nearly its log.
        scale = np.array([self.model.locations.sd[-1], 1.0])
        of_last = [density.names.index(LAST), density.names.index(last)]
        return np.array([density.last_mean(mode), log_sd]), scale * error[of_last]

    def _hyperparameters(self, y: np.ndarray) -> dict[str, Array]:
        return constrained(self.model, dict(zip(self.names, y, strict=True)))

    def at_best_last(self, y: np.ndarray) -> np.ndarray:
        """The same point where the last location's standard normal is most likely."""
        points = np.repeat(y[None], len(_PLACES), axis=0)
        points[:, -1] = _PLACES
        return points[np.argmin([self.potential(point)[0] for point in points])]

    def last_mean(self, y: np.ndarray) -> float:
        """The mean of the last parameter there."""
        return float(self.data.mean[-1] + self.model.locations.sd[-1] * y[-1])

    def conditional_prior(self, y: np.ndarray, design: PopulationDesign) -> ConditionalPrior:
        """Of each impact there, b having its conditional mean."""
        raw, at_mean = np.reshape(y, (-1, 1)), np.zeros((1, self.model.locations.size))
        draws = population_draws(self.model, self.data, dict(zip(self.names, raw, strict=True)), at_mean)
        of_impacts = of_cells(draws.priors(design), np.asarray(design.cell))
        return ConditionalPrior(of_impacts.mean[0], draws.precision[0])


def rows_of(sites: GaussianFactor, rows: np.ndarray) -> GaussianFactor:
    """Some impacts' sites."""
    return GaussianFactor(*(np.asarray(leaf)[rows] for leaf in sites))


def expanded(prepared: Prepared, progress: Progress = silent) -> GaussianFactor:
    """Every likelihood expanded at its own maximum: what `approximate` begins with."""
    start = first_guess(prepared)
    # A uniform error leaves its likelihood flat on top, which no expansion can describe.
    smooth = with_normal_errors(prepared.data)
    return laplace_of_all(prepared.model, smooth, start, weak_prior(start), progress)


def laplace_of_all(
    model: TraceModel, smooth: TraceData, start: np.ndarray, prior: ConditionalPrior, progress: Progress
) -> GaussianFactor:
    """`laplace_sites` of all impacts, block by block; errors of the traces are to be normal."""
    return map_impacts(partial(laplace_sites, model), smooth, start, prior.of_each(), progress=progress)


def _grid(
    model: TraceModel,
    data: TraceData,
    sites: GaussianFactor,
    prior: ConditionalPrior,
    progress: Progress,
    *,
    coarse: bool = False,
) -> LikelihoodGrid:
    """The last parameter's grid, integrated over the fewer points the more impacts there are."""
    most = PROFILE_POINTS if model.kind == "arma" else PROFILE_POINTS // 2
    number = int(np.clip(2 ** np.floor(np.log2(_GRID_POINTS / len(sites.centre))), FEW, most))
    points = standard_points(sites.centre.shape[1], number)

    def one(part: TraceData, part_sites: GaussianFactor, part_prior: ConditionalPrior) -> np.ndarray:
        grid = integrated_likelihood_grid(model, part, part_sites, part_prior, points, coarse=coarse)
        return np.asarray(grid.log_likelihood).T

    table = map_impacts(one, data, sites, prior.of_each(), progress=progress)
    return LikelihoodGrid(jnp.asarray(np.ascontiguousarray(table.T)))


def approximate(
    prepared: Prepared,
    *,
    expansions: GaussianFactor | None = None,
    normal: bool | None = None,
    progress: Progress = silent,
) -> Approximation:
    """Laplace sites of the traces, each made where the whole data set says that its parameters are.

    First every likelihood is expanded at its own maximum, then at the maximum under the population that
    this implies, which matters where a trace says little. A weakly identified last parameter then has a grid.

    Args:
        prepared: model and data.
        expansions: what `expanded` found, if it was asked before.
        normal: whether a last parameter that traces may leave open is part of the normal sites, or has a
            grid of its own; as the traces suggest, unless given. A grid whose points can't resolve the
            likelihood gives way to normals in any case.
        progress: told how many of these passes are done, and of how many.
    """
    model, data = prepared.model, prepared.data
    passes = 2 + model.may_have_grid

    def report(number: int) -> Progress:
        return lambda done, total: progress(number * total + done, passes * total)

    expansions = expansions or expanded(prepared, report(0))
    impacts = len(expansions.centre)
    progress(1, passes)
    # One flat grid stands for those of however many impacts.
    columns = bucket(impacts) if impacts <= BLOCK else 1
    flat = LikelihoodGrid(jnp.zeros((len(PLACES), columns))) if model.may_have_grid else None
    density = MarginalDensity(model, gaussian(data, expansions), flat)
    mode = density.mode()
    prior = density.conditional_prior(mode, data.design)
    sites = laplace_of_all(model, with_normal_errors(data), expansions.centre, prior, report(1))
    density = density.with_sites(data, sites)
    mode = density.mode(mode)
    if model.may_have_grid and not (last_is_normal(prepared, sites) if normal is None else normal):
        grid, others, peak, of_grid = _fitted_grid(
            prepared, density, without_last(sites), mode, report(passes - 1)
        )
        if grid.resolved:
            coordinates = of_grid.coordinates(peak)
            return Approximation(others, coordinates, grid, of_grid.grid, expansions=expansions)
    coordinates = replace(density, grid=None).coordinates(mode[:-1] if model.may_have_grid else mode)
    return Approximation(sites, coordinates, None, expansions=expansions)


def _fitted_grid(
    prepared: Prepared, density: MarginalDensity, sites: GaussianFactor, mode: np.ndarray, progress: Progress
) -> tuple[LikelihoodGrid, GaussianFactor, np.ndarray, MarginalDensity]:
    """The last parameter's grid, the sites of the others, and the mode and the density that both give."""
    model, data = prepared.model, prepared.data
    one_pass = model.kind == "arma"
    density = density.with_sites(data, sites)
    grid = _grid(
        model, data, sites, density.conditional_prior(mode, data.design), progress, coarse=not one_pass
    )
    density = density.with_grid(grid, mode)
    # A search that begins where the grids fall steeply would end far from their maximum.
    mode = density.mode(density.at_best_last(mode))
    if one_pass:
        return grid, sites, mode, density
    # The first sites were made where a search along the last parameter had stopped.
    prior = density.conditional_prior(mode, data.design).with_last_at(density.last_mean(mode))
    sites = without_last(laplace_of_all(model, with_normal_errors(data), prior.mean, prior, silent))
    density = density.with_sites(data, sites)
    grid = _grid(model, data, sites, density.conditional_prior(mode, data.design), silent)
    if grid.resolved:
        density = density.with_grid(grid, mode)
        mode = density.mode(mode)
    return grid, sites, mode, density


def last_is_normal(prepared: Prepared, sites: GaussianFactor) -> bool:
    """Whether the traces tell the last parameter well enough for its likelihood to be normal.

    N samples tell theta1 to ((1 - theta1^2) / N)^1/2, and so artanh theta1 to cosh(artanh theta1) / N^1/2;
    an element's further parameter as well as the sites say, unless the likelihood has another end.
    """
    if prepared.model.kind != "arma":
        covariance = np.linalg.inv(sites.precision)
        narrow = np.sqrt(np.median(covariance[:, -1, -1])) < _WELL_TOLD
        return bool(narrow) and not _has_another_end(prepared, sites)
    middle = np.median(sites.centre[:, -1])
    return bool(np.cosh(middle) / np.sqrt(np.median(prepared.signal.n_samples)) < _WELL_TOLD)


def _has_another_end(prepared: Prepared, sites: GaussianFactor) -> bool:
    """Whether far from the sites' centres, along the last parameter, traces are nearly as likely.

    A search may have stopped on a shelf, from which the likelihood rises slowly to where it is level.
    """
    centre = sites.centre
    last = np.arange(centre.shape[1]) == centre.shape[1] - 1

    def densities(part: TraceData, middle: np.ndarray) -> np.ndarray:
        return log_likelihoods(prepared.model, part, middle + _FAR[:, None, None] * last).T

    here, *there = map_impacts(densities, prepared.data, centre).T
    lost = np.median(here - np.asarray(there), axis=1)
    return bool((lost < _CLEARLY_LESS).any())
