"""Draws from the posterior of hyperparameters, effects and every impact's parameters, by one Markov chain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.chain.ending import Verdict
from bayestissue.inference.chain.moves import Acceptances, State, Steps, Tuning, Visited, transition
from bayestissue.inference.chain.run import (
    Chains,
    Say,
    Segment,
    read_arrays,
    sampled,
    warmed_up,
    write_arrays,
)
from bayestissue.inference.chain.settings import FEW, FIRST, ChainSettings
from bayestissue.inference.chain.target import LogRatios, Target
from bayestissue.inference.chain.warm_up import begin, retuned
from bayestissue.inference.execution.compiling import FULLY, by_row
from bayestissue.inference.execution.kept import evenly_spaced, some_impacts, some_of
from bayestissue.inference.factors.conditional import DRAWS, PopulationDraws
from bayestissue.padding import padded_impacts


class ChainEnd(NamedTuple):
    """Where the chains of a run ended: all that another run needs to go on as if this one had not stopped.

    Attributes:
        state: of each chain, [chain, ...].
        steps: likewise.
        tuning: of all of them.
        segments: how many each had, those of the warm-up and of earlier runs included.
        continued: whether there was an earlier run.
    """

    state: State
    steps: Steps
    tuning: Tuning
    segments: Int[np.ndarray, ""]
    continued: Bool[np.ndarray, ""]

    def write(self, path: Path) -> None:
        """Write all of it to a file, which is there when it is whole."""
        write_arrays(path, self)

    @classmethod
    def read(cls, path: Path) -> ChainEnd:
        """What `write` wrote.

        Raises:
            KeyError: it is the file of a version whose chains had other parts.
            ValueError: it is damaged.
        """
        none: Any = np.zeros(0)
        state, steps = _of_nothing(State), _of_nothing(Steps)
        tuning = Tuning(_of_nothing(GaussianFactor), none, none)
        end: ChainEnd = read_arrays(path, cls(state, steps, tuning, none, none))
        return end


@dataclass(frozen=True)
class ChainDraws:
    """The last half of all transitions since the warm-up, [chain, draw, ...], impacts before parameters.

    Attributes:
        y: hyperparameters, unconstrained.
        b: fixed and group effects.
        log_likelihood: of all traces.
        log_ratios: log of likelihood over site of each impact that is shown, under "impact", and its sum over
            the levels of each grouping.
        impact_draws: numbers of the draws of which there is ``u``.
        u: each impact's parameters.
        acceptance: of each move, the mean.
        sites: of the traces, the first of each, as the warm-up left them.
        end: where the chains ended, from which another run goes on.
        segments: since the warm-up, or since an earlier run that this one goes on with.
        segment: transitions of one.
        verdict: of the last look.
    """

    y: Float[np.ndarray, "chain draw hyperparameter"]
    b: Float[np.ndarray, "chain draw location"]
    log_likelihood: Float[np.ndarray, "chain draw"]
    log_ratios: dict[str, Float[np.ndarray, "chain draw one"]]
    impact_draws: Int[np.ndarray, " kept"]
    u: Float[np.ndarray, "chain kept impact parameter"]
    acceptance: dict[str, float]
    sites: GaussianFactor
    end: ChainEnd
    segments: int
    segment: int
    verdict: Verdict

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of chains and of draws of each."""
        return self.y.shape[0], self.y.shape[1]

    def thinned(self, draws: int) -> ChainDraws:
        """The same with at most so many draws of each chain, evenly spaced, the last among them."""
        rows = evenly_spaced(self.y.shape[1], draws)
        among = np.isin(self.impact_draws, rows)
        return replace(
            self,
            **{name: getattr(self, name)[:, rows] for name in ("y", "b", "log_likelihood")},
            log_ratios={name: values[:, rows] for name, values in self.log_ratios.items()},
            impact_draws=np.searchsorted(rows, self.impact_draws[among]),
            u=self.u[:, among],
        )

    def population(self, model: TraceModel) -> PopulationDraws:
        """Hyperparameters and effects of all draws, one chain's after the other's."""
        y, b = (values.reshape(-1, values.shape[-1]) for values in (self.y, self.b))
        sites, precision = _constrained(model, y)
        return PopulationDraws(dict(zip(model.hyperparameters, y.T, strict=True)), sites, b, precision)

    def record(self) -> dict[str, Any]:
        """How the chain ran, as it stands in ``run.json``."""
        before = int(self.end.segments) - self.segments
        moves = ", ".join(f"{name} {share:.0%}" for name, share in self.acceptance.items())
        return {
            "words": (
                "Sampled by one Markov chain over hyperparameters, effects and impacts, "
                f"{self.segments * self.segment} transitions of each chain after {before * self.segment} "
                f"{'of earlier runs' if self.end.continued else 'of warm-up'}; accepted: {moves}."
            ),
            "segments": self.segments,
            ("earlier_segments" if self.end.continued else "warm_up_segments"): before,
            "acceptance": self.acceptance,
        }


@by_row(DRAWS, constant=1)
def _constrained(model: TraceModel, y: Float[Array, " hyperparameter"]) -> tuple[dict[str, Array], Array]:
    """Constrained hyperparameters, and the precision of an impact's parameters about X b."""
    sites = constrained(model, dict(zip(model.hyperparameters, y, strict=True)))
    return sites, population(model, sites).of_impact()


