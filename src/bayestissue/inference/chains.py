"""Chains of the No-U-Turn sampler that can stop at any moment and go on as if they had not.

A chain advances in segments of fixed length, each one compiled call. After a segment its draws and the
chain's whole state can be written down; a later run reads them and continues with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event, Lock
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpyro.infer import NUTS

from bayestissue import runtime
from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.sampling import STATISTICS, Draws, Progress, silent
from bayestissue.results import whole_file

SEGMENT = 100
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Start:
    """Where chains begin, in unconstrained coordinates.

    Attributes:
        centre: value of each site.
        dense: sites that share a dense mass matrix, ravelled in this order.
        inverse_mass: that matrix's inverse, a guess of the posterior covariance; every other site has the
            unit matrix, since it is a standard normal.
    """

    centre: Mapping[str, np.ndarray]
    dense: tuple[str, ...]
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
) -> Draws:
    """Draw from the posterior of a numpyro ``model``; sites come back unconstrained, [chain, draw, ...].

    Chains run in threads of one device, as many as there are cores, or side by side in one call on an
    accelerator. The draws depend on ``seed`` alone, and not on cores nor on interruptions.

    Args:
        model: a numpyro model.
        arguments: of the model, arrays that are traced.
        start: where chains begin.
        settings: how many chains and draws.
        seed: of all of it.
        progress: told after every segment how many transitions of all chains are done.
        checkpoints: an existing folder to which finished segments are written, and in which those of an
            earlier run of the same job are looked for.
    """
    chains = _Chains(model, arguments, start, settings)
    keys = [jax.random.PRNGKey(0)] * settings.chains
    keys = [jax.random.fold_in(jax.random.PRNGKey(seed), chain) for chain in range(settings.chains)]
    total = settings.chains * (settings.warmup + settings.draws)
    lock, stop, done = Lock(), Event(), 0

    def advanced(count: int) -> None:
        nonlocal done
        with lock:
            done += count
            progress(done, total)

    progress(0, total)
    if jax.default_backend() == "cpu":
        with ThreadPoolExecutor(runtime.cores()) as pool:
            jobs = [
                pool.submit(
                    chains.run, key[None], partial(_segment_file, checkpoints, number), stop, advanced
                )
                for number, key in enumerate(keys)
            ]
            try:
                parts = [job.result() for job in jobs]
            finally:
                # An interrupted run waits for the segments under way, and no longer.
                stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
    else:
        parts = [chains.run(jnp.stack(keys), partial(_segment_file, checkpoints, 0), stop, advanced)]
    sites, statistics = jax.tree.map(lambda *rows: np.concatenate(rows), *parts)
    return Draws(sites, statistics, settings.max_tree_depth)


class _Chains:
    """Compiled functions of one model and data set: begin, and advance by a segment."""

    def __init__(
        self, model: Callable[..., None], arguments: tuple[Any, ...], start: Start, settings: Sampler
    ) -> None:
        self._settings, self._start = settings, start
        others = tuple(sorted(set(start.centre) - set(start.dense)))
        size = sum(np.size(start.centre[name]) for name in others)
        kernel = NUTS(
            model,
            target_accept_prob=settings.target_accept,
            max_tree_depth=settings.max_tree_depth,
            dense_mass=[start.dense],
            inverse_mass_matrix={
                start.dense: jnp.asarray(start.inverse_mass),
                others: jnp.ones(size),
            },
            adapt_mass_matrix=True,
        )
        self._lock = Lock()
        self._arguments = arguments
        self._many = jax.vmap if jax.default_backend() != "cpu" else _single
        scale = np.linalg.cholesky(start.inverse_mass)

        def begin(key: jax.Array, arguments: tuple[Any, ...]) -> Any:
            own, key = jax.random.split(key)
            params, at = {}, 0
            # Half a posterior standard deviation of scatter lets R-hat see chains that did not forget it.
            moved = 0.5 * jnp.asarray(scale) @ jax.random.normal(own, scale.shape[:1])
            for name in start.dense:
                value = jnp.asarray(start.centre[name])
                params[name] = value + moved[at : at + value.size].reshape(value.shape)
                at += value.size
            for number, name in enumerate(others):
                value = jnp.asarray(start.centre[name])
                noise = jax.random.normal(jax.random.fold_in(own, number), value.shape)
                params[name] = value + 0.5 * noise
            return kernel.init(key, settings.warmup, params, arguments, {})

        def advance(state: Any, arguments: tuple[Any, ...]) -> Any:
            def step(state: Any, _: None) -> Any:
                state = kernel.sample(state, arguments, {})
                return state, (state.z, {name: getattr(state, name) for name in STATISTICS})

            return jax.lax.scan(step, state, None, length=SEGMENT)

        self._begin = jax.jit(self._many(begin))
        self._advance = jax.jit(self._many(advance))
        self._compiled: Any = None

    def run(
        self,
        keys: jax.Array,
        file: Callable[[int], Path | None],
        stop: Event,
        advanced: Callable[[int], None],
    ) -> tuple[Arrays, Arrays]:
        """All segments of the chains of ``keys``: sites and statistics, [chain, draw, ...]."""
        settings = self._settings
        length = settings.warmup + settings.draws
        with self._lock:
            state = self._begin(keys, self._arguments)
            if self._compiled is None:
                self._compiled = self._advance.lower(state, self._arguments).compile()
        structure = jax.tree.structure(state)
        collected = []
        for number in range(-(-length // SEGMENT)):
            if stop.is_set():
                raise KeyboardInterrupt
            path = file(number)
            if path is not None and path.is_file():
                leaves, draws = _read(path)
                state = jax.tree.unflatten(structure, [jnp.asarray(leaf) for leaf in leaves])
            else:
                state, drawn = self._compiled(state, self._arguments)
                leaves, draws = jax.device_get((jax.tree.leaves(state), drawn))
                if path is not None:
                    _write(path, leaves, draws)
            keep = slice(max(0, settings.warmup - number * SEGMENT), length - number * SEGMENT)
            collected.append(jax.tree.map(lambda rows: rows[:, keep], draws))  # noqa: B023
            advanced(len(keys) * min(SEGMENT, length - number * SEGMENT))
        return jax.tree.map(lambda *rows: np.concatenate(rows, axis=1), *collected)


def _single(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `jax.vmap` over a first axis of length one, without what vectorising costs."""

    def lifted(first: Any, arguments: Any) -> Any:
        result = function(jax.tree.map(lambda leaf: leaf[0], first), arguments)
        return jax.tree.map(lambda leaf: leaf[None], result)

    return lifted


def _segment_file(folder: Path | None, chain: int, segment: int) -> Path | None:
    return None if folder is None else folder / f"chain-{chain}-segment-{segment:04d}.npz"


def _write(path: Path, leaves: list[np.ndarray], draws: tuple[Arrays, Arrays]) -> None:
    arrays = {f"state {i}": leaf for i, leaf in enumerate(leaves)}
    arrays |= {f"{kind} {name}": v for kind, part in zip(("site", "statistic"), draws, strict=True) for name, v in part.items()}
    with whole_file(path) as staging, staging.open("wb") as stream:
        np.savez(stream, **arrays)


def _read(path: Path) -> tuple[list[np.ndarray], tuple[Arrays, Arrays]]:
    with np.load(path, allow_pickle=False) as stored:
        count = sum(name.startswith("state ") for name in stored)
        leaves = [stored[f"state {i}"] for i in range(count)]
        parts = tuple(
            {name.removeprefix(kind): stored[name] for name in stored if name.startswith(kind)}
            for kind in ("site ", "statistic ")
        )
    return leaves, parts  # type: ignore[return-value]
