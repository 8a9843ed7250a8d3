"""A run of the chain: warm-up until the chains agree, then segments until there are draws enough.

All of it follows from the seed, segment by segment; a finished segment can be kept in a folder, from which a
later run of the same job goes on with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.chain.ending import Verdict, look
from bayestissue.inference.chain.moves import Acceptances, State, Steps, Tuning, transition
from bayestissue.inference.chain.settings import ChainSettings
from bayestissue.inference.chain.target import Target
from bayestissue.inference.chain.warm_up import Start, begin, retuned
from bayestissue.inference.execution.compiling import FULLY, by_row
from bayestissue.inference.factors.conditional import DRAWS, PopulationDraws
from bayestissue.inference.samplers.convergence import convergence
from bayestissue.padding import padded_impacts
from bayestissue.results import whole_file

Say = Callable[[str, int, int], None]
SETTINGS = ChainSettings()


@dataclass(frozen=True)
class ChainDraws:
    """The last half of all transitions since the warm-up, [chain, draw, ...], impacts before parameters.

    Attributes:
        y: hyperparameters, unconstrained.
        b: fixed and group effects.
        u: each impact's parameters.
        log_likelihood: of all traces.
        acceptance: of each move, the mean.
        sites: of the traces, the first of each, as the warm-up left them.
        segments: of the warm-up, and since.
        segment: transitions of one.
        verdict: of the last look.
    """

    y: Float[np.ndarray, "chain draw hyperparameter"]
    b: Float[np.ndarray, "chain draw location"]
    u: Float[np.ndarray, "chain draw impact parameter"]
    log_likelihood: Float[np.ndarray, "chain draw"]
    acceptance: dict[str, float]
    sites: GaussianFactor
    segments: tuple[int, int]
    segment: int
    verdict: Verdict

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of chains and of draws of each."""
        return self.y.shape[0], self.y.shape[1]

    def thinned(self, draws: int) -> ChainDraws:
        """The same with at most so many draws of each chain, evenly spaced, the last among them."""
        number = self.y.shape[1]
        rows = np.unique(np.linspace(number - 1, 0, min(draws, number)).round().astype(int))
        thinned = {name: getattr(self, name)[:, rows] for name in ("y", "b", "u", "log_likelihood")}
        return replace(self, **thinned)

    def population(self, model: TraceModel) -> PopulationDraws:
        """Hyperparameters and effects of all draws, one chain's after the other's."""
        y, b = (values.reshape(-1, values.shape[-1]) for values in (self.y, self.b))
        sites, precision = _constrained(model, y)
        return PopulationDraws(dict(zip(model.hyperparameters, y.T, strict=True)), sites, b, precision)

    def record(self) -> dict[str, Any]:
        """How the chain ran, as it stands in ``run.json``."""
        warm, since = self.segments
        moves = ", ".join(f"{name} {share:.0%}" for name, share in self.acceptance.items())
        return {
            "path": "chain",
            "words": (
                "Sampled by one Markov chain over hyperparameters, effects and impacts, "
                f"{since * self.segment} transitions of each chain after {warm * self.segment} of warm-up; "
                f"accepted: {moves}."
            ),
            "segments": since,
            "warm_up_segments": warm,
            "acceptance": self.acceptance,
        }


class _Segment(NamedTuple):
    """What one segment of one chain leaves."""

    state: State
    steps: Steps
    path: State
    rates: Acceptances


@by_row(DRAWS, constant=1)
def _constrained(model: TraceModel, y: Float[Array, " hyperparameter"]) -> tuple[dict[str, Array], Array]:
    """Constrained hyperparameters, and the precision of an impact's parameters about X b."""
    sites = constrained(model, dict(zip(model.hyperparameters, y, strict=True)))
    return sites, population(model, sites).of_impact()


@partial(jax.jit, static_argnames="settings", compiler_options=FULLY)
def _advanced(
    target: Target,
    settings: ChainSettings,
    tuning: Tuning,
    carried: tuple[State, Steps],
    key: Array,
    gain: Float[Array, ""],
) -> Any:
    keys = jax.random.split(key, settings.segment)
    return jax.lax.scan(partial(transition, target, settings, tuning, gain), carried, keys)


def chain_draws(
    prepared: Prepared,
    sites: GaussianFactor,
    chains: int,
    seed: int,
    *,
    settings: ChainSettings = SETTINGS,
    progress: Say = lambda *_: None,
    checkpoints: Path | None = None,
) -> ChainDraws:
    """Draws from the posterior of everything.

    Args:
        prepared: model and data.
        sites: of the traces, [site, impact, ...]; the chain is exact whatever they are, and faster the
            nearer they are.
        chains: how many there are.
        seed: of all of it.
        settings: how long its parts are.
        progress: told the stage, how much of it is done, and its total.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.
    """
    target, count = Target.from_prepared(prepared), len(prepared.impacts)
    keys = jax.random.split(jax.random.PRNGKey(seed), chains)
    # Filled up with copies of the first, which count nowhere.
    start = begin(target, settings, GaussianFactor(*map(jnp.asarray, padded_impacts(sites, 1))), keys)
    chains_at = list(zip(start.states, start.steps, strict=True))
    run = _Run(target, settings, keys, chains_at, checkpoints)
    tuning = _warmed_up(run, start, progress)
    warm = run.number
    drawn, rates, verdict = _sampled(run, tuning, count, progress)
    first = GaussianFactor(*(np.asarray(leaf)[0, :count] for leaf in tuning.sites))
    acceptance = {name: float(np.mean([getattr(r, name) for r in rates])) for name in Acceptances._fields}
    return ChainDraws(
        y=np.asarray(drawn.y),
        b=np.asarray(drawn.b),
        u=np.moveaxis(np.asarray(drawn.u), -1, -2),
        log_likelihood=np.asarray(drawn.log_likelihood).sum(-1),
        acceptance=acceptance,
        sites=first,
        segments=(warm, run.number - warm),
        segment=settings.segment,
        verdict=verdict,
    )


