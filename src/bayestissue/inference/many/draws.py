"""The summary path for many impacts: the same steps as `summary_path`, at a cost that many impacts allow.

The population's draws are as many as ever. Each impact's own parameters are drawn for some of these only,
evenly spaced; and what costs draws times impacts beyond that, such as predicted traces, is made for some
impacts only, evenly spaced too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.gaussian.cells import expected_by_place
from bayestissue.hierarchy.gaussian.conditional import Sites, impact_parts, impact_values
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, constrained, log_likelihood, population
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.factors.moments import POINTS
from bayestissue.inference.many.approximate import ManySummarised
from bayestissue.inference.many.correction import PopulationDraws, residual_log_weights, rows_of
from bayestissue.inference.many.kept import kept_draws
from bayestissue.inference.many.population import cells_model
from bayestissue.inference.many.scores import locations_and_scores, scores_of_some
from bayestissue.inference.posterior.constrained_draws import (
    ConstrainedDraws,
    error_of_people,
    impact_error,
    impact_quantities,
    named_sites,
)
from bayestissue.inference.posterior.recipe import CANDIDATES, PARETO_LIMIT, Correction
from bayestissue.inference.samplers.independence import independence_chains
from bayestissue.inference.samplers.nuts import Start, run_chains
from bayestissue.inference.samplers.psis import pareto_smoothed
from bayestissue.inference.samplers.sampling import Draws, Progress

MANY = 5000
CHECKS = 40


def many_draws(
    prepared: Prepared,
    summarised: ManySummarised,
    settings: Sampler,
    seed: int,
    say: Callable[[str, int, int], None],
) -> tuple[Draws, ConstrainedDraws, Correction]:
    """Draws of the population, and of the impacts what `ConstrainedDraws` keeps, corrected."""
    model, cells = prepared.model, summarised.cells
    chains = _chains(model, summarised, settings, seed, partial(say, "sampling the population"))
    found = chains.thinned(settings.thinning)
    shape = (settings.chains, settings.draws)
    raw = {name: jnp.asarray(values.reshape(-1)) for name, values in found.sites.items()}
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 21), 4)
    z = jax.random.normal(keys[0], (shape[0] * shape[1], model.locations.size))
    if summarised.surface is not None:
        z = z.at[:, -1].set(raw.pop("standard_last"))
    say("drawing people and conditions", 0, 1)
    b, scores = locations_and_scores(prepared, cells, raw, z)
    draws = PopulationDraws(raw, b)
    weights = residual_log_weights(
        model,
        prepared.data,
        summarised.summaries,
        summarised.profile,
        cells,
        draws.some(POINTS),
        draws.some(CHECKS),
        progress=partial(say, "comparing traces and summaries"),
    )
    smoothed, k = pareto_smoothed(weights)
    weight = np.exp(np.asarray(smoothed))
    correction = Correction(float(k), float(weight.sum() ** 2 / np.square(weight).sum() / CHECKS))
    densities = {name: _by_chain(values, shape) for name, values in scores.items()}
    true_b, error = _with_true_masses(model, constrained(model, raw), b, keys[1])
    impacts, kept = _of_impacts(prepared, summarised, raw, b, error, shape, keys[2], say)
    densities["trace"] = scores_of_some(prepared, summarised, draws).reshape(*shape, -1)
    sites = {name: np.asarray(values).reshape(shape) for name, values in constrained(model, raw).items()}
    unfolded = ConstrainedDraws(
        named_sites(model, prepared.design, sites, np.asarray(true_b).reshape(*shape, -1)),
        impacts,
        densities,
        kept,
    )
    population_draws = Draws(
        {name: np.asarray(values).reshape(shape) for name, values in raw.items()},
        found.statistics,
        found.max_tree_depth,
    )
    return population_draws, unfolded, correction


def _chains(
    model: TraceModel, summarised: ManySummarised, settings: Sampler, seed: int, progress: Progress
) -> Draws:
    """The population's spreads: independent proposals where they serve, else trajectories."""
    target, spreads = (summarised.cells, summarised.surface), summarised.spreads
    progress(0, 1)
    found = independence_chains(_cells_of(model), target, spreads, settings, seed)
    if found.pareto_k < PARETO_LIMIT:
        return found.draws
    start = Start(spreads.mode, tuple(sorted(spreads.mode)), spreads.covariance)
    return run_chains(_cells_of(model), target, start, settings, seed, progress=progress)


def _by_chain(values: Array, shape: tuple[int, int]) -> np.ndarray:
    return np.asarray(values).reshape(*shape, *values.shape[1:])


