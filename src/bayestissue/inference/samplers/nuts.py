"""Chains of the No-U-Turn sampler that can stop at any moment and go on as if they had not.

A chain advances in segments of fixed length, each one compiled call. After a segment its draws and the
chain's whole state can be written down; a later run reads them and continues with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpyro.infer import NUTS
from numpyro.infer.util import ParamInfo

from bayestissue import runtime
from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.execution.chunks import Progress, silent
from bayestissue.inference.execution.compiling import FULLY, compiled_quickly
from bayestissue.inference.samplers.sampling import STATISTICS, Draws
from bayestissue.results import scratch, whole_file

SEGMENT = 100
Arrays = dict[str, np.ndarray]


class Known(NamedTuple):
    """Points of one site, and the potential energy there."""

    point: Float[np.ndarray, "chain coordinate"]
    potential: Float[np.ndarray, " chain"]
    slope: Float[np.ndarray, "chain coordinate"]


@dataclass(frozen=True)
class Start:
    """Where chains begin, in unconstrained coordinates.

    Attributes:
        centre: value of each site.
        dense: sites that share a dense mass matrix, ravelled in this order.
        inverse_mass: that matrix's inverse, a guess of the posterior covariance; every other site has the
            unit matrix, since it is a standard normal.
        known: of one site that is all there is, where each chain begins, the potential energy there and its
            gradient; the chains find their own unless given, for which the gradient is compiled once more.
    """

    centre: Mapping[str, np.ndarray]
    dense: tuple[str, ...]
    inverse_mass: np.ndarray
    known: Known | None = None


def run_chains(
    model: Callable[..., None],
    arguments: tuple[Any, ...],
    start: Start,
    settings: Sampler,
    seed: int,
    *,
    progress: Progress = silent,
    checkpoints: Path | None = None,
    processes: bool = True,
) -> Draws:
    """Every transition after the warm-up: sites come back unconstrained, [chain, transition, ...].

    Draws are from the posterior of a numpyro ``model``, and not thinned.

    Chains run in worker processes, one bound to each core, or side by side in one call on an accelerator.
    The draws depend on ``seed`` alone, and not on cores nor on interruptions.

    Args:
        model: a numpyro model.
        arguments: of the model, arrays that are traced.
        start: where chains begin.
        settings: how many chains and draws.
        seed: of all of it.
        progress: told after every segment how many transitions of all chains are done.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.
        processes: false runs one chain after the other in this process.
    """
    job = _Job(model, arguments, start, settings, seed)
    total = settings.chains * (settings.warmup + settings.transitions)
    progress(0, total)
    if jax.default_backend() != "cpu":
        parts = [_run(job, range(settings.chains), checkpoints, lambda done: progress(done, total))]
    elif runtime.cores() == 1 or not processes:
        parts = _one_by_one(job, checkpoints, progress, total)
    else:
        parts = _in_processes(job, checkpoints, progress, total)
    sites, statistics = jax.tree.map(lambda *rows: np.concatenate(rows), *parts)
    return Draws(sites, statistics, settings.max_tree_depth)


def _one_by_one(
    job: _Job, checkpoints: Path | None, progress: Progress, total: int
) -> list[tuple[Arrays, Arrays]]:
    chains, transitions = _Chains(job), total // job.settings.chains
    return [
        chains.run([number], checkpoints, partial(_tell, progress, number * transitions, total))
        for number in range(job.settings.chains)
    ]


def _tell(progress: Progress, before: int, total: int, done: int) -> None:
    progress(before + done, total)


@dataclass(frozen=True)
class _Job:
    """All that determines the chains."""

    model: Callable[..., None]
    arguments: tuple[Any, ...]
    start: Start
    settings: Sampler
    seed: int


def _run(
    job: _Job, numbers: Sequence[int], checkpoints: Path | None, advanced: Callable[[int], None]
) -> tuple[Arrays, Arrays]:
    return _Chains(job).run(numbers, checkpoints, advanced)


def _in_processes(
    job: _Job, checkpoints: Path | None, progress: Progress, total: int
) -> list[tuple[Arrays, Arrays]]:
    """One worker process a core, each bound to its own.

    A compiled call hands its pieces from thread to thread. Bound to one core it keeps them; two calls on
    two free cores wake each other's threads and were measured to take eight times as long a step.
    """
    chains = job.settings.chains
    workers = min(runtime.cores(), chains)
    job = replace(job, arguments=jax.device_get(job.arguments))
    # What a worker has not finished at the end is lost; what it has is in the checkpoints.
    with scratch() as folder, runtime.worker_pool(workers, folder) as pool:
        counts = [folder / f"{number}" for number in range(chains)]
        futures = [pool.submit(_worker, job, number, checkpoints, counts[number]) for number in range(chains)]
        while wait_for(futures, timeout=0.5).not_done:
            progress(sum(int(count.read_text() or 0) for count in counts if count.is_file()), total)
            if any(future.done() and future.exception() for future in futures):
                break
        parts = [future.result() for future in futures]
    progress(total, total)
    return parts


def _worker(job: _Job, number: int, checkpoints: Path | None, count: Path) -> tuple[Arrays, Arrays]:
    def advanced(done: int) -> None:
        with whole_file(count) as staging:
            staging.write_text(str(done))

    return _run(job, [number], checkpoints, advanced)


class _Kernel(NamedTuple):
    """Compiled functions that begin chains and advance them by a segment."""

    begin: Any
    advance: Any


class _Chains:
    """The chains of one job."""

    def __init__(self, job: _Job) -> None:
        start, settings = job.start, job.settings
        self._settings, self._seed, self._arguments = settings, job.seed, job.arguments
        self._known = start.known
        others = tuple(sorted(set(start.centre) - set(start.dense)))
        self._start = (
            {name: jnp.asarray(start.centre[name]) for name in start.centre},
            jnp.asarray(start.inverse_mass),
        )
        target, depth = settings.target_accept, settings.max_tree_depth
        self._kernel = _compiled(job.model, start.dense, others, settings.warmup, target, depth)

    def _first(self, numbers: Sequence[int]) -> Any:
        """What each of these chains begins with: its key, and where it is if that is known."""
        key = jax.random.PRNGKey(self._seed)
        keys = jnp.stack([jax.random.fold_in(key, number) for number in numbers])
        known = None if self._known is None else Known(*(part[list(numbers)] for part in self._known))
        return keys, known

    def run(
        self, numbers: Sequence[int], checkpoints: Path | None, advanced: Callable[[int], None]
    ) -> tuple[Arrays, Arrays]:
        """All segments of the chains with these numbers: sites and statistics, [chain, draw, ...].

        ``advanced`` is told the transitions done so far.
        """
        settings, done = self._settings, 0
        length = settings.warmup + settings.transitions
        state = self._kernel.begin(self._first(numbers), (self._start, self._arguments))
        structure = jax.tree.structure(state)
        collected = []
        for number in range(-(-length // SEGMENT)):
            path = _segment_file(checkpoints, numbers[0], number)
            if path is not None and path.is_file():
                leaves, draws = _read(path)
                state = jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in leaves])
            else:
                state, drawn = self._kernel.advance(state, self._arguments)
                leaves, draws = jax.device_get((jax.tree.leaves(state), drawn))
                if path is not None:
                    _write(path, leaves, draws)
            keep = slice(max(0, settings.warmup - number * SEGMENT), length - number * SEGMENT)
            collected.append(jax.tree.map(lambda rows: rows[:, keep], draws))  # noqa: B023
            done += len(numbers) * min(SEGMENT, length - number * SEGMENT)
            advanced(done)
        return jax.tree.map(lambda *rows: np.concatenate(rows, axis=1), *collected)


@lru_cache(maxsize=8)
def _compiled(
    model: Callable[..., None],
    dense: tuple[str, ...],
    others: tuple[str, ...],
    warmup: int,
    target_accept: float,
    max_tree_depth: int,
) -> _Kernel:
    """One model's functions, compiled once for all data sets of the same shapes."""
    many = jax.vmap if jax.default_backend() != "cpu" else _single
    # The sampler knows its density only once a chain has begun.
    kernels: list[NUTS] = []

    def begin(first: tuple[jax.Array, Known | None], arguments_of_kernel: tuple[Any, ...]) -> Any:
        (key, known), ((centre, inverse_mass), arguments) = first, arguments_of_kernel
        size = sum(centre[name].size for name in others)
        kernel = NUTS(
            model,
            target_accept_prob=target_accept,
            max_tree_depth=max_tree_depth,
            dense_mass=[dense],
            inverse_mass_matrix={dense: inverse_mass, others: jnp.ones(size)},
            adapt_mass_matrix=True,
        )
        start_key, key = jax.random.split(key)
        kernels[:] = [kernel]
        if known is not None:
            (name,) = dense
            params = ParamInfo({name: known.point}, known.potential, {name: known.slope})
            return kernel.init(key, warmup, params, arguments, {})
        params, at = {}, 0
        # Half a posterior standard deviation of scatter lets R-hat see chains that did not forget it.
        scale = jnp.linalg.cholesky(inverse_mass)
        moved = 0.5 * scale @ jax.random.normal(start_key, scale.shape[:1])
        for name in dense:
            value = centre[name]
            params[name] = value + moved[at : at + value.size].reshape(value.shape)
            at += value.size
        for number, name in enumerate(others):
            noise = jax.random.normal(jax.random.fold_in(start_key, number), centre[name].shape)
            params[name] = centre[name] + 0.5 * noise
        return kernel.init(key, warmup, params, arguments, {})

    def advance(state: Any, arguments: tuple[Any, ...]) -> Any:
        (kernel,) = kernels

        def step(state: Any, _: None) -> Any:
            state = kernel.sample(state, arguments, {})
            return state, (state.z, {name: getattr(state, name) for name in STATISTICS})

        return jax.lax.scan(step, state, None, length=SEGMENT)

    return _Kernel(
        compiled_quickly()(many(begin, in_axes=(0, None))),
        jax.jit(many(advance, in_axes=(0, None)), compiler_options=FULLY),
    )


