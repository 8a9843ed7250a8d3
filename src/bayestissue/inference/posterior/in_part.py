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

from bayestissue.hierarchy.gaussian.arrangement import expected_by_cell
from bayestissue.hierarchy.gaussian.conditional import Data, integrate_out
from bayestissue.hierarchy.gaussian.impacts import ImpactConditional, Sites, parameters_first
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import (
    COORDINATES,
    TraceData,
    TraceModel,
    constrained,
    log_likelihood,
    population,
)
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.execution.kept import kept_draws, some_impacts, some_of
from bayestissue.inference.execution.progress import Progress, silent
from bayestissue.inference.factors.conditional import POINTS, log_evidence
from bayestissue.inference.posterior.approximate import LAST, Approximation, spreads_of_summaries
from bayestissue.inference.posterior.constrained_draws import (
    ConstrainedDraws,
    error_of_people,
    impact_error,
    impact_quantities,
    named_sites,
)
from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.posterior.expansion import (
    PopulationDraws,
    anchors_of,
    expand,
    residual_log_weights,
    rows_of,
    told_of_rows,
)
from bayestissue.inference.posterior.own_effects import OwnEffects, Slots, own_effects
from bayestissue.inference.posterior.recipe import CANDIDATES, sample_marginal
from bayestissue.inference.posterior.scores import (
    LikelihoodApproximation,
    log_evidence_ratios,
    scores_of_groups,
)
from bayestissue.inference.samplers.sampling import Draws

CHECKS = 40
EXPANSIONS = 2
# Draws at a time: a thousand impacts' matrices take memory.
_AT_ONCE = 64


def draws_in_part(
    prepared: Prepared,
    summarised: Approximation,
    settings: Sampler,
    seed: int,
    say: Callable[[str, int, int], None],
) -> tuple[Draws, ConstrainedDraws, Correction]:
    """Draws of the population, and of the impacts what `ConstrainedDraws` keeps, corrected."""
    model = prepared.model
    summarised = with_expansion(prepared, summarised, seed, partial(say, "comparing traces and summaries"))
    sampling = partial(say, "sampling the population")
    found = sample_marginal(prepared, summarised, settings, seed, sampling).thinned(settings.thinning)
    shape = (settings.chains, settings.draws)
    y = found.sites[COORDINATES].reshape(shape[0] * shape[1], -1)
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 21), 4)
    say("drawing people and conditions", 0, 1)
    draws, scores = _population(prepared, summarised, y, keys[0])
    weights = residual_log_weights(
        model,
        prepared.data,
        summarised.summaries,
        summarised.profile,
        summarised.expansion,
        draws.some(POINTS),
        draws.some(CHECKS),
        progress=partial(say, "comparing traces and summaries"),
    )
    correction = Correction.of(weights[None], CHECKS)
    densities = {name: np.asarray(v).reshape(*shape, *v.shape[1:]) for name, v in scores.items()}
    hyper = constrained(model, draws.raw)
    true_b, error = _with_true_masses(model, hyper, draws.b, keys[1])
    impacts, kept = _of_impacts(prepared, summarised, draws, error, shape, keys[2], say)
    densities["trace"] = _scores_of_some(prepared, summarised, draws).reshape(*shape, -1)
    sites = {name: np.asarray(values).reshape(shape) for name, values in hyper.items()}
    unfolded = ConstrainedDraws(
        named_sites(model, prepared.design, sites, np.asarray(true_b).reshape(*shape, -1)),
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
    model, rng = prepared.model, np.random.default_rng([seed, 25])
    for number in range(EXPANSIONS):
        y = np.zeros((1 + POINTS, len(summarised.spreads.names)))
        y[1:] = rng.multivariate_normal(y[0], summarised.spreads.covariance, POINTS)
        drawn, _ = _population(prepared, summarised, y, jax.random.PRNGKey(number), middle=True)
        middle, others = (
            PopulationDraws({name: values[part] for name, values in drawn.raw.items()}, drawn.b[part])
            for part in (slice(1), slice(1, None))
        )

        def told(done: int, total: int, number: int = number) -> None:
            progress(number * total + done, EXPANSIONS * total)

        expansion = expand(
            model,
            prepared.data,
            summarised.summaries,
            summarised.profile,
            middle,
            others,
            progress=told,
        )
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


def _with_true_masses(
    model: TraceModel, sites: dict[str, Array], b: Array, key: Array
) -> tuple[Array, Float[Array, "draw person"] | None]:
    """Effects at people's true masses, where all impacts of a person share one error; and that error."""
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
    summarised: Approximation,
    draws: PopulationDraws,
    error: Array | None,
    shape: tuple[int, int],
    key: Array,
    say: Callable[[str, int, int], None],
) -> tuple[dict[str, np.ndarray], Int[np.ndarray, " kept"]]:
    """Every impact's parameters for the draws that are kept, [chain, kept draw, impact]."""
    model, data = prepared.model, prepared.data
    kept = kept_draws(*shape, len(data.log_mass))
    which = (np.arange(shape[0])[:, None] * shape[1] + kept).ravel()
    raw = {name: values[which] for name, values in draws.raw.items()}
    about = np.moveaxis(np.asarray(expected_by_cell(data.design, draws.b[which])), 0, -1)
    cell, person = np.asarray(data.design.cell), prepared.design.subject
    of_people = None if error is None else np.asarray(error)[which]

    def one(part: TraceData, rows: np.ndarray) -> dict[str, Array]:
        own = None if of_people is None else of_people[:, person[rows]]
        keys = jax.random.split(jax.random.fold_in(key, int(rows[0])), len(which))
        sites = rows_of(summarised.summaries, rows)
        return _draw_block(model, part, sites, raw, about[:, cell[rows]], own, keys)

    made = in_blocks(data, one, progress=partial(say, "drawing each impact"))
    impacts = {
        name: np.moveaxis(v.reshape(len(v), shape[0], len(kept), *v.shape[2:]), 0, 2)
        for name, v in made.items()
    }
    return impacts, kept


