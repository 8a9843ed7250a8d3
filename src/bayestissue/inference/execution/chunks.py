"""Impacts a few hundred at a time, so that what a step works on stays in a processor's cache."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import wait
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from bayestissue import runtime
from bayestissue.hierarchy.traces import TraceData
from bayestissue.inference.samplers.sampling import Progress, silent
from bayestissue.results import scratch, whole_file

BLOCK = 512
# With fewer blocks a second process takes longer to begin than it saves.
_FEW = 40
Rows = Int[np.ndarray, " row"]
OfBlock = Callable[[TraceData, Rows], Any]


def of_each(function: Callable[..., Any], data: TraceData, *given: Any, progress: Progress = silent) -> Any:
    """``function(data, *given)`` block by block; arrays of ``given`` have impacts along their first axis."""

    def one(part: TraceData, rows: Rows) -> Any:
        return function(part, *jax.tree.map(lambda leaf: np.asarray(leaf)[rows], given))

    return in_blocks(data, one, progress=progress)


def impacts_of(data: TraceData, rows: Rows) -> TraceData:
    """Some impacts' traces and masses; the design is still that of all."""

    def chosen(leaf: Any) -> Any:
        # Sums run over blocks of samples first, so that there the impacts come second.
        whole = np.asarray(leaf)
        return whole[:, rows] if whole.ndim == 3 else whole[rows]

    return data._replace(
        record=jax.tree.map(chosen, data.record),
        log_mass=chosen(data.log_mass),
        log_peak=chosen(data.log_peak),
    )


def in_blocks(data: TraceData, function: OfBlock, *, progress: Progress = silent) -> Any:
    """What ``function`` makes of each block and its rows, one after another along the first axis.

    Every block has the same number of impacts, so that one compilation serves all: the last is filled up
    with its last impact. Many blocks are shared out over worker processes, one a core, bound as chains are.
    ``progress`` is told how many blocks are done, and of how many.
    """
    count = len(data.log_mass)
    blocks = -(-count // BLOCK)
    size = -(-count // blocks)
    # The design stays behind: what is done block by block is told X b.
    data = data._replace(design=None)  # type: ignore[arg-type]
    if blocks == 1:
        return _of_block(function, data, np.arange(count))
    rows = [np.minimum(np.arange(number * size, (number + 1) * size), count - 1) for number in range(blocks)]
    if jax.default_backend() == "cpu" and runtime.cores() > 1 and blocks >= _FEW:
        parts = _in_processes(data, function, rows, progress)
    else:
        parts = []
        for each in rows:
            parts.append(_of_block(function, impacts_of(data, each), each))
            progress(len(parts), blocks)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *parts)


def _of_block(function: OfBlock, part: TraceData, rows: Rows) -> Any:
    return jax.tree.map(np.asarray, function(part, rows))


def _in_processes(data: TraceData, function: OfBlock, rows: list[Rows], progress: Progress) -> list[Any]:
    workers, blocks = min(runtime.cores(), len(rows)), len(rows)
    shares = [part.tolist() for part in np.array_split(np.arange(blocks), workers)]
    with scratch() as told, runtime.worker_pool(workers, told) as pool:
        counts = [told / f"{number}" for number in range(workers)]
        futures = []
        for share, path in zip(shares, counts, strict=True):
            own = [rows[number] for number in share]
            first = int(own[0][0])
            part = impacts_of(data, np.arange(first, int(own[-1][-1]) + 1))
            futures.append(pool.submit(_share, function, part, own, first, path))
        while wait(futures, timeout=0.5).not_done:
            progress(sum(int(path.read_text() or 0) for path in counts if path.is_file()), blocks)
            if any(future.done() and future.exception() for future in futures):
                break
        parts = [part for future in futures for part in future.result()]
    progress(blocks, blocks)
    return parts


def _share(function: OfBlock, data: TraceData, rows: Sequence[Rows], first: int, told: Path) -> list[Any]:
    """What one worker does: its blocks, whose impacts ``data`` holds from number ``first`` on."""
    parts = []
    for each in rows:
        parts.append(_of_block(function, impacts_of(data, each - first), each))
        with whole_file(told) as staging:
            staging.write_text(str(len(parts)))
    return parts
