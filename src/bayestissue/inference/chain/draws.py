"""Draws from the posterior of hyperparameters, effects and every impact's parameters, by one Markov chain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P
from jaxtyping import Float

from bayestissue.base.impact_arrays import evenly_spaced, padded_impacts
from bayestissue.base.result import Say, silent
from bayestissue.inference.chain.chain_settings import FIRST, ChainSettings
from bayestissue.inference.chain.moves import Kernel, State, Steps, Tuning, Visited, transition
from bayestissue.inference.chain.results import ChainDraws, ChainEnd, constrained
from bayestissue.inference.chain.run import Chains, Segment, sampled, warm_up
from bayestissue.inference.chain.target import AXIS, FIELDS, Target
from bayestissue.inference.chain.warm_up import begin, retuned
from bayestissue.inference.execution.compiling import FULLY, compiled_quickly
from bayestissue.inference.execution.kept import all_kept, some_impacts, some_of
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import Population
from bayestissue.model.hierarchy.specification import Sampler
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import Hierarchy, hyperparameters_at


def _segment(kernel: Kernel, carried: tuple[State, Steps], key: Array) -> Segment:
    one, settings = partial(transition, kernel), kernel.settings

    def until_kept(carried: tuple[State, Steps], keys: Array) -> Any:
        carried, (visited, rates) = jax.lax.scan(one, carried, keys)
        return carried, (visited, rates, carried[0].u, carried[0].log_likelihood)

    keys = jax.random.split(key, settings.segment).reshape(-1, settings.keep, 2)
    carried, (visited, rates, u, traces) = jax.lax.scan(until_kept, carried, keys)
    visited, rates = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), (visited, rates))
    return Segment(carried, visited._replace(u=u, traces=traces), rates)


_advanced = jax.jit(_segment, compiler_options=FULLY)


def _of_devices(kernel: Kernel) -> Any:
    """`_advanced` of such a kernel, each device with its part of the impacts; all arguments are global."""
    # What is the same on all devices, and of impacts along some axis.
    same: Any = P()
    axes: list[Any] = [P(*[None] * axis, AXIS) for axis in range(3)]
    target, (first, second, third) = kernel.target, axes
    # Along which axes traces lie is seen where there is one more of them.
    one, two = (target.data.impacts(np.zeros(number, int)) for number in (1, 2))
    data = jax.tree.map(
        lambda a, b: P(*(AXIS if m < n else None for m, n in zip(a.shape, b.shape, strict=True))), one, two
    )
    of_impacts = {"data": data, "compressed": first, "present": first, "level": first}
    target = replace(target, **dict.fromkeys(FIELDS, same) | of_impacts)
    kernel = replace(kernel, target=target, tuning=Tuning(second, same, first, same, same, second), gain=same)
    carried = State(same, same, second, first), Steps(first, first, same, same, same)
    mesh = jax.make_mesh((target.shards,), (AXIS,), axis_types=(jax.sharding.AxisType.Auto,))
    segment = jax.shard_map(
        _segment,
        mesh=mesh,
        in_specs=(kernel, carried, same),
        out_specs=Segment(carried, Visited(same, same, same, same, third, second), same),
        check_vma=False,
    )
    return jax.jit(segment, compiler_options=FULLY, out_shardings=NamedSharding(mesh, same))


class ChainJob(NamedTuple):
    """What chains are to be run.

    Attributes:
        prepared: model and data.
        sampler: how many chains, and how many effective draws.
        seed: of all of it.
        progress: told the stage, how much of it is done, and its total.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.
    """

    prepared: Prepared
    sampler: Sampler
    seed: int
    progress: Say = silent
    checkpoints: Path | None = None

    def chains(self, target: Target, settings: ChainSettings, tuning: Tuning, carried: list[Any]) -> Chains:
        """Its chains, which carry what is given on."""
        keys, folder = jax.random.split(jax.random.PRNGKey(self.seed), self.sampler.chains), self.checkpoints
        chains = Chains(_advanced, target, settings, keys, tuning, carried, folder, progress=self.progress)
        shared = target.shared_out()
        if shared.shards == 1:
            return chains
        # Devices wait for one another: all have to begin the same chain.
        advance = _of_devices(Kernel(shared, settings, tuning))
        return replace(chains, advance=advance, target=jax.device_get(shared), at_once=1)


def chain_draws(
    job: ChainJob, beginning: GaussianFactor | ChainEnd, settings: ChainSettings | None = None
) -> Iterator[ChainDraws]:
    """Draws from the posterior of everything, and more of them as long as the caller asks.

    Args:
        job: what is to be run.
        beginning: sites of the traces, [site, impact, ...]; the chain is exact whatever they are, and faster
            the nearer they are. Or where an earlier run of this model and these data ended, to go on with it.
        settings: how long its parts are; those for so many impacts unless given.

    Yields:
        draws that are enough by hyperparameters, effects and parameters of impacts. Where what follows from
        these is still rough, the next come from a longer run; the last have the most transitions.
    """
    prepared, sampler = job.prepared, job.sampler
    count = len(prepared.impacts)
    if isinstance(beginning, ChainEnd):
        chosen = settings or _settings(prepared, beginning.tuning)
        warm = _continued(job, beginning, chosen)
    else:
        near = None if settings or all_kept(count) else _warm_of_some(job, beginning)
        chosen = settings or _settings(prepared, near.tuning if near else None)
        warm = _warm(job, beginning, chosen, near)
    looked_at = partial(_looked_at, names=prepared.model.hyperparameters)
    trim = partial(_trimmed, prepared=prepared)
    for drawn in sampled(warm, looked_at, sampler=sampler, trim=trim):
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


def _settings(prepared: Prepared, tuning: Tuning | None) -> ChainSettings:
    """Those for so many impacts, by what a warm-up of some of them found.

    Traces are clear where nineteen of twenty tell K and C, all else as it is, to half of what impacts differ
    by, or less.
    """
    count = len(prepared.impacts)
    if tuning is None or all_kept(count):
        return ChainSettings.of_size(count)
    between = _pair(prepared.model, tuning.population.location)
    of_traces = np.linalg.inv(np.asarray(tuning.sites.precision[0])[:, :2, :2])
    share = np.diagonal(of_traces, axis1=1, axis2=2) / np.diagonal(between)
    return ChainSettings.of_size(count, clear=bool((np.quantile(share, 0.95, axis=0) < 0.25).all()))


@compiled_quickly
def _pair(model: Hierarchy, y: Float[Any, " hyperparameter"]) -> Float[Array, "2 2"]:
    """Covariance of an impact's log K and log C about X b."""
    return model.covariances(hyperparameters_at(model, y)[0]).pair_matrix


