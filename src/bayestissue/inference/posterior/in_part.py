"""The recipe where draws times impacts are more than fits: the same steps, what costs so much kept in part.

The population's draws are as many as ever. Of each impact some are kept, evenly spaced; and what costs draws
times impacts beyond that, as scores of single impacts do, is made for some impacts. What the sites leave out,
small for one trace, adds up over many: its expansion is part of the marginal density, and what even that
leaves out is checked at some draws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.derived import named_sites
from bayestissue.hierarchy.gaussian.arrangement import expected_by_cell
from bayestissue.hierarchy.gaussian.conditional import Data, integrate_out
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import COORDINATES, TraceData, TraceModel, constrained, population
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.execution.compiling import in_calls
from bayestissue.inference.execution.kept import kept_draws, some_impacts, some_of
from bayestissue.inference.execution.progress import Progress, silent
from bayestissue.inference.factors.conditional import POINTS, normals
from bayestissue.inference.factors.conditional_prior import ConditionalPriors
from bayestissue.inference.posterior.approximate import LAST, Approximation, spreads_of_summaries
from bayestissue.inference.posterior.constrained_draws import DRAWS, at_true_masses, constrain_rows
from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.posterior.expansion import (
    PopulationDraws,
    anchors_of,
    expand,
    of_cells,
    residual_log_weights,
    rows_of,
    told_of_rows,
)
from bayestissue.inference.posterior.own_effects import OwnEffects, Slots, own_effects
from bayestissue.inference.posterior.recipe import candidates_for, sample_marginal, sir_proposals
from bayestissue.inference.posterior.scores import LikelihoodApproximation, of_draws, scores_of_groups
from bayestissue.inference.samplers.sampling import ConstrainedDraws, Draws

# Of weights that vary by a quarter, as those of 100,000 impacts did, 40 draws have a Pareto k above the
# threshold of their number 27 times of 100; so many had none of 400 times.
CHECKS = 192
EXPANSIONS = 2


def draws_in_part(
    prepared: Prepared,
    summarised: Approximation,
    settings: Sampler,
    seed: int,
    say: Callable[[str, int, int], None],
) -> tuple[Draws, ConstrainedDraws, Correction]:
    """Draws of the population, and of the impacts what `ConstrainedDraws` keeps, corrected."""
    model = prepared.model
    comparing = partial(say, "comparing traces and summaries")
    summarised = with_expansion(prepared, summarised, seed, comparing)
    sampling = partial(say, "sampling the population")
    found = sample_marginal(prepared, summarised, settings, seed, sampling).thinned(settings.thinning)
    shape = (settings.chains, settings.draws)
    y = found.sites[COORDINATES].reshape(shape[0] * shape[1], -1)
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 21), 4)
    say("drawing people and conditions", 0, 1)
    draws, scores = _population(prepared, summarised, y, keys[0])
    mixture, checked = draws.some(POINTS), draws.some(CHECKS)
    weights, varies = residual_log_weights(prepared, summarised, mixture, checked, progress=comparing)
    correction = Correction.of(weights[None], CHECKS)
    densities = {name: np.asarray(v).reshape(*shape, *v.shape[1:]) for name, v in scores.items()}
    hyper = constrained(model, draws.raw)
    of_mass = jax.random.split(keys[1], len(y))
    true_b = _at_true_masses(model, hyper, draws.b, of_mass)
    # What has a grid varies besides under the population of each draw.
    candidates = candidates_for(np.inf if summarised.profile is not None else float(varies.mean()))
    impacts, kept = _of_impacts(prepared, summarised, draws, candidates, of_mass, shape, seed, say)
    densities["trace"] = _scores_of_some(prepared, summarised, draws).reshape(*shape, -1)
    sites = {name: np.asarray(values).reshape(shape) for name, values in hyper.items()}
    unfolded = ConstrainedDraws(
        named_sites(model.locations, prepared.design, sites, np.asarray(true_b).reshape(*shape, -1)),
        impacts,
        densities,
        kept,
    )
    raw = {name: np.asarray(values).reshape(shape) for name, values in draws.raw.items()}
    return replace(found, sites=raw), unfolded, correction


def with_expansion(
    prepared: Prepared, summarised: Approximation, seed: int, progress: Progress = silent
) -> Approximation:
    """The approximation with what its sites leave out expanded, as part of the marginal density.

    Each expansion is made about the posterior's middle under the one before. One that leaves no posterior at
    all is left out: what is then found at the end tells of it.
    """
    rng = np.random.default_rng([seed, 25])
    for number in range(EXPANSIONS):
        y = np.zeros((1 + POINTS, len(summarised.spreads.names)))
        y[1:] = rng.multivariate_normal(y[0], summarised.spreads.covariance, POINTS)
        drawn, _ = _population(prepared, summarised, y, jax.random.PRNGKey(number), middle=True)
        middle, others = drawn.rows(slice(1)), drawn.rows(slice(1, None))

        def told(done: int, total: int, number: int = number) -> None:
            progress(number * total + done, EXPANSIONS * total)

        expansion = expand(prepared, summarised, middle, others, progress=told)
        found = replace(summarised, expansion=expansion)
        near = {name: np.asarray(values[0]) for name, values in middle.raw.items()}
        spreads = spreads_of_summaries(prepared, found, near)
        if not np.isfinite(spreads.covariance).all():
            break
        summarised = replace(found, spreads=spreads)
    return summarised


def _population(
    prepared: Prepared,
    summarised: Approximation,
    y: Float[np.ndarray, "draw coordinate"],
    key: Array,
    *,
    middle: bool = False,
) -> tuple[PopulationDraws, dict[str, Array]]:
    """The population's draws, the first with the mean of b for ``middle``, and the groups' scores."""
    model = prepared.model
    raw = {name: jnp.asarray(values) for name, values in summarised.spreads.raw(y).items()}
    z = jax.random.normal(key, (len(y), model.locations.size))
    if middle:
        z = z.at[0].set(0.0)
    last = raw.pop(LAST, None)
    if last is not None:
        z = z.at[:, -1].set(last)
    data = jax.tree.map(jnp.asarray, summarised.data(prepared.data))
    found = own_effects(model, prepared.design)
    groups = tuple((name, slots) for name, (slots, _) in found.items())
    own = {name: _by_place(prepared, each) for name, (_, each) in found.items()}
    b, scores = _effects_and_scores(model, groups, data, own, raw, z)
    return PopulationDraws(raw, b), scores


def _by_place(prepared: Prepared, own: OwnEffects) -> OwnEffects:
    """The same of each place, whose impacts are alike; an empty one has level 0 and adds nothing."""
    cell, places = np.asarray(prepared.data.design.cell), prepared.data.design.members.shape[2]
    level, value = np.zeros(places, int), np.zeros((len(own.value), places))
    level[cell], value[:, cell] = own.level, own.value
    return OwnEffects(level, own.element, value)


@partial(jax.jit, static_argnames="groups")
def _effects_and_scores(
    model: TraceModel,
    groups: tuple[tuple[str, Slots], ...],
    data: Data,
    own: dict[str, OwnEffects],
    raw: dict[str, Array],
    z: Array,
) -> tuple[Array, dict[str, Array]]:
    """All effects of each draw, and the log densities of all traces of each person and condition."""

    def one(draw: tuple[dict[str, Array], Array]) -> tuple[Array, dict[str, Array]]:
        sites = constrained(model, draw[0])
        given = integrate_out(data, population(model, sites))
        b = given.draw_effects(draw[1])
        moved = expected_by_cell(data.design, b) - expected_by_cell(data.design, data.mean)
        return b, scores_of_groups(model, given.sums, moved, groups, own, sites, b)

    return jax.lax.map(one, (raw, z))


@jax.jit
def _at_true_masses(model: TraceModel, sites: dict[str, Array], b: Array, keys: Array) -> Array:
    """Effects at people's true masses, where all impacts of a person share one error, as `constrain_rows`."""

    def one(draw: tuple[dict[str, Array], Array, Array]) -> Array:
        own, effects, key = draw
        return at_true_masses(population(model, own), effects, key)[0]

    return jax.lax.map(one, (sites, b, keys))


