"""Segments of chains: warm-up until the chains agree, then segments until there are draws enough.

All of it follows from the seed, segment by segment; a finished segment can be kept in a folder, from which a
later run of the same job goes on with the same numbers. What a chain is made of is the caller's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from bayestissue.base import runtime
from bayestissue.base.result import Say, silent
from bayestissue.base.results.files import whole_file
from bayestissue.inference.chain.chain_settings import ChainSettings
from bayestissue.inference.chain.ending import LookVerdict, look
from bayestissue.inference.chain.moves import Kernel
from bayestissue.inference.samplers.sampling import Draws, convergence
from bayestissue.model.hierarchy.specification import Sampler

_DIGEST = "sha256"


class Segment(NamedTuple):
    """What one segment of one chain leaves.

    Attributes:
        carried: what the next one begins with.
        path: states, along a first axis, whose ``y`` are the hyperparameters.
        rates: acceptances of each transition.
    """

    carried: Any
    path: Any
    rates: Any


@dataclass
class Chains:
    """All chains, as far as they have come.

    Attributes:
        advance: compiled, one segment of one chain, of its kernel, what it carries and a key.
        target: their posterior.
        settings: of the run.
        keys: of each chain.
        tuning: what they have learned.
        carried: what each chain carries.
        checkpoints: where finished segments are kept, if anywhere.
        at_once: how many chains are computed at once, each in a thread; None: as many as there are cores.
        number: of the next segment.
        progress: told the stage, how many segments are done, and of how many.
    """

    advance: Any
    target: Any
    settings: ChainSettings
    keys: Array
    tuning: Any
    carried: list[Any]
    checkpoints: Path | None = None
    at_once: int | None = None
    number: int = 0
    progress: Say = silent

    def next(self, gain: float) -> list[Segment]:
        """The next segment of every chain."""
        kernel = Kernel(self.target, self.settings, self.tuning, gain)
        chains = range(len(self.keys))
        segments = list(runtime.in_threads(lambda chain: self._segment(chain, kernel), chains, self.at_once))
        self.carried = [segment.carried for segment in segments]
        self.number += 1
        return segments

    def _segment(self, chain: int, kernel: Kernel) -> Segment:
        path = self.checkpoints and self.checkpoints / f"chain-{chain}-segment-{self.number:04d}.npz"
        key = jax.random.fold_in(self.keys[chain], self.number)
        arguments = kernel, self.carried[chain], key
        if path is not None and path.is_file():
            restored: Segment = read_arrays(path, self.advance.eval_shape(*arguments))
            return restored
        segment: Segment = jax.device_get(self.advance(*arguments))
        if path is not None:
            write_arrays(path, segment)
        return segment


def warm_up(chains: Chains, retuned: Callable[[Any, Any, bool], Any]) -> None:
    """Rounds until the chains agree, and one more that adapts steps alone.

    What is looked at and learned from after a round is the second half of all that was visited so far.

    Args:
        chains: at their beginning, with the tuning that they begin with; left at their end, with its own.
        retuned: the next tuning, of the present one, of what all chains visited, and whether it is that of
            the first round.
    """
    settings, visited = chains.settings, list[list[Segment]]()
    least = sum(settings.first_rounds) + settings.round
    for turn, length in enumerate(settings.rounds):
        for _ in range(length):
            chains.progress("warming up", chains.number, max(least, chains.number + 1) + settings.last_round)
            visited.append(chains.next(settings.gain))
        segments = sum(settings.rounds[: turn + 1])
        visited = visited[-(segments - segments // 2) :]
        half = joined(visited)
        of_all = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), half)
        chains.tuning = retuned(chains.tuning, of_all, turn == 0)
        r_hat = convergence(np.moveaxis(half.y, -1, 0)).r_hat
        if turn >= len(settings.first_rounds) and np.nanmax(r_hat) < settings.agreement:
            break
    for left in range(settings.last_round, 0, -1):
        chains.progress("warming up", chains.number, chains.number + left)
        chains.next(settings.last_gain)


class Sampled(NamedTuple):
    """What a run leaves.

    Attributes:
        path: the states since the warm-up, without the first of them, [chain, draw, ...].
        rates: mean acceptances of these, by kind.
        segments: since the warm-up.
        verdict: of the last look.
    """

    path: Any
    rates: Any
    segments: int
    verdict: LookVerdict


def sampled(
    chains: Chains,
    quantities: Callable[[Any], tuple[Draws, Draws]],
    *,
    sampler: Sampler,
    trim: Callable[[Any], Any] = lambda path: path,
) -> Iterator[Sampled]:
    """Segments until there are draws enough, and until there are more as long as the caller asks for them.

    Args:
        chains: warmed up; their tuning stays.
        quantities: of states [chain, draw, ...] what is looked at: see `look`.
        sampler: how many effective draws are wanted, and how many transitions are the most.
        trim: takes off a segment's states what is not to be kept.

    Yields:
        what there is each time that looks pass, and what there is after the most transitions, the last.
    """
    settings, in_a_row = chains.settings, 0
    most = -(-sampler.transitions // settings.segment)
    next_look = min(settings.first_look, most)
    stage, paths, rates = "sampling", list[Any](), list[Any]()
    while True:
        chains.progress(stage, len(paths), next_look)
        segments = chains.next(0.0)
        paths.append(trim(joined([segments])))
        rates.append(jax.tree.map(_mean, *[segment.rates for segment in segments]))
        if len(paths) < next_look:
            continue
        retained = paths[int(settings.dropped * len(paths)) :]
        path = jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *retained)
        verdict = look(*quantities(path), sampler.effective)
        in_a_row = in_a_row + 1 if verdict.passed else 0
        effective = f"{verdict.effective:.0f} effective draws ({sampler.effective} wanted)"
        stage = f"sampling, R-hat {verdict.r_hat:.3f}, {effective}"
        last = len(paths) >= most
        if in_a_row >= settings.in_a_row or last:
            yield Sampled(path, jax.tree.map(_mean, *rates), len(paths), verdict)
            in_a_row = 0
        if last:
            return
        next_look = min(int(np.ceil(settings.growth * next_look)), most)


def _mean(*rates: Any) -> float:
    """Of the numbers among them, none where there is none."""
    values = np.ravel(rates)
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else float("nan")


def joined(segments: list[list[Segment]]) -> Any:
    """The states of segments one after the other, chains along the first axis."""
    paths = [[segment.path for segment in of_chains] for of_chains in segments]
    stacked = [jax.tree.map(lambda *chains: np.stack(chains), *part) for part in paths]
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *stacked)


def write_arrays(path: Path, tree: Any) -> None:
    """A file of all arrays of a structure, each by where it stands in it; there when it is whole."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    arrays = {jax.tree_util.keystr(where): np.asarray(leaf) for where, leaf in leaves}
    with whole_file(path) as staging, staging.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays, **{_DIGEST: _digest(arrays)})


def _digest(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """By which other arrays under the same names are known, and other shapes."""
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(f"{name}{array.shape}{array.dtype}".encode())
        digest.update(array.tobytes())
    return np.frombuffer(digest.digest(), np.uint8)


def read_arrays(path: Path, like: Any) -> Any:
    """What `write_arrays` wrote, of the structure of ``like``.

    Raises:
        KeyError: the file holds another structure's.
        ValueError, BadZipFile: the file is damaged, or not as it was written.
    """
    with np.load(path, allow_pickle=False) as stored:
        arrays = dict(stored)
    if (arrays.pop(_DIGEST) != _digest(arrays)).any():
        raise ValueError(path)
    return jax.tree_util.tree_map_with_path(lambda where, _: arrays[jax.tree_util.keystr(where)], like)
