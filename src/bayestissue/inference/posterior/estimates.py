"""The posterior of the hierarchy over published estimates, by the recipe of traces.

The hyperparameters are sampled with everything linear integrated out and a Gaussian site in each lost table's
place; b is drawn from its conditional; and the draws are weighted by the tables' factors over their sites.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.estimates import (
    EffectsDraw,
    EstimatesData,
    EstimatesModel,
    draw_effects,
    marginal_model,
    sampled_model,
)
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.traces import COORDINATES, constrained
from bayestissue.hierarchy.warp import SinhArcsinh
from bayestissue.inference.execution.compiling import first_rows, in_calls
from bayestissue.inference.posterior.coordinates import Coordinates, straight, warp_about
from bayestissue.inference.posterior.mode import covariance_about, find_mode
from bayestissue.inference.posterior.recipe import PARETO_LIMIT, Correction, _resample
from bayestissue.inference.samplers.independence import (
    POINTS,
    Spreads,
    independence_chains,
    log_densities,
)
from bayestissue.inference.samplers.nuts import Start, run_chains
from bayestissue.inference.samplers.psis import pareto_smoothed
from bayestissue.inference.samplers.sampling import Draws, Progress, silent

# Of the coordinates, for slopes from differences of values.
_STEP = 1e-4
# The sites follow the mode, which then moves a little; and then, if need be, corrected draws, while less of
# the draws' worth is left.
_ABOUT_MODE, _MOST_AGAIN, _WELL_PLACED = 3, 2, 0.7


@dataclass(frozen=True)
class EstimatesPosterior:
    """Draws of everything, and how they came about.

    Attributes:
        draws: hyperparameters and effects by name, [chain, draw, ...].
        rows: log density of every row's data, [chain, draw, row].
        trials: that of every trial's, its own effect integrated out, [chain, draw, trial].
        correction: of the draws; None where nothing had to be corrected.
        scatter: where the tables' sites were made.
        coordinates: of the hyperparameters.
    """

    draws: Draws
    rows: Float[np.ndarray, "chain draw row"]
    trials: Float[np.ndarray, "chain draw trial"]
    correction: Correction | None
    scatter: Float[np.ndarray, "table 2"]
    coordinates: Coordinates


def sample_posterior(
    model: EstimatesModel,
    data: EstimatesData,
    trials: int,
    settings: Sampler,
    seed: int,
    *,
    near: EstimatesPosterior | None = None,
    progress: Progress = silent,
) -> EstimatesPosterior:
    """Draw from the posterior.

    Args:
        model: what is assumed.
        data: the rows.
        trials: how many trials there are.
        settings: how many chains and draws, and by which path.
        seed: of all of it.
        near: a posterior of the same formula with nothing held out, from which the search then begins.
        progress: told how many of the chains' transitions are done, where it takes long.
    """
    if near is None:
        data, coordinates = _approximated(model, data, trials, np.random.default_rng([seed, 24]))
    else:
        data, coordinates = data._replace(scatter=near.scatter), near.coordinates
    if settings.path != "exact":
        found = _corrected(model, data, trials, coordinates, settings, seed, progress)
        assert found.correction is not None  # noqa: S101 - it was corrected
        if settings.path == "summary" or found.correction.trusted:
            return found
    return _exact(model, data, trials, coordinates, settings, seed, progress)


def _corrected(
    model: EstimatesModel,
    data: EstimatesData,
    trials: int,
    coordinates: Coordinates,
    settings: Sampler,
    seed: int,
    progress: Progress,
) -> EstimatesPosterior:
    """Of sites made anew about corrected draws while too little of the draws' worth is left, the best."""
    made: list[EstimatesPosterior] = []
    for again in range(1 + _MOST_AGAIN):
        rng = np.random.default_rng([seed, 21, again])
        chains = _chains(model, data, coordinates, settings, seed + 1000003 * again, progress)
        shape = (settings.chains, settings.transitions)
        y = chains.sites[COORDINATES].reshape(-1, len(coordinates.names))
        z = rng.standard_normal((len(y), model.locations.size))
        drawn = _drawn(model, data, trials, coordinates.warp, y, z)
        smoothed, k = pareto_smoothed(drawn.log_ratio)
        weight = np.exp(smoothed)
        effective = weight.sum() ** 2 / np.square(weight).sum() / weight.size
        chosen = _resample(weight.reshape(shape), settings.draws, rng)
        drawn, correction = jax.tree.map(lambda v: v[chosen], drawn), Correction(k, float(effective))  # noqa: B023
        made.append(_labelled(model, data, coordinates, chains, y[chosen], drawn, settings, correction))
        if effective > _WELL_PLACED:
            break
        data = data._replace(scatter=drawn.scatter.mean(0))
    return max(made, key=_worth)


def _worth(found: EstimatesPosterior) -> tuple[bool, float]:
    assert found.correction is not None  # noqa: S101 - it was corrected
    return found.correction.trusted, found.correction.effective


def _exact(
    model: EstimatesModel,
    data: EstimatesData,
    trials: int,
    coordinates: Coordinates,
    settings: Sampler,
    seed: int,
    progress: Progress,
) -> EstimatesPosterior:
    """Chains of everything, on standard normals that the sites make effects of."""
    size = len(coordinates.names)
    centre = {COORDINATES: np.zeros(size), "standard_locations": np.zeros(model.locations.size)}
    start = Start(centre, (COORDINATES,), coordinates.covariance)
    chains = run_chains(
        _sampled_of(model, trials), (data, coordinates.warp), start, settings, seed, progress=progress
    ).thinned(settings.thinning)
    y, z = (chains.sites[name].reshape(-1, *np.shape(centre[name])) for name in centre)
    drawn = _drawn(model, data, trials, coordinates.warp, y, z)
    return _labelled(model, data, coordinates, chains, y, drawn, settings, None)


