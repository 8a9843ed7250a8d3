"""The posterior of the hierarchy over published estimates, by a chain like that of traces.

The hyperparameters walk on their posterior with everything linear integrated out and a Gaussian site in each
lost table's place, b is drawn from its conditional, and both are accepted together by the tables' factors
over their sites: `by_population` of `bayestissue.inference.chain.moves`, for which the tables are the traces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.base.result import Say, silent
from bayestissue.inference.chain.chain_settings import ChainSettings
from bayestissue.inference.chain.ending import LookVerdict
from bayestissue.inference.chain.moves import FREEDOM, Kernel, StudentT, WalkNumbers, followed, walk
from bayestissue.inference.chain.results import constrained
from bayestissue.inference.chain.run import Chains, Segment, sampled, warm_up
from bayestissue.inference.chain.warm_up import nearest_t, walk_start
from bayestissue.inference.execution.compiling import FULLY, by_row
from bayestissue.inference.samplers.sampling import flat
from bayestissue.model.hierarchy.gaussian.effects import effects_from_standard
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.thesis.reanalysis.table_model import (
    Coordinates,
    Effects,
    EstimatesData,
    EstimatesModel,
    PairPerTable,
    densities,
    integrated,
    leave_one_out,
)

SETTINGS = ChainSettings()
# Of chains that begin with what others learned from nearly the same data.
NEARBY = ChainSettings(first_rounds=(3,), last_round=1, most_rounds=0, first_look=6)
# Draws of one call.
POINTS = 64


class TableState(NamedTuple):
    """Where a chain is: hyperparameters, unconstrained, effects, and the scatter of each table's people."""

    y: Float[Any, " hyperparameter"]
    b: Float[Any, " location"]
    scatter: PairPerTable


class TableTuning(NamedTuple):
    """What the warm-up learns: a t near y's posterior, and where the tables' sites are made."""

    population: StudentT
    scatter: PairPerTable


@dataclass(frozen=True)
class EstimatesPosterior:
    """Draws of everything, [chain, draw, ...].

    Attributes:
        y: hyperparameters, unconstrained.
        hyperparameters: by name.
        b: the effects.
        rows: log density of every row's data.
        data: with the places at which the tables' sites were made.
        acceptance: share of transitions that were accepted.
        verdict: of the last look.
    """

    y: Float[np.ndarray, "chain draw hyperparameter"]
    hyperparameters: dict[str, Float[np.ndarray, "chain draw"]]
    b: Float[np.ndarray, "chain draw location"]
    rows: Float[np.ndarray, "chain draw row"]
    data: EstimatesData
    acceptance: float
    verdict: LookVerdict


def sample_posterior(
    model: EstimatesModel,
    data: EstimatesData,
    sampler: Sampler,
    seed: int,
    progress: Say = silent,
    *,
    near: EstimatesPosterior | None = None,
) -> EstimatesPosterior:
    """Draw from the posterior.

    Args:
        model: what is assumed.
        data: the rows.
        sampler: how many chains, and draws at most of each.
        seed: of all of it.
        progress: told the stage, how much of it is done, and its total.
        near: a posterior given nearly the same data, which the chains then begin at.
    """
    number, rng = len(model.hyperparameters), np.random.default_rng(seed)
    settings = SETTINGS if near is None else NEARBY
    nothing = np.zeros_like(data.scatter)
    begin, near_start, length = walk_start(sampler.chains, number, rng)
    tuning = TableTuning(near_start, nothing)
    if near is not None:
        drawn_near = flat(near.y)
        begin = rng.choice(drawn_near, sampler.chains, replace=False)
        tuning = TableTuning(nearest_t(drawn_near), near.data.scatter)
    states = [TableState(y, np.asarray(data.location_mean), nothing) for y in begin]
    keys = jax.random.split(jax.random.PRNGKey(seed), sampler.chains)
    carried = [(state, length) for state in states]
    chains = Chains(_advanced, (model, data), settings, keys, tuning, carried, progress=progress)

    def retuned(_: TableTuning, visited: TableState, first: bool) -> TableTuning:
        return TableTuning(nearest_t(visited.y), visited.scatter.mean(0))

    warm_up(chains, retuned)
    drawn = next(sampled(chains, _quantities, sampler=sampler))
    chosen = evenly_spaced(drawn.path.y.shape[1], sampler.draws)
    y, b = drawn.path.y[:, chosen], drawn.path.b[:, chosen]
    data = data._replace(scatter=chains.tuning.scatter)
    return EstimatesPosterior(
        y,
        constrained(model, y),
        b,
        densities_at(model, data, y, b).rows,
        data,
        drawn.rates,
        drawn.verdict,
    )


