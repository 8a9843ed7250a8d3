"""Chains of the No-U-Turn sampler that can stop at any moment and go on as if they had not.

A chain advances in segments of fixed length, each one compiled call. After a segment its draws and the
chain's whole state can be written down; a later run reads them and continues with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpyro.infer import NUTS

from bayestissue import runtime
from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.execution.chunks import Progress, silent
from bayestissue.inference.execution.compiling import FULLY, compiled_quickly
from bayestissue.inference.samplers.sampling import STATISTICS, Draws
from bayestissue.results import scratch, whole_file

SEGMENT = 100
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Start:
    """Where chains begin, in unconstrained coordinates.

    Attributes:
        centre: value of each site.
        dense: the site that has a dense mass matrix.
        inverse_mass: that matrix's inverse, a guess of the posterior covariance; every other site has the
            unit matrix, since it is a standard normal.
    """

    centre: Mapping[str, np.ndarray]
    dense: str
    inverse_mass: np.ndarray


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

    Draws are from the posterior of a numpyro ``model``, and not thinned. They depend on ``seed`` alone, and
    not on cores nor on interruptions.

    Args:
        model: a numpyro model.
        arguments: of the model, arrays that are traced.
        start: where chains begin.
        settings: how many chains and draws.
        seed: of all of it.
        progress: told after every segment how many transitions of all chains are done.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.
        processes: false runs one chain after the other in this process, and true in worker processes, one
            bound to each core.
    """
    job, numbers = _Job(model, arguments, start, settings, seed, checkpoints), range(settings.chains)
    length = settings.warmup + settings.transitions
    total = settings.chains * length
    progress(0, total)

    def advanced(before: int, done: int) -> None:
        progress(before + done, total)

    if runtime.cores() == 1 or not processes:
        parts = [_run(job, number, partial(advanced, number * length)) for number in numbers]
    else:
        parts = _in_processes(job, partial(advanced, 0))
    sites, statistics = jax.tree.map(lambda *chains: np.stack(chains), *parts)
    return Draws(sites, statistics, settings.max_tree_depth)


@dataclass(frozen=True)
class _Job:
    """All that determines the chains, and where their segments are kept."""

    model: Callable[..., None]
    arguments: tuple[Any, ...]
    start: Start
    settings: Sampler
    seed: int
    checkpoints: Path | None


def _in_processes(job: _Job, advanced: Callable[[int], None]) -> list[tuple[Arrays, Arrays]]:
    """One worker process a core, each bound to its own.

    A compiled call hands its pieces from thread to thread. Bound to one core it keeps them; two calls on
    two free cores wake each other's threads and were measured to take eight times as long a step.
    """
    chains = job.settings.chains
    job = replace(job, arguments=jax.device_get(job.arguments))
    # What a worker has not finished at the end is lost; what it has is in the checkpoints.
    with scratch() as folder, runtime.worker_pool(min(runtime.cores(), chains), folder) as pool:
        counts = [folder / f"{number}" for number in range(chains)]
        futures = [pool.submit(_worker, job, number, counts[number]) for number in range(chains)]
        while wait_for(futures, timeout=0.5).not_done:
            advanced(sum(int(count.read_text() or 0) for count in counts if count.is_file()))
            if any(future.done() and future.exception() for future in futures):
                break
        parts = [future.result() for future in futures]
    advanced(chains * (job.settings.warmup + job.settings.transitions))
    return parts


def _worker(job: _Job, number: int, count: Path) -> tuple[Arrays, Arrays]:
    def advanced(done: int) -> None:
        with whole_file(count) as staging:
            staging.write_text(str(done))

    return _run(job, number, advanced)


def _run(job: _Job, number: int, advanced: Callable[[int], None]) -> tuple[Arrays, Arrays]:
    """All segments of a chain: sites and statistics, [draw, ...]; ``advanced`` counts its transitions."""
    start, settings = job.start, job.settings
    others = tuple(sorted(set(start.centre) - {start.dense}))
    kernel = _compiled(
        job.model, start.dense, others, settings.warmup, settings.target_accept, settings.max_tree_depth
    )
    key = jax.random.fold_in(jax.random.PRNGKey(job.seed), number)
    centre = {name: jnp.asarray(value) for name, value in start.centre.items()}
    state = kernel.begin(key, centre, jnp.asarray(start.inverse_mass), job.arguments)
    length, collected = settings.warmup + settings.transitions, []
    for begin in range(0, length, SEGMENT):
        path = job.checkpoints and job.checkpoints / f"chain-{number}-segment-{begin // SEGMENT:04d}.npz"
        if path is not None and path.is_file():
            leaves, draws = _read(path)
            state = jax.tree.unflatten(jax.tree.structure(state), map(jnp.asarray, leaves))
        else:
            state, drawn = kernel.advance(state, job.arguments)
            leaves, draws = jax.device_get((jax.tree.leaves(state), drawn))
            if path is not None:
                _write(path, leaves, draws)
        keep = slice(max(0, settings.warmup - begin), length - begin)
        collected.append(jax.tree.map(lambda rows: rows[keep], draws))  # noqa: B023
        advanced(min(begin + SEGMENT, length))
    return jax.tree.map(lambda *rows: np.concatenate(rows), *collected)


class _Kernel(NamedTuple):
    """Compiled functions that begin a chain and advance it by a segment."""

    begin: Any
    advance: Any


@lru_cache(maxsize=8)
def _compiled(
    model: Callable[..., None],
    dense: str,
    others: tuple[str, ...],
    warmup: int,
    target_accept: float,
    max_tree_depth: int,
) -> _Kernel:
    """One model's functions, compiled once for all data sets of the same shapes."""
    # The sampler knows its density only once a chain has begun.
    kernels: list[NUTS] = []

    def begin(key: Any, centre: Any, inverse_mass: Any, arguments: Any) -> Any:
        kernel = NUTS(
            model,
            target_accept_prob=target_accept,
            max_tree_depth=max_tree_depth,
            dense_mass=[(dense,)],
            inverse_mass_matrix={
                (dense,): inverse_mass,
                others: jnp.ones(sum(centre[name].size for name in others)),
            },
            adapt_mass_matrix=True,
        )
        kernels[:] = [kernel]
        start_key, key = jax.random.split(key)
        # Half a posterior standard deviation of scatter lets R-hat see chains that did not forget it.
        scale = jnp.linalg.cholesky(inverse_mass)
        moved = 0.5 * scale @ jax.random.normal(start_key, scale.shape[:1])
        params = {dense: centre[dense] + moved.reshape(centre[dense].shape)}
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

    return _Kernel(compiled_quickly(begin), jax.jit(advance, compiler_options=FULLY))


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
