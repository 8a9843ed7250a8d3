"""What a fit of many impacts needs before its chains; `trace_start` for fewer.

The same steps with the same results up to rounding, but block by block over the impacts, and with the people
eliminated one by one from the hierarchy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array
from numpyro.infer.util import potential_energy
from scipy.optimize import minimize

from bayestissue.hierarchy.cells import (
    Arrangement,
    Cells,
    Expansion,
    arrange,
    expected_by_place,
    in_cells,
    locations_of,
    solve,
)
from bayestissue.hierarchy.conditional import Summaries, impact_parts
from bayestissue.hierarchy.population import Spread
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, constrained, population, sample_spreads
from bayestissue.inference.many_correction import PopulationDraws, expand, rows_of
from bayestissue.inference.profile_surface import Surface, surface_around
from bayestissue.inference.sampling import Progress, silent
from bayestissue.inference.trace_blocks import in_blocks
from bayestissue.inference.trace_correction import (
    Profile,
    cleared_of_last,
    compare_about,
    flat_profile,
    profile_about,
    refine_about,
    standard_points,
)
from bayestissue.inference.trace_start import FEW, REFINEMENTS, Spreads, first_guess
from bayestissue.inference.trace_summaries import Anchor, loose_anchor, summarise_traces

# Steps from the point estimates, and from where those ended.
ITERATIONS = (30, 15)
EXPANSIONS = 2
_STEP = 1e-4


@dataclass(frozen=True)
class ManySummarised:
    """All that the sampler needs to know of the traces beforehand.

    Attributes:
        summaries: of the traces.
        cells: the same, laid out for the population, with what they leave out expanded.
        spreads: their posterior mode and covariance.
        profile: what the traces say of theta1, where the model leaves it free.
        surface: what that says of the population.
    """

    summaries: Summaries
    cells: Cells
    spreads: Spreads
    profile: Profile | None
    surface: Surface | None


def cells_model(model: TraceModel, cells: Cells, surface: Surface | None = None) -> None:
    """The numpyro model of the standard deviations, everything else integrated out; `spreads_model`."""
    spread = population(model, sample_spreads(model))
    numpyro.factor("summaries", solve(cells, spread)[0].log_evidence)
    if surface is not None:
        z = numpyro.sample("standard_last", dist.Normal())
        mean = cells.mean[-1] + z * spread.locations[-1]
        numpyro.factor("profile", surface.at(mean, jnp.log(spread.nuisance[-1])))


def summarise_many(prepared: Prepared, *, say: Progress = silent) -> ManySummarised:
    """Summaries of the traces and of the population; ``say`` is told how many passes are done."""
    model, data = prepared.model, prepared.data
    passes = 2 + REFINEMENTS + (model.kind == "arma") + EXPANSIONS

    def told(number: int) -> Progress:
        return lambda done, total: say(number * total + done, passes * total)

    layout = arrange(model.locations, data.design, "subject" if model.mass_error == "subject" else None)
    prior_mean = np.array(model.locations.mean)
    start = first_guess(prepared)
    loose = loose_anchor(start)
    summaries = _expanded(model, data, jnp.asarray(start), loose, ITERATIONS[0], told(0))
    where = _Where(model, layout, prior_mean, None)
    where = where.given(summaries)
    anchor = where.anchor()
    summaries = _expanded(model, data, summaries.centre, anchor, ITERATIONS[1], told(1))
    standard = jnp.asarray(standard_points(start.shape[1]))
    for number in range(REFINEMENTS):
        where = where.given(summaries)
        summaries = _refined(model, data, summaries, where, standard, told(2 + number))
    where = where.given(summaries)
    profile, own = None, summaries
    if model.kind == "arma":
        summaries = cleared_of_last(summaries)
        few = jnp.asarray(standard_points(start.shape[1], FEW))
        profile = _profiled(model, data, summaries, where, few, told(2 + REFINEMENTS))
        own = _without_last(summaries)
        where = where.given(own)
        surface = surface_around(profile, where.of_last, where.guess_of_last())
        where = replace(where, surface=surface).given(own)
    for number in range(passes - EXPANSIONS, passes):
        draws = where.draws(len(standard))
        found = expand(
            model, data, summaries, profile, where.cells, where.spread, draws, progress=told(number)
        )
        where = where.corrected(found, own, again=number < passes - 1)
    return ManySummarised(summaries, where.cells, where.spreads(), profile, where.surface)


def _without_last(cleared: Summaries) -> Summaries:
    return Summaries(
        cleared.centre[:, :-1], cleared.slope[:, :-1], cleared.precision[:, :-1, :-1], cleared.log_likelihood
    )


def _expanded(
    model: TraceModel, data: TraceData, start: Array, anchor: Anchor, iterations: int, say: Progress
) -> Summaries:
    mean, precision = np.asarray(anchor.mean), np.asarray(anchor.precision[0])
    start = np.asarray(start)

    def one(part: TraceData, rows: np.ndarray) -> Summaries:
        own = Anchor(mean[rows], np.broadcast_to(precision, (len(rows), *precision.shape)))
        return summarise_traces(model, part, start[rows], own, iterations)

    return in_blocks(data, one, progress=say)


def _refined(
    model: TraceModel, data: TraceData, summaries: Summaries, where: _Where, standard: Array, say: Progress
) -> Summaries:
    spread, about = where.spread, where.about()

    def one(part: TraceData, rows: np.ndarray) -> Summaries:
        return _refine_block(model, part, rows_of(summaries, rows), spread, about[rows], standard)

    return in_blocks(data, one, progress=say)


@partial(jax.jit, static_argnames="model")
def _refine_block(
    model: TraceModel, data: TraceData, summaries: Summaries, spread: Spread, about: Array, standard: Array
) -> Summaries:
    parts = impact_parts(spread, summaries)
    columns = [about[:, a] for a in range(about.shape[1])]
    points = compare_about(model, data, summaries, parts, columns, standard)
    return refine_about(spread, summaries, parts, columns, points)


def _profiled(
    model: TraceModel, data: TraceData, cleared: Summaries, where: _Where, few: Array, say: Progress
) -> Profile:
    spread, about = where.spread, where.about()

    def one(part: TraceData, rows: np.ndarray) -> Array:
        return _profile_block(model, part, rows_of(cleared, rows), spread, about[rows], few)

    table = in_blocks(data, one, progress=say)
    return flat_profile(1)._replace(log_likelihood=np.ascontiguousarray(table.T))


@partial(jax.jit, static_argnames="model")
def _profile_block(
    model: TraceModel, data: TraceData, cleared: Summaries, spread: Spread, about: Array, few: Array
) -> Array:
    columns = [about[:, a] for a in range(about.shape[1])]
    parts = impact_parts(spread, cleared)
    return profile_about(model, data, cleared, parts, columns, few).log_likelihood.T


@dataclass(frozen=True)
class _Where:
    """Where the summaries put the population: the spreads' posterior mode, and b's mean there."""

    model: TraceModel
    layout: Arrangement
    prior_mean: np.ndarray
    surface: Surface | None
    mode: np.ndarray | None = None
    cells: Any = None
    b: Any = None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted([*self.model.spreads, *(["standard_last"] if self.surface is not None else [])]))

    def given(self, summaries: Summaries) -> _Where:
        """The same for other summaries, measured from the b at hand."""
        reference = self.prior_mean if self.b is None else self.b
        cells = in_cells(self.layout, summaries, self.prior_mean, reference)
        found = replace(self, cells=cells, mode=None)
        start = self.mode if self.mode is not None and len(self.mode) == len(found.names) else None
        mode = found._find(start)
        placed = replace(found, mode=mode)
        b = np.asarray(_mean_of(cells, placed.spread))
        # Far from b the squares that cancel are large: measured from it they are not.
        cells = in_cells(self.layout, summaries, self.prior_mean, b)
        return replace(placed, cells=cells, b=b)

    def corrected(self, expansion: Expansion, summaries: Summaries, *, again: bool) -> _Where:
        """With the expansion in the evidence; ``again`` moves the reference, for another one.

        An expansion that leaves no posterior at all is left out: what is then found at the end tells of it.
        """
        found = replace(self, cells=self.cells._replace(expansion=expansion))
        found = replace(found, mode=found._find(self.mode))
        if not np.isfinite(found._at(found.mode)[1]).all():
            return self
        if not again:
            return found
        b = np.asarray(_mean_of(found.cells, found.spread))
        return replace(found, b=b, cells=in_cells(self.layout, summaries, self.prior_mean, b))

    def draws(self, number: int) -> PopulationDraws:
        """Draws of the population, to second order about the mode."""
        rng = np.random.default_rng(number)
        root = np.linalg.cholesky(self.spreads().covariance)
        flat = self.mode + rng.standard_normal((number, len(self.mode))) @ root.T
        raw = dict(zip(self.names, jnp.asarray(flat.T), strict=True))
        z = jnp.asarray(rng.standard_normal((number, len(self.prior_mean))))
        if self.surface is not None:
            z = z.at[:, -1].set(raw.pop("standard_last"))
        return PopulationDraws(raw, _locations(self.model, self.cells, raw, z))

    @property
    def spread(self) -> Spread:
        return population(self.model, self._constrained(self.mode))

    def about(self) -> np.ndarray:
        """X b, [impact, parameter]."""
        columns = expected_by_place(self.layout, jnp.asarray(self.b))
        return np.stack([np.asarray(column)[self.layout.place] for column in columns], axis=1)

    def anchor(self) -> Anchor:
        """What the population says of every impact."""
        kk, kc, cc = self.spread.own
        size = 2 + len(self.spread.nuisance)
        covariance = np.diag([0.0, 0.0, *(float(sd) ** 2 for sd in self.spread.nuisance)])
        covariance[:2, :2] = [[kk, kc], [kc, cc]]
        return Anchor(self.about(), np.linalg.inv(covariance).reshape(1, size, size))

    def guess_of_last(self) -> np.ndarray:
        """A first guess of the mean and log sd of a parameter that has a profile."""
        return np.array([self.b[-1], np.log(float(self.spread.nuisance[-1]))])

    def of_last(self, surface: Surface) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mode and standard deviations of these two under a surface."""
        found = replace(self, surface=surface)
        mode = found._find(None)
        sites = dict(zip(found.names, mode, strict=True))
        last = self.model.spreads[-1]
        scale = self.model.locations.sd[-1]
        sd = float(constrained(self.model, sites)[last])
        spreads = replace(found, mode=mode).spreads()
        error = np.sqrt(np.diagonal(spreads.covariance))
        at = {name: place for place, name in enumerate(found.names)}
        # A standard deviation's unconstrained coordinate is its log.
        return (
            np.array([self.prior_mean[-1] + scale * sites["standard_last"], np.log(sd)]),
            np.array([scale * error[at["standard_last"]], error[at[last]]]),
        )

    def spreads(self) -> Spreads:
        """To second order about the mode."""
        steps = _STEP * np.eye(len(self.mode))
        slopes = [[self._at(self.mode + side * step)[1] for step in steps] for side in (1, -1)]
        curvature, axes = np.linalg.eigh(np.subtract(*map(np.array, slopes)) / (2 * _STEP))
        # A direction that the mode leaves flat, as the log of a small spread is, gets unit scale.
        covariance = (axes / np.maximum(curvature, 1.0)) @ axes.T
        return Spreads(dict(zip(self.names, np.asarray(self.mode), strict=True)), covariance)

    def _constrained(self, flat: np.ndarray) -> dict[str, Array]:
        return constrained(self.model, dict(zip(self.names, jnp.asarray(flat), strict=True)))

    def _find(self, start: np.ndarray | None) -> np.ndarray:
        begin = np.full(len(self.names), -1.5) if start is None else start
        bounds = [(-9, 5)] * len(begin)
        return minimize(self._at, begin, jac=True, method="L-BFGS-B", bounds=bounds).x

    def _at(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _value_and_slope(self.model, self.names, jnp.asarray(flat), self.cells, self.surface)
        return float(value), np.asarray(slope)


@partial(jax.jit, static_argnames=("model", "names"))
def _value_and_slope(
    model: TraceModel, names: tuple[str, ...], flat: Array, cells: Cells, surface: Surface | None
) -> tuple[Array, Array]:
    """Minus the spreads' log density, unconstrained and in the order of ``names``, and its gradient."""
    own: Callable[..., None] = partial(cells_model, model)

    def potential(flat: Array) -> Array:
        return potential_energy(own, (cells, surface), {}, dict(zip(names, flat, strict=True)))

    return jax.value_and_grad(potential)(flat)


@partial(jax.jit, static_argnames="model")
def _locations(model: TraceModel, cells: Cells, raw: dict[str, Array], z: Array) -> Array:
    def one(draw: tuple[dict[str, Array], Array]) -> Array:
        solution, _ = solve(cells, population(model, constrained(model, draw[0])))
        return locations_of(cells, solution, draw[1])

    return jax.lax.map(one, (raw, z))


@jax.jit
def _mean_of(cells: Cells, spread: Spread) -> Array:
    return locations_of(cells, solve(cells, spread)[0])