def _labelled(
    model: EstimatesModel,
    data: EstimatesData,
    coordinates: Coordinates,
    chains: Draws,
    y: Float[np.ndarray, "draw coordinate"],
    drawn: EffectsDraw,
    settings: Sampler,
    correction: Correction | None,
) -> EstimatesPosterior:
    """Draws by name and by chain."""
    shape = (settings.chains, settings.draws)
    sites = dict(constrained(model, coordinates.raw(y)))
    sites |= named_effects(model, drawn.b)
    by_chain = {name: np.asarray(v).reshape(*shape, *v.shape[1:]) for name, v in sites.items()}
    rows, each_trial = (v.reshape(*shape, -1) for v in (drawn.rows, drawn.trials))
    draws = replace(chains, sites=by_chain)
    return EstimatesPosterior(draws, rows, each_trial, correction, np.asarray(data.scatter), coordinates)


def named_effects(
    model: EstimatesModel, b: Float[np.ndarray, "*draw location"]
) -> dict[str, Float[np.ndarray, "*draw ..."]]:
    """The parts of b by name; intercepts and mass exponents are numbers."""
    parts = model.locations.parts
    numbers = ("intercept_", "mass_exponent_")
    return {
        name: b[..., part.start] if name.startswith(numbers) else b[..., part] for name, part in parts.items()
    }


def _chains(
    model: EstimatesModel,
    data: EstimatesData,
    coordinates: Coordinates,
    settings: Sampler,
    seed: int,
    progress: Progress,
) -> Draws:
    """The hyperparameters: independent proposals where they serve, else trajectories."""
    middle = {COORDINATES: np.zeros(len(coordinates.names))}
    target, own = (data, coordinates.warp), _marginal_of(model)
    found = independence_chains(own, target, Spreads(middle, coordinates.covariance), settings, seed)
    if found.pareto_k < PARETO_LIMIT:
        return found.draws
    start = Start(middle, (COORDINATES,), coordinates.covariance)
    return run_chains(own, target, start, settings, seed, progress=progress, processes=False)


def _drawn(
    model: EstimatesModel,
    data: EstimatesData,
    trials: int,
    warp: SinhArcsinh,
    y: Float[np.ndarray, "draw coordinate"],
    z: Float[np.ndarray, "draw location"],
) -> EffectsDraw:
    """Effects for every draw of the coordinates, as numpy arrays."""
    return EffectsDraw(*in_calls(partial(_draw_rows, model, trials, data, warp), (y, z), POINTS))


@partial(jax.jit, static_argnums=(0, 1))
def _draw_rows(
    model: EstimatesModel,
    trials: int,
    data: EstimatesData,
    warp: SinhArcsinh,
    y: Array,
    z: Array,
    number: Array,
) -> EffectsDraw:
    def one(place: Array) -> EffectsDraw:
        sites = constrained(model, dict(zip(model.spreads, warp(y[place]), strict=True)))
        return draw_effects(model, data, sites, z[place], trials)

    return EffectsDraw(*first_rows(lambda place: tuple(one(place)), POINTS, number))


class _Finder(NamedTuple):
    """The marginal density of the hyperparameters' coordinates, and its slope from differences."""

    model: EstimatesModel
    data: EstimatesData

    def densities(self, y: np.ndarray, warp: SinhArcsinh | None = None) -> np.ndarray:
        layout = ((COORDINATES, y.shape[1:]),)
        arguments = (self.data, warp or straight(y.shape[1]))
        return log_densities(_marginal_of(self.model), arguments, layout, y)

    def at(self, y: np.ndarray, warp: SinhArcsinh | None = None) -> tuple[float, np.ndarray]:
        """Minus the log density, and the slope of that."""
        steps = _STEP * np.eye(len(y))
        value, *others = -self.densities(np.concatenate([y[None], y + steps, y - steps]), warp)
        ahead, behind = np.reshape(others, (2, -1))
        return float(value), (ahead - behind) / (2 * _STEP)


def _approximated(
    model: EstimatesModel, data: EstimatesData, trials: int, rng: np.random.Generator
) -> tuple[EstimatesData, Coordinates]:
    """Sites of the lost tables about the posterior mode of the hyperparameters, and coordinates there."""
    names, mode = model.spreads, None
    z = rng.standard_normal((POINTS, model.locations.size))
    for _ in range(_ABOUT_MODE):
        mode = find_mode(model, names, _Finder(model, data).at, mode)
        drawn = _drawn(model, data, trials, straight(len(names)), np.repeat(mode[None], len(z), axis=0), z)
        data = data._replace(scatter=drawn.scatter.mean(0))
    finder = _Finder(model, data)
    scale = np.sqrt(np.diagonal(covariance_about(lambda y: finder.at(y)[1], mode)))
    warp = warp_about(lambda y: float(finder.densities(y[None])[0]), mode, scale)
    about = covariance_about(lambda y: finder.at(y, warp)[1], np.zeros(len(names)))
    return data, Coordinates(names, warp, about)


@lru_cache(maxsize=8)
def _marginal_of(model: EstimatesModel) -> Callable[..., None]:
    """The same function each time, so that what is compiled for it serves again."""
    return partial(marginal_model, model)


@lru_cache(maxsize=8)
def _sampled_of(model: EstimatesModel, trials: int) -> Callable[..., Any]:
    """The same of `sampled_model`."""
    return partial(_sampled, model, trials)


def _sampled(model: EstimatesModel, trials: int, data: EstimatesData, warp: SinhArcsinh) -> None:
    sampled_model(model, data, warp, trials)
