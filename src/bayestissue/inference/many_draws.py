"""The summary path for many impacts: the same steps as `summary_path`, at a cost that many impacts allow.

The population's draws are as many as ever. Each impact's own parameters are drawn for some of these only,
evenly spaced; and what costs draws times impacts beyond that, such as predicted traces, is made for some
impacts only, evenly spaced too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.cells import Cells, CellSums, expected_by_place, locations_of, solve
from bayestissue.hierarchy.conditional import Summaries, impact_parts, impact_values, log_evidence_of
from bayestissue.hierarchy.design import GROUPS
from bayestissue.hierarchy.population import Spread
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, constrained, log_likelihood, population
from bayestissue.inference.chains import Start, run_chains
from bayestissue.inference.many_correction import PopulationDraws, left_out, rows_of
from bayestissue.inference.many_summaries import ManySummarised, cells_model
from bayestissue.inference.sampling import Draws, Progress
from bayestissue.inference.summary_path import CANDIDATES, Correction
from bayestissue.inference.trace_blocks import impacts_of, in_blocks
from bayestissue.inference.trace_correction import POINTS, pareto_smoothed
from bayestissue.inference.trace_draws import (
    Unfolded,
    error_of_people,
    impact_error,
    impact_quantities,
    integrated_effects,
    named_sites,
)

MANY = 5000
MOST_VALUES = 10_000_000
SHOWN = 1000
CHECKS = 40


def some_impacts(count: int) -> Int[np.ndarray, " shown"]:
    """The impacts for which everything is kept: all, or a thousand evenly spaced ones."""
    return np.unique(np.linspace(0, count - 1, min(count, SHOWN)).round().astype(int))


def kept_draws(chains: int, draws: int, impacts: int) -> Int[np.ndarray, " kept"]:
    """Numbers of the draws of each chain that are kept of single impacts, evenly spaced."""
    most = max(10, MOST_VALUES // (chains * impacts))
    return np.arange(0, draws, max(1, -(-draws // most)))


def many_draws(
    prepared: Prepared,
    summarised: ManySummarised,
    settings: Sampler,
    seed: int,
    say: Callable[[str, int, int], None],
) -> tuple[Draws, Unfolded, Correction]:
    """Draws of the population, and of the impacts what `Unfolded` keeps, corrected to the true posterior."""
    model, cells = prepared.model, summarised.cells
    spreads = summarised.spreads
    found = run_chains(
        _cells_of(model),
        (cells, summarised.surface),
        Start(spreads.mode, tuple(sorted(spreads.mode)), spreads.covariance),
        settings,
        seed,
        progress=partial(say, "sampling the population"),
    )
    shape = (settings.chains, settings.draws)
    raw = {name: jnp.asarray(values.reshape(-1)) for name, values in found.sites.items()}
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 21), 4)
    z = jax.random.normal(keys[0], (shape[0] * shape[1], model.locations.size))
    if summarised.surface is not None:
        z = z.at[:, -1].set(raw.pop("standard_last"))
    say("drawing people and conditions", 0, 1)
    b, scores = _population(model, cells, _codes(prepared, cells), raw, z)
    draws = PopulationDraws(raw, b)
    weights = left_out(
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
    scores = {name: _by_chain(values, shape) for name, values in scores.items()}
    true_b, error = _with_true_masses(model, constrained(model, raw), b, keys[1])
    impacts, kept = _of_impacts(prepared, summarised, raw, b, error, shape, keys[2], say)
    scores["trace"] = _scores_of_some(prepared, summarised, raw, b).reshape(*shape, -1)
    sites = {name: np.asarray(values).reshape(shape) for name, values in constrained(model, raw).items()}
    unfolded = Unfolded(
        named_sites(prepared, sites, np.asarray(true_b).reshape(*shape, -1)), impacts, scores, kept
    )
    population_draws = Draws(
        {name: np.asarray(values).reshape(shape) for name, values in raw.items()},
        found.statistics,
        found.max_tree_depth,
    )
    return population_draws, unfolded, correction


def _by_chain(values: Array, shape: tuple[int, int]) -> np.ndarray:
    return np.asarray(values).reshape(*shape, *values.shape[1:])


@lru_cache(maxsize=8)
def _cells_of(model: TraceModel) -> Callable[..., None]:
    """The same function each time, so that what is compiled for it serves again."""
    return partial(cells_model, model)


def _codes(prepared: Prepared, cells: Cells) -> dict[str, Int[np.ndarray, " place"]]:
    """Person and condition of each place; 0 for an empty one, which adds nothing."""
    place = np.asarray(cells.arrangement.place)
    codes = {}
    for group in GROUPS:
        codes[group] = np.zeros(cells.level.shape[0], int)
        codes[group][place] = getattr(prepared.design, group)
    return codes


@partial(jax.jit, static_argnames="model")
def _population(
    model: TraceModel, cells: Cells, codes: dict[str, Array], raw: dict[str, Array], z: Array
) -> tuple[Array, dict[str, Array]]:
    """All locations of each draw, and the log densities of all traces of each person and condition."""

    def one(draw: tuple[dict[str, Array], Array]) -> tuple[Array, dict[str, Array]]:
        sites = constrained(model, draw[0])
        solution, sums = solve(cells, population(model, sites))
        b = locations_of(cells, solution, draw[1])
        return b, _scores(model, cells, sums, codes, sites, b)

    return jax.lax.map(one, (raw, z))


def _scores(
    model: TraceModel,
    cells: Cells,
    sums: CellSums,
    codes: dict[str, Array],
    sites: dict[str, Array],
    b: Array,
) -> dict[str, Array]:
    """Log densities of all traces together, and of a person's or a condition's with its effects left out."""
    size, parts = len(cells.slope), model.locations.parts
    here = expected_by_place(cells.arrangement, b)[:size]
    start = expected_by_place(cells.arrangement, cells.reference)[:size]
    moved = [v - v0 for v, v0 in zip(here, start, strict=True)]

    def at(away: list[Array]) -> tuple[Array, list[Array]]:
        bent = [sum(sums.entry(a, c) * away[c] for c in range(size)) for a in range(size)]
        value = cells.level + sums.constant
        value = value + sum(d * (sums.pull[a] - bent[a] / 2) for a, d in enumerate(away))
        return value, [sums.pull[a] - bent[a] for a in range(size)]

    scores = {"traces": at(moved)[0].sum()}
    for group in GROUPS:
        names = [f"{group}_effect_{q}" for q in ("K", "C")]
        # Counted from the model, so that the sums have a fixed size.
        own = [b[parts[name]] if name in parts else None for name in names]
        count = max((len(each) for each in own if each is not None), default=0)
        if not count:
            continue
        away = [d if e is None else d - e[codes[group]] for d, e in zip(moved[:2], own, strict=True)]
        value, pull = at([*away, *moved[2:]])

        def total(values: Array, group: str = group, count: int = count) -> Array:
            return jax.ops.segment_sum(values, codes[group], count)

        gained = integrated_effects(
            model,
            sites,
            group,
            [total(sums.entry(0, 0)), total(sums.entry(0, 1)), total(sums.entry(1, 1))],
            [total(pull[0]), total(pull[1])],
        )
        scores[f"traces_of_{group}"] = total(value) + gained
    return scores


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


@partial(jax.jit, static_argnames="model")
def _draw_block(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
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


def _scores_of_some(
    prepared: Prepared, summarised: ManySummarised, raw: dict[str, Array], b: Array
) -> Float[np.ndarray, "draw shown"]:
    """Log density of the traces of some impacts, every draw."""
    cells = summarised.cells
    rows = some_impacts(len(prepared.data.log_mass))
    place = np.asarray(cells.arrangement.place)[rows]
    some = rows_of(summarised.summaries, rows)
    return np.asarray(_trace_scores(prepared.model, cells, some, place, raw, b))


@partial(jax.jit, static_argnames="model")
def _trace_scores(
    model: TraceModel, cells: Cells, summaries: Summaries, place: Array, raw: dict[str, Array], b: Array
) -> Array:
    def one(draw: tuple[dict[str, Array], Array]) -> Array:
        spread: Spread = population(model, constrained(model, draw[0]))
        about = [each[place] for each in expected_by_place(cells.arrangement, draw[1])]
        return log_evidence_of(impact_parts(spread, summaries), summaries, about)

    return jax.lax.map(one, (raw, b))


def some_of(prepared: Prepared, rows: Int[np.ndarray, " row"]) -> Prepared:
    """The same fit with these impacts alone, the population as it was."""
    signal: Any = prepared.signal
    count = len(prepared.impacts)

    def chosen(name: str) -> Any:
        value = getattr(signal, name)
        if isinstance(value, list):
            return [value[row] for row in rows]
        return value[rows] if len(value) == count else value

    data = impacts_of(prepared.data, rows)
    cells, cell = np.unique(data.design.cell, return_inverse=True)
    columns = tuple(np.asarray(matrix)[cells] for matrix in data.design.columns)
    data = jax.tree.map(jnp.asarray, data._replace(design=data.design._replace(columns=columns, cell=cell)))
    return replace(
        prepared,
        data=data,
        signal=replace(signal, **{name: chosen(name) for name in signal.__dataclass_fields__}),
        impacts=prepared.impacts.iloc[rows].reset_index(drop=True),
    )
