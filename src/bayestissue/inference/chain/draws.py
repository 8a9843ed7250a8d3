"""Draws from the posterior of hyperparameters, effects and every impact's parameters, by one Markov chain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.base.padding import padded_impacts
from bayestissue.base.result import Say
from bayestissue.inference.chain.chain_settings import FIRST, TOGETHER, ChainSettings
from bayestissue.inference.chain.moves import State, Steps, Tuning, Visited, transition
from bayestissue.inference.chain.results import ChainDraws, ChainEnd, constrained
from bayestissue.inference.chain.run import Chains, Segment, sampled, warmed_up
from bayestissue.inference.chain.target import Target
from bayestissue.inference.chain.warm_up import begin, retuned
from bayestissue.inference.execution.compiling import FULLY
from bayestissue.inference.execution.kept import all_kept, evenly_spaced, some_impacts, some_of
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import Population
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.model.hierarchy.trace_data import Prepared


@partial(jax.jit, static_argnames="settings", compiler_options=FULLY)
def _advanced(
    target: Target,
    settings: ChainSettings,
    tuning: Tuning,
    carried: tuple[State, Steps],
    key: Array,
    gain: Float[Array, ""],
) -> Segment:
    one = partial(transition, target, settings, tuning, gain)

    def until_kept(carried: tuple[State, Steps], keys: Array) -> Any:
        carried, (visited, rates) = jax.lax.scan(one, carried, keys)
        return carried, (visited, rates, carried[0].u, carried[0].log_likelihood)

    keys = jax.random.split(key, settings.segment).reshape(-1, settings.keep, 2)
    carried, (visited, rates, u, traces) = jax.lax.scan(until_kept, carried, keys)
    visited, rates = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), (visited, rates))
    return Segment(carried, visited._replace(u=u, traces=traces), rates)


def chain_draws(
    prepared: Prepared,
    beginning: GaussianFactor | ChainEnd,
    sampler: Sampler,
    seed: int,
    *,
    settings: ChainSettings | None = None,
    progress: Say = lambda *_: None,
    checkpoints: Path | None = None,
) -> Iterator[ChainDraws]:
    """Draws from the posterior of everything, and more of them as long as the caller asks.

    Args:
        prepared: model and data.
        beginning: sites of the traces, [site, impact, ...]; the chain is exact whatever they are, and faster
            the nearer they are. Or where an earlier run of this model and these data ended, to go on with it.
        sampler: how many chains, and how many effective draws.
        seed: of all of it.
        settings: how long its parts are; those for so many impacts unless given.
        progress: told the stage, how much of it is done, and its total.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.

    Yields:
        draws that are enough by hyperparameters, effects and parameters of impacts. Where what follows from
        these is still rough, the next come from a longer run; the last have the most transitions.
    """
    count = len(prepared.impacts)
    chosen = settings or ChainSettings.of_size(count)
    if isinstance(beginning, ChainEnd):
        warm = _continued(prepared, beginning, sampler, seed, chosen, checkpoints)
    else:
        near = None
        if settings is None and count > TOGETHER:
            near = _warm_of_some(prepared, beginning, sampler, seed, progress, checkpoints)
        warm = _warm(prepared, beginning, sampler, seed, chosen, progress, checkpoints, near)
    looked_at = partial(_looked_at, names=prepared.model.hyperparameters)
    trim = partial(_trimmed, prepared=prepared)
    for drawn in sampled(warm.chains, warm.tuning, looked_at, progress, sampler=sampler, trim=trim):
        path: Trimmed = drawn.path
        yield ChainDraws(
            **path._asdict(),
            impact_draws=np.arange(chosen.keep - 1, path.log_likelihood.shape[1], chosen.keep),
            acceptance={name: rate for name, rate in drawn.rates._asdict().items() if np.isfinite(rate)},
            sites=GaussianFactor(*(np.asarray(leaf)[0, :count] for leaf in warm.tuning.sites)),
            end=_end(warm, continued=isinstance(beginning, ChainEnd)),
            segments=drawn.segments,
            segment=chosen.segment,
            verdict=drawn.verdict,
        )


class Warm(NamedTuple):
    """Chains that agree, with what they learned.

    Attributes:
        chains: at the end of their warm-up.
        tuning: that stays.
        impacts: how many there are.
    """

    chains: Chains
    tuning: Tuning
    impacts: int


def _warm(
    prepared: Prepared,
    sites: GaussianFactor,
    sampler: Sampler,
    seed: int,
    settings: ChainSettings,
    progress: Say,
    checkpoints: Path | None,
    near: Warm | None = None,
) -> Warm:
    """The warm-up of `chain_draws`, begun where that of some of the impacts ended, if there was one."""
    target, count = Target.from_prepared(prepared), len(prepared.impacts)
    keys = jax.random.split(jax.random.PRNGKey(seed), sampler.chains)
    # Filled up with copies of the first, which count nowhere.
    padded = GaussianFactor(*map(jnp.asarray, padded_impacts(sites, 1)))
    start = begin(target, padded, sampler.chains, np.random.default_rng(seed))
    if near is not None:
        previous = [state for state, _ in near.chains.carried]
        states = [
            state._replace(y=last.y, b=last.b) for state, last in zip(start.states, previous, strict=True)
        ]
        narrower, population = np.sqrt(near.impacts / count), near.tuning.population
        population = population._replace(root=narrower * np.asarray(population.root))
        tuning = start.tuning._replace(population=population)
        start = start._replace(states=states, tuning=tuning)
    carried = jax.device_get(list(zip(start.states, start.steps, strict=True)))
    run = Chains(_advanced, (target, settings), settings, keys, carried, checkpoints)

    def next_tuning(tuning: Tuning, visited: Visited, first: bool) -> Tuning:
        return retuned(target, tuning, start.tuning, visited, refit=not first)

    return Warm(run, warmed_up(run, start.tuning, next_tuning, progress), count)


def _warm_of_some(
    prepared: Prepared,
    sites: GaussianFactor,
    sampler: Sampler,
    seed: int,
    progress: Say,
    checkpoints: Path | None,
) -> Warm:
    """The warm-up of `FIRST` impacts alone, from which that of very many begins."""
    rows = evenly_spaced(len(prepared.impacts), FIRST)
    part = GaussianFactor(*(np.asarray(leaf)[:, rows] for leaf in sites))
    folder = checkpoints and checkpoints / "part"
    if folder:
        folder.mkdir(exist_ok=True)
    return _warm(some_of(prepared, rows), part, sampler, seed, ChainSettings(), progress, folder)


def _continued(
    prepared: Prepared,
    end: ChainEnd,
    sampler: Sampler,
    seed: int,
    settings: ChainSettings,
    checkpoints: Path | None,
) -> Warm:
    """The chains of an earlier run where they ended, with what they had learned."""
    target, chains = Target.from_prepared(prepared), range(sampler.chains)
    keys = jax.random.split(jax.random.PRNGKey(seed), sampler.chains)
    carried = [
        jax.tree.map(lambda leaf, chain=chain: np.asarray(leaf[chain]), (end.state, end.steps))
        for chain in chains
    ]
    number = int(end.segments)
    run = Chains(_advanced, (target, settings), settings, keys, carried, checkpoints, number)
    tuning = jax.tree.map(jnp.asarray, end.tuning)
    return Warm(run, tuning, len(prepared.impacts))


def _end(warm: Warm, *, continued: bool) -> ChainEnd:
    """Where chains are."""
    state, steps = jax.tree.map(lambda *of_chains: np.stack(of_chains), *warm.chains.carried)
    tuning = jax.tree.map(np.asarray, warm.tuning)
    return ChainEnd(state, steps, tuning, np.asarray(warm.chains.number), np.asarray(continued))


class Trimmed(NamedTuple):
    """What is kept of the states since the warm-up; see `ChainDraws`."""

    population: Population
    log_likelihood: Float[np.ndarray, "chain draw"]
    log_ratios: dict[str, Float[np.ndarray, "chain draw one"]]
    u: Float[np.ndarray, "chain kept impact parameter"]


def _trimmed(path: Visited, prepared: Prepared) -> Trimmed:
    """Without the impacts and levels that fill up, hyperparameters constrained."""
    y, b, log_likelihood, log_ratios, u, _ = jax.tree.map(np.asarray, path)
    count = len(prepared.impacts)
    of_groups = zip(prepared.design.groupings.items(), log_ratios.groups, strict=True)
    groups = {name: values[..., : len(grouping.levels)] for (name, grouping), values in of_groups}
    u = np.moveaxis(u[..., :count], -1, -2)
    return Trimmed(
        Population(constrained(prepared.model, y), b),
        log_likelihood,
        {"impact": log_ratios.impacts[..., :count], **groups},
        u if all_kept(count) else u.astype(np.float32),
    )


def _looked_at(path: Trimmed, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Hyperparameters and effects, and parameters of the impacts that are shown, [quantity, chain, draw]."""
    hyperparameters, b = path.population
    population = [*(hyperparameters[name] for name in names), *np.moveaxis(b, -1, 0)]
    u = np.moveaxis(path.u[:, :, some_impacts(path.u.shape[2])], (3, 2), (0, 1))
    return np.stack(population), u.reshape(-1, *u.shape[2:])