@partial(jax.jit, compiler_options=FULLY)
def _advanced(kernel: Kernel, carried: tuple[TableState, Array], key: Array) -> Segment:
    (model, data), settings, tuning = kernel.target, kernel.settings, kernel.tuning
    data = data._replace(scatter=tuning.scatter)

    def transition(carried: tuple[TableState, Array], key: Array) -> Any:
        state, length = carried
        keys, steps, number = jax.random.split(key, 5), settings.inner + 1, len(state.y)
        numbers = WalkNumbers(
            jax.random.normal(keys[0], (steps, number)),
            jax.random.normal(keys[4], (steps, number + FREEDOM)),
            jax.random.normal(keys[2], (model.locations.size,)),
            jax.random.uniform(keys[1], (steps,)),
        )
        density = partial(integrated, model, data)
        y, (_, effects), inner = walk(density, state.y, tuning.population, length, numbers)
        b = effects_from_standard(data.design, effects.conditional, data.location_mean, numbers.effects)
        here, there = densities(model, data, state.y, state.b), densities(model, data, y, b)
        accepted = jnp.log(jax.random.uniform(keys[3])) < there.log_ratio - here.log_ratio
        state = TableState(
            jnp.where(accepted, y, state.y),
            jnp.where(accepted, b, state.b),
            jnp.where(accepted, there.scatter, here.scatter),
        )
        length = followed(
            length, kernel.gain, inner - settings.population_acceptance, settings.population_steps
        )
        return (state, length), (state, jnp.where(accepted, 1.0, 0.0))

    of_segment = jax.lax.scan(transition, carried, jax.random.split(key, settings.segment))
    return Segment(of_segment[0], *of_segment[1])


def _quantities(path: TableState) -> tuple[np.ndarray, np.ndarray]:
    """Hyperparameters and effects, and nothing of impacts, [quantity, chain, draw]."""
    population = np.concatenate([path.y, path.b], axis=-1)
    return np.moveaxis(population, -1, 0), np.zeros((0, *path.y.shape[:2]))


# At every draw [chain, draw], as numpy arrays.
at_draws = by_row(POINTS, constant=2, axes=2)
densities_at, leave_one_out_at = at_draws(densities), at_draws(leave_one_out)


@at_draws
def effects_by_sites(
    model: EstimatesModel, data: EstimatesData, y: Coordinates, standard: Effects
) -> tuple[Effects, Float[Array, ""]]:
    """B from its conditional by the sites, and the log density with b integrated out, of every draw."""
    conditional, log_density = integrated(model, data, y)
    return effects_from_standard(data.design, conditional, data.location_mean, standard), log_density


def evidence_ratios(
    model: EstimatesModel, posterior: EstimatesPosterior, data: EstimatesData, seed: int
) -> Float[np.ndarray, " draw"]:
    """Log of what has the evidence of ``data`` over that of the posterior's own as its mean over the draws.

    The lost tables' factors over their sites are averaged over the effects that ``data`` say, one draw each.
    """
    y, b = posterior.y, posterior.b
    standard = np.random.default_rng([seed, 25]).standard_normal(b.shape)
    log_evidence = effects_by_sites(model, posterior.data, y, standard)[1]
    log_evidence = log_evidence + densities_at(model, posterior.data, y, b).log_ratio
    effects, log_evidence_of_data = effects_by_sites(model, data, y, standard)
    log_evidence_of_data = log_evidence_of_data + densities_at(model, data, y, effects).log_ratio
    return np.asarray(log_evidence_of_data - log_evidence).ravel()