@lru_cache(maxsize=8)
def _cells_of(model: TraceModel) -> Callable[..., None]:
    """The same function each time, so that what is compiled for it serves again."""
    return partial(cells_model, model)


def _with_true_masses(
    model: TraceModel, sites: dict[str, Array], b: Array, key: Array
) -> tuple[Array, Float[Array, "draw person"] | None]:
    """Locations at people's true masses, where all impacts of a person share one error; and that error."""
    if model.mass_error == "impact":
        return b, None
    keys = jax.random.split(key, len(b))

    def one(draw: tuple[dict[str, Array], Array, Array]) -> tuple[Array, Array]:
        spread = population(model, draw[0])
        shared = spread.shared
        assert shared is not None  # noqa: S101 - the error is a person's
        error = error_of_people(spread.locations, shared, draw[1], draw[2])
        return draw[1].at[shared.effect_on_K].add(error).at[shared.effect_on_C].add(error), error

    return jax.lax.map(one, (sites, b, keys))


def _of_impacts(
    prepared: Prepared,
    summarised: ManySummarised,
    raw: dict[str, Array],
    b: Array,
    error: Array | None,
    shape: tuple[int, int],
    key: Array,
    say: Callable[[str, int, int], None],
) -> tuple[dict[str, np.ndarray], Int[np.ndarray, " kept"]]:
    """Every impact's parameters for the draws that are kept, [chain, kept draw, impact]."""
    model, data, cells = prepared.model, prepared.data, summarised.cells
    kept = kept_draws(*shape, len(data.log_mass))
    which = (np.arange(shape[0])[:, None] * shape[1] + kept).ravel()
    sites = {name: values[which] for name, values in raw.items()}
    about = [np.asarray(each) for each in expected_by_place(cells.arrangement, b[which])]
    place, person = np.asarray(cells.arrangement.place), prepared.design.subject
    of_people = None if error is None else np.asarray(error)[which]

    def one(part: TraceData, rows: np.ndarray) -> dict[str, Array]:
        here = np.stack([each[:, place[rows]] for each in about], axis=-1)
        own = None if of_people is None else of_people[:, person[rows]]
        keys = jax.random.split(jax.random.fold_in(key, int(rows[0])), len(which))
        return _draw_block(model, part, rows_of(summarised.summaries, rows), sites, here, own, keys)

    progress: Progress = partial(say, "drawing each impact")
    made = in_blocks(data, one, progress=progress)
    chains = shape[0]
    impacts = {
        name: np.moveaxis(v.reshape(len(v), chains, len(kept), *v.shape[2:]), 0, 2)
        for name, v in made.items()
    }
    return impacts, kept


@jax.jit
def _draw_block(
    model: TraceModel,
    data: TraceData,
    summaries: Sites,
    raw: dict[str, Array],
    about: Float[Array, "draw impact parameter"],
    error: Float[Array, "draw impact"] | None,
    keys: Array,
) -> dict[str, Array]:
    """Each impact's quantities, [impact, draw]; see `_standard_impacts` of `summary_path`."""
    shape = summaries.centre.shape

    def one(draw: tuple[dict[str, Array], Array, Array | None, Array]) -> dict[str, Array]:
        own, expectation, shared, key = draw
        sites = constrained(model, own)
        spread = population(model, sites)
        columns = [expectation[:, a] for a in range(shape[1])]
        parts = impact_parts(spread, summaries)
        of_candidates, of_choice, of_mass, of_errors = jax.random.split(key, 4)
        candidates = jax.random.normal(of_candidates, (CANDIDATES, *shape))

        def ratio(candidate: Array) -> Array:
            u = impact_values(parts, summaries, columns, candidate)
            return log_likelihood(model, data, u) - summaries.log_summary(u)

        ratios = jax.lax.map(ratio, candidates)
        choice = jax.random.categorical(of_choice, jnp.nan_to_num(ratios, nan=-jnp.inf), axis=0)
        standard = jnp.take_along_axis(candidates, choice[None, :, None], axis=0)[0]
        u = impact_values(parts, summaries, columns, standard)
        if shared is None:
            shared = impact_error(model, spread, u, columns, of_mass)
        return impact_quantities(model, data, u, shared, of_errors)

    made = jax.lax.map(one, (raw, about, error, keys))
    # Seven digits of a draw are more than it knows, and half the memory.
    return {name: jnp.moveaxis(values, 1, 0).astype(jnp.float32) for name, values in made.items()}