def _warm(
    job: ChainJob, sites: GaussianFactor, settings: ChainSettings, near: Chains | None = None
) -> Chains:
    """Chains that agree, begun where those of some of the impacts ended, if there were any."""
    target = Target.from_prepared(job.prepared)
    # Filled up with copies of the first, which count nowhere.
    padded = GaussianFactor(*map(jnp.asarray, padded_impacts(sites, 1)))
    carried, begun = begin(target, padded, job.sampler.chains, np.random.default_rng(job.seed))
    if near is not None:
        ends = zip(carried, near.carried, strict=True)
        carried = [(state._replace(y=last.y, b=last.b), steps) for (state, steps), (last, _) in ends]
        population = near.tuning.population
        narrower = np.sqrt(int(near.target.present.sum()) / len(job.prepared.impacts))
        population = population._replace(root=narrower * np.asarray(population.root))
        begun = begun._replace(population=population)
    chains = job.chains(target, settings, begun, jax.device_get(carried))
    warm_up(chains, lambda now, seen, first: retuned(target, now, begun, seen, refit=not first))
    return chains


def _warm_of_some(job: ChainJob, sites: GaussianFactor) -> Chains:
    """Those of `FIRST` impacts alone, from which the warm-up of many begins."""
    rows = evenly_spaced(len(job.prepared.impacts), FIRST)
    part = GaussianFactor(*(np.asarray(leaf)[:, rows] for leaf in sites))
    folder = job.checkpoints and job.checkpoints / "part"
    if folder:
        folder.mkdir(exist_ok=True)
    some = job._replace(prepared=some_of(job.prepared, rows), checkpoints=folder)
    return _warm(some, part, ChainSettings())


def _continued(job: ChainJob, end: ChainEnd, settings: ChainSettings) -> Chains:
    """The chains of an earlier run where they ended, with what they had learned."""
    carried = [
        jax.tree.map(lambda leaf, chain=chain: np.asarray(leaf[chain]), (end.state, end.steps))
        for chain in range(job.sampler.chains)
    ]
    tuning = jax.tree.map(jnp.asarray, end.tuning)
    chains = job.chains(Target.from_prepared(job.prepared), settings, tuning, carried)
    chains.number = int(end.segments)
    return chains


def _end(chains: Chains, *, continued: bool) -> ChainEnd:
    """Where chains are."""
    state, steps = jax.tree.map(lambda *of_chains: np.stack(of_chains), *chains.carried)
    tuning = jax.tree.map(np.asarray, chains.tuning)
    return ChainEnd(state, steps, tuning, np.asarray(chains.number), np.asarray(continued))


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
