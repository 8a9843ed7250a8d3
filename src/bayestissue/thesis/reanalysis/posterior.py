"""The posterior of the hierarchy over published estimates, by the recipe of traces.

The hyperparameters are sampled with everything linear integrated out and a Gaussian site in each lost table's
place; b is drawn from its conditional; and the draws are weighted by the tables' factors over their sites.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.traces import COORDINATES, constrained
from bayestissue.hierarchy.warp import SinhArcsinh
from bayestissue.inference.execution.chunks import Progress, silent
from bayestissue.inference.execution.compiling import by_row
from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.samplers.coordinates import (
    Coordinates,
    coordinates_about,
    find_mode,
    unwarped,
)
from bayestissue.inference.samplers.independence import POINTS, independence_chains, log_densities
from bayestissue.inference.samplers.nuts import Start, run_chains
from bayestissue.inference.samplers.psis import k_threshold, systematic
from bayestissue.inference.samplers.sampling import Draws
from bayestissue.thesis.reanalysis.model import (
    EffectsDraw,
    EstimatesData,
    EstimatesModel,
    draw_effects,
    leave_one_out,
    marginal_model,
    sampled_model,
)

# Of the coordinates, for slopes from differences of values.
_STEP = 1e-4
# The sites follow the mode, which then moves a little.
_ABOUT_MODE = 3


class Chains(NamedTuple):
    """Draws of the hyperparameters, and of the effects given each, not corrected.

    Attributes:
        raw: the hyperparameters, unconstrained, along a first axis of all chains' draws.
        drawn: the effects, with the densities.
        sampled: the chains.
    """

    raw: Float[np.ndarray, "draw hyperparameter"]
    drawn: EffectsDraw
    sampled: Draws


@dataclass(frozen=True)
class EstimatesPosterior:
    """Draws of everything, and how they came about.

    Attributes:
        draws: the hyperparameters by name, [chain, draw].
        b: the effects.
        rows: log density of every row's data.
        correction: of the draws; None where nothing had to be corrected.
        data: with the place at which the tables' sites were made.
        coordinates: of the hyperparameters.
        chains: that the draws are chosen from.
    """

    draws: Draws
    b: Float[np.ndarray, "chain draw location"]
    rows: Float[np.ndarray, "chain draw row"]
    correction: Correction | None
    data: EstimatesData
    coordinates: Coordinates
    chains: Chains


def sample_posterior(
    model: EstimatesModel, data: EstimatesData, settings: Sampler, seed: int, progress: Progress = silent
) -> EstimatesPosterior:
    """Draw from the posterior.

    Args:
        model: what is assumed.
        data: the rows.
        settings: how many chains and draws, and by which path.
        seed: of all of it.
        progress: told how many of the chains' transitions are done, where it takes long.
    """
    data, coordinates = approximated(model, data, seed)
    if settings.path != "exact":
        chains = sample_chains(model, data, coordinates, settings, seed, progress)
        ratios = chains.drawn.log_ratio.reshape(settings.chains, settings.transitions)
        correction = Correction.from_log_weights(ratios, settings.chains * settings.draws)
        if settings.path == "summary" or correction.trusted:
            chosen = systematic(correction.weight, settings.draws, np.random.default_rng([seed, 22]))
            return _labelled(model, data, coordinates, chains, chosen, correction)
    chains = _exact(model, data, coordinates, settings, seed, progress)
    all_draws = np.tile(np.arange(settings.draws), (settings.chains, 1))
    return _labelled(model, data, coordinates, chains, all_draws, None)


def sample_chains(
    model: EstimatesModel,
    data: EstimatesData,
    coordinates: Coordinates,
    settings: Sampler,
    seed: int,
    progress: Progress = silent,
) -> Chains:
    """Chains of the hyperparameters, and effects given each.

    By independent proposals: in coordinates that may have been made for other data, or else in the data's
    own; trajectories where both miss part of the posterior.
    """
    for proposal in (lambda: coordinates, lambda: own_coordinates(model, data)):
        proposed = proposal()
        target = (model, data, proposed.warp)
        chains = independence_chains(marginal_model, target, COORDINATES, proposed.covariance, settings, seed)
        sampled = chains.draws
        if chains.pareto_k < k_threshold(settings.chains * settings.transitions):
            break
    else:
        start = Start({COORDINATES: np.zeros(len(proposed.names))}, COORDINATES, proposed.covariance)
        target = (model, data, proposed.warp)
        sampled = run_chains(
            marginal_model, target, start, settings, seed, progress=progress, processes=False
        )
    y = sampled.sites[COORDINATES].reshape(-1, len(proposed.names))
    z = np.random.default_rng([seed, 21]).standard_normal((len(y), model.locations.size))
    raw = np.asarray(proposed.warp(y))
    return Chains(raw, draw_all(model, data, raw, z), sampled)


def _exact(
    model: EstimatesModel,
    data: EstimatesData,
    coordinates: Coordinates,
    settings: Sampler,
    seed: int,
    progress: Progress,
) -> Chains:
    """Chains of everything, on standard normals that the sites make effects of."""
    size = len(coordinates.names)
    centre = {COORDINATES: np.zeros(size), "standard_locations": np.zeros(model.locations.size)}
    start = Start(centre, COORDINATES, coordinates.covariance)
    arguments = (model, data, coordinates.warp)
    sampled = run_chains(sampled_model, arguments, start, settings, seed, progress=progress)
    sampled = sampled.thinned(settings.thinning)
    y, z = (sampled.sites[name].reshape(-1, *np.shape(centre[name])) for name in centre)
    raw = np.asarray(coordinates.warp(y))
    return Chains(raw, draw_all(model, data, raw, z), sampled)


def _labelled(
    model: EstimatesModel,
    data: EstimatesData,
    coordinates: Coordinates,
    chains: Chains,
    chosen: Int[np.ndarray, "chain draw"],
    correction: Correction | None,
) -> EstimatesPosterior:
    """Chosen draws of each chain."""
    length = len(chains.raw) // len(chosen)
    places = chosen + length * np.arange(len(chosen))[:, None]
    sites = constrained(model, dict(zip(model.hyperparameters, chains.raw[places].T, strict=True)))
    draws = replace(chains.sampled, sites={name: np.asarray(v).T for name, v in sites.items()})
    b, rows = chains.drawn.b[places], chains.drawn.rows[places]
    return EstimatesPosterior(draws, b, rows, correction, data, coordinates, chains)


@by_row(POINTS, constant=2)
def draw_all(
    model: EstimatesModel,
    data: EstimatesData,
    raw: Float[Array, " hyperparameter"],
    z: Float[Array, " location"],
) -> EffectsDraw:
    """Effects for every draw of the unconstrained hyperparameters, as numpy arrays."""
    sites = constrained(model, dict(zip(model.hyperparameters, raw, strict=True)))
    return draw_effects(model, data, sites, z)


def leave_one_out_densities(
    model: EstimatesModel, posterior: EstimatesPosterior
) -> Float[np.ndarray, "chain draw row"]:
    """Log density of every row given all others, for each draw; see `leave_one_out`."""
    shape = next(iter(posterior.draws.sites.values())).shape
    flat = {name: values.ravel() for name, values in posterior.draws.sites.items()}
    return _left_out(model, posterior.data, flat).reshape(*shape, -1)


_left_out = by_row(POINTS, constant=2)(leave_one_out)


class _Finder(NamedTuple):
    """The marginal density of the hyperparameters' coordinates, and its slope from differences."""

    model: EstimatesModel
    data: EstimatesData

    def densities(self, y: np.ndarray, warp: SinhArcsinh | None = None) -> np.ndarray:
        arguments = (self.model, self.data, warp or unwarped(y.shape[1]))
        return log_densities(marginal_model, arguments, COORDINATES, y)

    def at(self, y: np.ndarray, warp: SinhArcsinh | None = None) -> tuple[float, np.ndarray]:
        """Minus the log density, and the slope of that."""
        steps = _STEP * np.eye(len(y))
        value, *others = -self.densities(np.concatenate([y[None], y + steps, y - steps]), warp)
        ahead, behind = np.reshape(others, (2, -1))
        return float(value), (ahead - behind) / (2 * _STEP)


def approximated(model: EstimatesModel, data: EstimatesData, seed: int) -> tuple[EstimatesData, Coordinates]:
    """Sites of the lost tables about the posterior mode of the hyperparameters, and coordinates there."""
    mode = None
    z = np.random.default_rng([seed, 24]).standard_normal((POINTS, model.locations.size))
    for _ in range(_ABOUT_MODE):
        mode = find_mode(model, model.hyperparameters, _Finder(model, data).at, mode)
        drawn = draw_all(model, data, np.repeat(mode[None], len(z), axis=0), z)
        data = data._replace(scatter=drawn.scatter.mean(0))
    return data, own_coordinates(model, data, mode)


def own_coordinates(
    model: EstimatesModel, data: EstimatesData, near: Float[np.ndarray, " hyperparameter"] | None = None
) -> Coordinates:
    """Coordinates about the posterior mode, which is sought from ``near`` on."""
    finder = _Finder(model, data)
    mode = find_mode(model, model.hyperparameters, finder.at, near)
    return coordinates_about(model.hyperparameters, finder.at, mode, finder.densities)
