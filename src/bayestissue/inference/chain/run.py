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
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.chain.ending import Verdict, look
from bayestissue.inference.chain.moves import Acceptances, State, Steps, Tuning, transition
from bayestissue.inference.chain.target import Target
from bayestissue.inference.chain.warm_up import begin, retuned
from bayestissue.inference.execution.compiling import FULLY, by_row
from bayestissue.inference.factors.conditional import DRAWS, PopulationDraws
from bayestissue.inference.samplers.convergence import convergence
from bayestissue.padding import padded_impacts
from bayestissue.results import whole_file

Say = Callable[[str, int, int], None]
SEGMENT = 100
# Segments of the first rounds, then of each further one; steps follow acceptances by so much.
_ROUNDS, _FURTHER = (2, 2, 3), 3
_GAIN, _LAST_GAIN = 0.1, 0.03
# The warm-up is over where the hyperparameters' R-hat over its last round is below this.
_AGREE, _MOST_ROUNDS = 1.05, 20
# Looks begin after so many segments, and come at lengths that grow by a quarter; two in a row are to pass.
_FIRST_LOOK, _GROWTH, _IN_A_ROW = 10, 1.25, 2
# Of the segments since the warm-up: the most.
_MOST = 400


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
        verdict: of the last look.
    """

    y: Float[np.ndarray, "chain draw hyperparameter"]
    b: Float[np.ndarray, "chain draw location"]
    u: Float[np.ndarray, "chain draw impact parameter"]
    log_likelihood: Float[np.ndarray, "chain draw"]
    acceptance: dict[str, float]
    sites: GaussianFactor
    segments: tuple[int, int]
    verdict: Verdict

    def thinned(self, draws: int) -> ChainDraws:
        """The same with at most so many draws of each chain, evenly spaced, the last among them."""
        number = self.y.shape[1]
        kept = np.unique(np.linspace(number - 1, 0, min(draws, number)).round().astype(int))
        each = {name: getattr(self, name)[:, kept] for name in ("y", "b", "u", "log_likelihood")}
        return replace(self, **each)

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
                f"Sampled by one Markov chain over hyperparameters, effects and impacts, {since * SEGMENT} "
                f"transitions of each chain after {warm * SEGMENT} of warm-up; accepted: {moves}."
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


@partial(jax.jit, compiler_options=FULLY)
def _segment(
    target: Target, tuning: Tuning, carried: tuple[State, Steps], key: Array, gain: Float[Array, ""]
) -> Any:
    keys = jax.random.split(key, SEGMENT)
    return jax.lax.scan(partial(transition, target, tuning, gain), carried, keys)


def chain_draws(
    prepared: Prepared,
    sites: GaussianFactor,
    settings: Sampler,
    seed: int,
    *,
    progress: Say = lambda *_: None,
    checkpoints: Path | None = None,
) -> ChainDraws:
    """Draws from the posterior of everything.

    Args:
        prepared: model and data.
        sites: of the traces, [site, impact, ...]; the chain is exact whatever they are, and faster the
            nearer they are.
        settings: how many chains there are.
        seed: of all of it.
        progress: told the stage, how much of it is done, and its total.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.
    """
    target, count = Target.of(prepared), len(prepared.impacts)
    keys = jax.random.split(jax.random.PRNGKey(seed), settings.chains)
    # Filled up with copies of the first, which count nowhere.
    start = begin(target, GaussianFactor(*map(jnp.asarray, padded_impacts(sites, 1))), keys)
    chains = [(state, steps) for state, steps in zip(start.states, start.steps, strict=True)]
    tuning, number = start.tuning, 0

    def advance(gain: float) -> list[_Segment]:
        """The next segment of every chain."""
        nonlocal number
        done = []
        for chain, key in enumerate(keys):
            path = checkpoints and checkpoints / f"chain-{chain}-segment-{number:04d}.npz"
            like = chains[chain]
            segment = _kept(path, like) if path is not None and path.is_file() else None
            if segment is None:
                of_segment = jax.random.fold_in(key, 1000 + number)
                (state, steps), (visited, rates) = _segment(target, tuning, like, of_segment, gain)
                segment = jax.device_get(_Segment(state, steps, visited, rates))
                if path is not None:
                    _keep(path, segment)
            chains[chain] = (segment.state, segment.steps)
            done.append(segment)
        number += 1
        return done

    total = sum(_ROUNDS) + 2 * _FURTHER
    for turn in range(len(_ROUNDS) + _MOST_ROUNDS):
        further = turn >= len(_ROUNDS)
        round_: list[list[_Segment]] = []
        for _ in range(_FURTHER if further else _ROUNDS[turn]):
            progress("warming up", number, max(total, number + _FURTHER))
            round_.append(advance(_GAIN))
        visited = _joined([[segment.path for segment in part] for part in round_])
        half = jax.tree.map(lambda leaf: leaf[:, leaf.shape[1] // 2 :].reshape(-1, *leaf.shape[2:]), visited)
        tuning = retuned(tuning, start.tuning, half, refit=turn > 0)
        if further and np.nanmax(convergence(np.moveaxis(visited.y, -1, 0)).r_hat) < _AGREE:
            break
    for _ in range(_FURTHER):
        progress("warming up", number, number + _FURTHER)
        advance(_LAST_GAIN)
    warm = number
    paths: list[State] = []
    rates: list[Acceptances] = []
    next_look, passed, verdict = max(_FIRST_LOOK, 2), 0, None
    while True:
        progress("sampling", number - warm, next_look)
        segments = advance(0.0)
        paths.append(_trimmed(_joined([[segment.path for segment in segments]]), count))
        rates.append(jax.tree.map(lambda *values: np.mean(values), *[s.rates for s in segments]))
        if number - warm < next_look:
            continue
        kept = jax.tree.map(
            lambda *parts: np.concatenate(parts, axis=1), *paths[len(paths) - -(-len(paths) // 2) :]
        )
        verdict = look(*_quantities(kept))
        passed = passed + 1 if verdict.passed else 0
        if passed >= _IN_A_ROW or number - warm >= _MOST:
            break
        next_look = min(int(np.ceil(_GROWTH * next_look)), _MOST)
    acceptance = {name: float(np.mean([getattr(r, name) for r in rates])) for name in Acceptances._fields}
    first = GaussianFactor(*(np.asarray(leaf)[0, :count] for leaf in tuning.sites))
    u, log_likelihood = kept.u.transpose(0, 1, 3, 2), kept.log_likelihood.sum(-1)
    return ChainDraws(kept.y, kept.b, u, log_likelihood, acceptance, first, (warm, number - warm), verdict)


def _joined(parts: list[list[State]]) -> State:
    """Segments one after the other, chains along the first axis."""
    stacked = [jax.tree.map(lambda *chains: np.stack(chains), *part) for part in parts]
    return jax.tree.map(lambda *each: np.concatenate(each, axis=1), *stacked)


def _trimmed(visited: State, count: int) -> State:
    """Without the impacts that fill up."""
    u, log_likelihood = visited.u[..., :count], visited.log_likelihood[..., :count]
    return visited._replace(u=u, log_likelihood=log_likelihood)


def _quantities(kept: State) -> tuple[np.ndarray, np.ndarray]:
    """Hyperparameters and effects, and impacts' parameters, [quantity, chain, draw]."""
    population = np.concatenate([kept.y, kept.b], axis=-1)
    impacts = kept.u.reshape(*kept.u.shape[:2], -1)
    return np.moveaxis(population, -1, 0), np.moveaxis(impacts, -1, 0)


def _keep(path: Path, segment: _Segment) -> None:
    arrays = {f"{number}": leaf for number, leaf in enumerate(jax.tree.leaves(segment))}
    with whole_file(path) as staging, staging.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def _kept(path: Path, like: tuple[State, Steps]) -> _Segment:
    state, steps = like
    none = np.zeros(())
    structure = jax.tree.structure(_Segment(state, steps, state, Acceptances(*[none] * 5)))
    with np.load(path, allow_pickle=False) as stored:
        leaves = [stored[f"{number}"] for number in range(len(stored.files))]
    segment: _Segment = jax.tree.unflatten(structure, leaves)
    return segment