def _of_impacts(
    prepared: Prepared,
    summarised: Approximation,
    draws: PopulationDraws,
    candidates: int,
    of_mass: Array,
    shape: tuple[int, int],
    seed: int,
    say: Callable[[str, int, int], None],
) -> tuple[dict[str, np.ndarray], Int[np.ndarray, " kept"]]:
    """Every impact's parameters for the draws that are kept, [chain, kept draw, impact]."""
    model, design = prepared.model, prepared.data.design
    cell, summaries = np.asarray(design.cell), summarised.summaries
    kept = kept_draws(*shape, len(cell))
    which = (np.arange(shape[0])[:, None] * shape[1] + kept).ravel()
    draws = draws.rows(which)
    anchors, sites, people = anchors_of(model, design, draws), constrained(model, draws.raw), of_mass[which]

    def one(part: TraceData, rows: np.ndarray) -> dict[str, np.ndarray]:
        rng = np.random.default_rng([seed, 24, int(rows[0])])
        own, here = rows_of(summaries, rows), of_cells(anchors, cell[rows])
        seeds = rng.integers(2**32, size=len(which))
        z = sir_proposals(model, part, own, candidates, here.mean, here.precision[:, 0], seeds)
        keys = jax.random.split(jax.random.PRNGKey(rng.integers(2**32)), (2, len(which)))
        shared = people if model.mass_error == "subject" else keys[0]
        given = (sites, draws.b, here.mean, normals(own, here).at(z), shared, keys[1])
        # Of the design X b of these impacts is asked alone.
        part = part._replace(design=design._replace(cell=cell[rows]))
        _, made = in_calls(partial(constrain_rows, model, part), given, DRAWS)
        # Seven digits of a draw are more than it knows, and half the memory.
        return {name: np.moveaxis(values, 1, 0).astype(np.float32) for name, values in made.items()}

    made = in_blocks(prepared.data, one, progress=partial(say, "drawing each impact"))
    impacts = {
        name: np.moveaxis(v.reshape(len(v), shape[0], len(kept), *v.shape[2:]), 0, 2)
        for name, v in made.items()
    }
    return impacts, kept


def _scores_of_some(
    prepared: Prepared, summarised: Approximation, draws: PopulationDraws
) -> Float[np.ndarray, "draw shown"]:
    """Log density of the traces of some impacts, every draw."""
    model, rows = prepared.model, some_impacts(len(prepared.data.log_mass))
    some = some_of(prepared, rows)
    anchors = of_cells(anchors_of(model, some.data.design, draws), np.asarray(some.data.design.cell))
    told = LikelihoodApproximation(*told_of_rows(summarised, rows))
    expected = ConditionalPriors({}, np.asarray(draws.b), anchors.mean, anchors.precision[:, 0])
    return of_draws(some, told, expected, {})["trace"]