class Track(NamedTuple):
    """Where a chain has been.

    Attributes:
        visited: what is kept of every state.
        u: of every so many states each impact's parameters.
        log_likelihood: of each trace there.
    """

    visited: Visited
    u: Float[Array, "kept parameter impact"]
    log_likelihood: Float[Array, "kept impact"]

    @property
    def y(self) -> Float[Array, "draw hyperparameter"]:
        """Hyperparameters of every state."""
        return self.visited.y


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
    carried, (visited, rates, *of_impacts) = jax.lax.scan(until_kept, carried, keys)
    visited, rates = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), (visited, rates))
    return Segment(carried, Track(visited, *of_impacts), rates)


def chain_draws(
    prepared: Prepared,
    beginning: GaussianFactor | ChainEnd,
    sampler: Sampler,
    seed: int,
    *,
    settings: ChainSettings | None = None,
    progress: Say = lambda *_: None,
    checkpoints: Path | None = None,
) -> ChainDraws:
    """Draws from the posterior of everything.

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
    """
    count = len(prepared.impacts)
    chosen = settings or ChainSettings.of_size(count)
    if isinstance(beginning, ChainEnd):
        warm = _continued(prepared, beginning, sampler, seed, chosen, checkpoints)
    else:
        near = None
        if settings is None and count > FEW:
            near = _warm_of_some(prepared, beginning, sampler, seed, progress, checkpoints)
        warm = _warm(prepared, beginning, sampler, seed, chosen, progress, checkpoints, near)
    quantities = partial(_quantities, prepared.model)
    trim = partial(_trimmed, count=count, keep=chosen.keep)
    drawn = sampled(warm.chains, warm.tuning, quantities, progress, sampler=sampler, trim=trim)
    visited = drawn.path.visited
    of_groups = zip(prepared.design.groupings.items(), visited.log_ratios.groups, strict=True)
    groups = {name: values[..., : len(grouping.levels)] for (name, grouping), values in of_groups}
    return ChainDraws(
        y=visited.y,
        b=visited.b,
        log_likelihood=visited.log_likelihood,
        log_ratios={"impact": visited.log_ratios.impacts[..., :count], **groups},
        impact_draws=np.arange(chosen.keep - 1, visited.y.shape[1], chosen.keep),
        u=np.moveaxis(drawn.path.u, -1, -2),
        acceptance=dict(drawn.rates._asdict()),
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
        narrower = np.sqrt(near.impacts / count)
        tuning = start.tuning._replace(root=narrower * np.asarray(near.tuning.root))
        start = start._replace(states=states, tuning=tuning)
    carried = list(zip(start.states, start.steps, strict=True))
    run = Chains(partial(_advanced, target, settings), settings, keys, carried, checkpoints, _like(target))

    def next_tuning(tuning: Tuning, visited: Track, first: bool) -> Tuning:
        return retuned(tuning, start.tuning, visited, refit=not first)

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
    advance, number = partial(_advanced, target, settings), int(end.segments)
    run = Chains(advance, settings, keys, carried, checkpoints, _like(target), number)
    tuning = jax.tree.map(jnp.asarray, end.tuning)
    return Warm(run, tuning, len(prepared.impacts))


def _end(warm: Warm, *, continued: bool) -> ChainEnd:
    """Where chains are."""
    state, steps = jax.tree.map(lambda *of_chains: np.stack(of_chains), *warm.chains.carried)
    tuning = jax.tree.map(np.asarray, warm.tuning)
    return ChainEnd(state, steps, tuning, np.asarray(warm.chains.number), np.asarray(continued))


def _of_nothing(kind: Any) -> Any:
    """A structure whose arrays are of no account."""
    return kind(*[np.zeros(0)] * len(kind._fields))


def _like(target: Target) -> Segment:
    """A segment's structure."""
    none: Any = np.zeros(0)
    visited = Visited(none, none, none, LogRatios(none, (none,) * len(target.groups)))
    carried = (_of_nothing(State), _of_nothing(Steps))
    return Segment(carried, Track(visited, none, none), _of_nothing(Acceptances))


def _trimmed(path: Track, count: int, keep: int) -> Track:
    """Without the impacts that fill up, and of many impacts in single precision."""
    u = path.u[..., :count]
    return path._replace(
        u=u if keep == 1 else u.astype(np.float32), log_likelihood=path.log_likelihood[..., :0]
    )


def _quantities(model: TraceModel, path: Track) -> tuple[np.ndarray, np.ndarray]:
    """Hyperparameters and effects, and parameters of the impacts that are shown, [quantity, chain, draw]."""
    y = np.asarray(path.y)
    values = _constrained(model, y.reshape(-1, y.shape[-1]))[0]
    spreads = np.stack([values[name] for name in model.hyperparameters], axis=-1).reshape(y.shape)
    population = np.concatenate([spreads, np.asarray(path.visited.b)], axis=-1)
    u = np.asarray(path.u)[..., some_impacts(path.u.shape[-1])]
    return np.moveaxis(population, -1, 0), np.moveaxis(u.reshape(*u.shape[:2], -1), -1, 0)