@dataclass
class _Run:
    """All chains, as far as they have come.

    Attributes:
        target: the posterior.
        settings: of the run.
        keys: of each chain.
        carried: each chain's state and steps.
        checkpoints: where finished segments are kept, if anywhere.
        number: of the next segment.
    """

    target: Target
    settings: ChainSettings
    keys: Array
    carried: list[tuple[State, Steps]]
    checkpoints: Path | None
    number: int = 0

    def advance(self, tuning: Tuning, gain: float) -> list[_Segment]:
        """The next segment of every chain."""
        segments = [self._segment(chain, tuning, gain) for chain in range(len(self.keys))]
        self.carried = [(segment.state, segment.steps) for segment in segments]
        self.number += 1
        return segments

    def _segment(self, chain: int, tuning: Tuning, gain: float) -> _Segment:
        path = self.checkpoints and self.checkpoints / f"chain-{chain}-segment-{self.number:04d}.npz"
        if path is not None and path.is_file():
            return _read(path, self.carried[chain])
        # The numbers below are the beginning's.
        key = jax.random.fold_in(self.keys[chain], 1000 + self.number)
        (state, steps), (visited, rates) = _advanced(
            self.target, self.settings, tuning, self.carried[chain], key, gain
        )
        segment: _Segment = jax.device_get(_Segment(state, steps, visited, rates))
        if path is not None:
            _write(path, segment)
        return segment


def _warmed_up(run: _Run, start: Start, progress: Say) -> Tuning:
    """Rounds until the chains agree, and one more that adapts steps alone; what they found."""
    settings, tuning = run.settings, start.tuning
    rounds = (*settings.first_rounds, *(settings.round,) * settings.most_rounds)
    for turn, length in enumerate(rounds):
        segments = []
        for _ in range(length):
            least = sum(settings.first_rounds) + 2 * settings.round
            progress("warming up", run.number, max(least, run.number + settings.round))
            segments.append(run.advance(tuning, settings.gain))
        visited = _joined(segments)
        half = jax.tree.map(lambda leaf: leaf[:, leaf.shape[1] // 2 :].reshape(-1, *leaf.shape[2:]), visited)
        tuning = retuned(tuning, start.tuning, half, refit=turn > 0)
        r_hat = convergence(np.moveaxis(np.asarray(visited.y), -1, 0)).r_hat
        if turn >= len(settings.first_rounds) and np.nanmax(r_hat) < settings.agreement:
            break
    for _ in range(settings.round):
        progress("warming up", run.number, run.number + settings.round)
        run.advance(tuning, settings.last_gain)
    return tuning


def _sampled(
    run: _Run, tuning: Tuning, count: int, progress: Say
) -> tuple[State, list[Acceptances], Verdict]:
    """Segments until there are draws enough: the last half of them, acceptances, and the last look."""
    settings, next_look, in_a_row = run.settings, run.settings.first_look, 0
    paths: list[State] = []
    rates: list[Acceptances] = []
    while True:
        progress("sampling", len(paths), next_look)
        segments = run.advance(tuning, 0.0)
        paths.append(_trimmed(_joined([segments]), count))
        rates.append(jax.tree.map(lambda *values: np.mean(values), *[s.rates for s in segments]))
        if len(paths) < next_look:
            continue
        last_half = paths[len(paths) // 2 :]
        drawn: State = jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *last_half)
        verdict = look(*_quantities(drawn))
        in_a_row = in_a_row + 1 if verdict.passed else 0
        if in_a_row >= settings.in_a_row or len(paths) >= settings.most:
            return drawn, rates, verdict
        next_look = min(int(np.ceil(settings.growth * next_look)), settings.most)


def _joined(segments: list[list[_Segment]]) -> State:
    """Segments one after the other, chains along the first axis."""
    paths = [[segment.path for segment in chains] for chains in segments]
    stacked = [jax.tree.map(lambda *chains: np.stack(chains), *part) for part in paths]
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *stacked)


def _trimmed(visited: State, count: int) -> State:
    """Without the impacts that fill up."""
    u, log_likelihood = visited.u[..., :count], visited.log_likelihood[..., :count]
    return visited._replace(u=u, log_likelihood=log_likelihood)


def _quantities(drawn: State) -> tuple[np.ndarray, np.ndarray]:
    """Hyperparameters and effects, and impacts' parameters, [quantity, chain, draw]."""
    population = np.concatenate([drawn.y, drawn.b], axis=-1)
    impacts = np.reshape(drawn.u, (*drawn.u.shape[:2], -1))
    return np.moveaxis(population, -1, 0), np.moveaxis(impacts, -1, 0)


def _write(path: Path, segment: _Segment) -> None:
    arrays = {f"{number}": leaf for number, leaf in enumerate(jax.tree.leaves(segment))}
    with whole_file(path) as staging, staging.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def _read(path: Path, like: tuple[State, Steps]) -> _Segment:
    state, steps = like
    none = jnp.zeros(())
    structure = jax.tree.structure(_Segment(state, steps, state, Acceptances(*[none] * 5)))
    with np.load(path, allow_pickle=False) as stored:
        leaves = [stored[f"{number}"] for number in range(len(stored.files))]
    segment: _Segment = jax.tree.unflatten(structure, leaves)
    return segment