@jax.jit
def _draw_block(
    model: TraceModel,
    data: TraceData,
    sites: Sites,
    raw: dict[str, Array],
    about: Float[Array, "draw impact parameter"],
    error: Float[Array, "draw impact"] | None,
    keys: Array,
) -> dict[str, Array]:
    """Each impact's quantities, [impact, draw], chosen as `recipe.sir_proposals` does."""

    def one(draw: tuple[dict[str, Array], Array, Array | None, Array]) -> dict[str, Array]:
        own, expectation, shared, key = draw
        spread = population(model, constrained(model, own))
        given = ImpactConditional.of(spread.of_impact(), parameters_first(sites))
        of_candidates, of_choice, of_mass, of_errors = jax.random.split(key, 4)
        shape = sites.centre.T.shape
        candidates = jax.random.normal(of_candidates, (CANDIDATES, *shape))

        def ratio(candidate: Array) -> Array:
            u = given.draw(expectation.T, candidate)
            return log_likelihood(model, data, list(u)) - sites.log_density(u.T)

        ratios = jax.lax.map(ratio, candidates)
        choice = jax.random.categorical(of_choice, jnp.nan_to_num(ratios, nan=-jnp.inf), axis=0)
        standard = jnp.take_along_axis(candidates, choice[None, None], axis=0)[0]
        u = list(given.draw(expectation.T, standard))
        if shared is None:
            shared = impact_error(model, spread, u, list(expectation.T), of_mass)
        return impact_quantities(model, data, u, shared, of_errors)

    made = jax.lax.map(one, (raw, about, error, keys))
    # Seven digits of a draw are more than it knows, and half the memory.
    return {name: jnp.moveaxis(values, 1, 0).astype(jnp.float32) for name, values in made.items()}


def _scores_of_some(
    prepared: Prepared, summarised: Approximation, draws: PopulationDraws
) -> Float[np.ndarray, "draw shown"]:
    """Log density of the traces of some impacts, every draw."""
    rows = some_impacts(len(prepared.data.log_mass))
    some = some_of(prepared, rows).data
    anchors = anchors_of(prepared.model, some.design, draws)
    anchors = anchors._replace(mean=anchors.mean[:, np.asarray(some.design.cell)])
    told = LikelihoodApproximation(*told_of_rows(summarised.summaries, summarised.profile, rows))
    besides = log_evidence_ratios(prepared.model, some, told, anchors)
    parts = [
        log_evidence(told.summaries, type(anchors)(*(part[begin : begin + _AT_ONCE] for part in anchors)))
        for begin in range(0, len(besides), _AT_ONCE)
    ]
    return besides + np.concatenate(parts)