def _single(function: Callable[..., Any], in_axes: Any) -> Callable[..., Any]:
    """As `jax.vmap` over a first axis of length one, without what vectorising costs."""

    def lifted(first: Any, arguments: Any) -> Any:
        result = function(jax.tree.map(lambda leaf: leaf[0], first), arguments)
        return jax.tree.map(lambda leaf: leaf[None], result)

    return lifted


def _segment_file(folder: Path | None, chain: int, segment: int) -> Path | None:
    return None if folder is None else folder / f"chain-{chain}-segment-{segment:04d}.npz"


def _write(path: Path, leaves: list[np.ndarray], draws: tuple[Arrays, Arrays]) -> None:
    arrays = {f"state {i}": leaf for i, leaf in enumerate(leaves)}
    arrays |= {
        f"{kind} {name}": v
        for kind, part in zip(("site", "statistic"), draws, strict=True)
        for name, v in part.items()
    }
    with whole_file(path) as staging, staging.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def _read(path: Path) -> tuple[list[np.ndarray], tuple[Arrays, Arrays]]:
    with np.load(path, allow_pickle=False) as stored:
        count = sum(name.startswith("state ") for name in stored)
        leaves = [stored[f"state {i}"] for i in range(count)]
        parts = tuple(
            {name.removeprefix(kind): stored[name] for name in stored if name.startswith(kind)}
            for kind in ("site ", "statistic ")
        )
    return leaves, parts  # type: ignore[return-value]
