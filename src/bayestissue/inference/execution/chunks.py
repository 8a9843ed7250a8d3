"""Impacts a few hundred at a time, so that what a step works on stays in a processor's cache."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from bayestissue.base import runtime
from bayestissue.base.result import silent
from bayestissue.inference.execution.workers import cluster, computed
from bayestissue.model.hierarchy.trace_models import TraceData

BLOCK = 512
# With fewer blocks a second process takes longer to begin than it saves.
_FEW = 40
# Blocks that a worker is given at once.
_SHARE = 8
Rows = Int[np.ndarray, " row"]
OfBlock = Callable[[TraceData, Rows], Any]
Item = tuple[OfBlock, TraceData, list[Rows], int]
# Called with how many of how many parts are done.
Progress = Callable[[int, int], None]


def map_impacts(
    function: Callable[..., Any], data: TraceData, *by_impact: Any, progress: Progress = silent
) -> Any:
    """``function(data, *by_impact)`` block by block; ``by_impact`` has impacts along first axes."""

    def one(part: TraceData, rows: Rows) -> Any:
        return function(part, *jax.tree.map(lambda leaf: np.asarray(leaf)[rows], by_impact))

    return in_blocks(data, one, progress=progress)


def in_blocks(data: TraceData, function: OfBlock, *, progress: Progress = silent) -> Any:
    """What ``function`` makes of each block and its rows, one after another along the first axis.

    Every block has the same number of impacts, so that one compilation serves all: the last is filled up
    with its last impact. Many blocks are shared out over worker processes, one a core, bound as chains are;
    or all, however few, over the cluster of `bayestissue.inference.execution.workers.on_cluster`.
    ``progress`` is told how many blocks are done, and of how many.
    """
    count = len(data.log_mass)
    blocks = -(-count // BLOCK)
    size = -(-count // blocks)
    # The design stays behind: what is done block by block is told X b.
    data = replace(data, design=None)  # type: ignore[arg-type]
    if blocks == 1 and cluster() is None:
        return jax.tree.map(np.asarray, function(data, np.arange(count)))
    rows = [np.minimum(np.arange(number * size, (number + 1) * size), count - 1) for number in range(blocks)]
    few = jax.default_backend() != "cpu" or blocks < _FEW
    jobs, scheduler = 1 if few else runtime.cores(), cluster()
    per_share = 1 if jobs == 1 and scheduler is None else _SHARE
    items = [_item(function, data, rows[begin : begin + per_share]) for begin in range(0, blocks, per_share)]
    parts_by_share: dict[int, list[Any]] = {}
    for number, parts in computed(_of_share, items, jobs=jobs, scheduler=scheduler):
        parts_by_share[number] = parts
        progress(sum(map(len, parts_by_share.values())), blocks)
    ordered = [part for number in range(len(items)) for part in parts_by_share[number]]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *ordered)


def _item(function: OfBlock, data: TraceData, share: list[Rows]) -> Item:
    """What a worker needs for some blocks: of the data their impacts alone, and the number of the first."""
    first, last = int(share[0][0]), int(share[-1][-1])
    return function, data.impacts(np.arange(first, last + 1)), share, first


def _of_share(item: Item) -> list[Any]:
    function, data, share, first = item
    return [jax.tree.map(np.asarray, function(data.impacts(rows - first), rows)) for rows in share]
