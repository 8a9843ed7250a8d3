"""Impacts a few hundred at a time, so that what a step works on stays in a processor's cache."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from bayestissue.base import runtime
from bayestissue.base.result import silent
from bayestissue.inference.execution.workers import cluster, computed
from bayestissue.model.hierarchy.trace_models import TraceData

BLOCK = 512
# With fewer blocks a second process takes longer to begin than it saves.
_FEW = 40
# Blocks that a worker is given at once.
_SHARE = 8
# Called with how many of how many parts are done.
Progress = Callable[[int, int], None]


def map_impacts(
    function: Callable[..., Any], data: TraceData, *by_impact: Any, progress: Progress = silent
) -> Any:
    """``function(data, *by_impact)`` of each block of impacts, one after another along the first axis.

    Every block has the same number of impacts, so that one compilation serves all: the last is filled up
    with its last impact. Many blocks are shared out over worker processes, one a core, bound as chains are;
    or all, however few, over the cluster of `bayestissue.inference.execution.workers.on_cluster`.

    Args:
        function: of a block.
        data: the traces.
        by_impact: arrays, or trees of them, with impacts along first axes.
        progress: told how many blocks are done, and of how many.
    """
    count = len(data.log_mass)
    blocks = -(-count // BLOCK)
    # The design stays behind: what is done block by block is told X b.
    data = replace(data, design=None)  # type: ignore[arg-type]
    if blocks == 1 and cluster() is None:
        return jax.tree.map(np.asarray, function(data, *jax.tree.map(np.asarray, by_impact)))
    rows_of = np.minimum(np.arange(blocks * -(-count // blocks)), count - 1).reshape(blocks, -1)
    few = jax.default_backend() != "cpu" or blocks < _FEW
    jobs, scheduler = 1 if few else runtime.cores(), cluster()
    per_share = 1 if jobs == 1 and scheduler is None else _SHARE
    shares = [rows_of[begin : begin + per_share] for begin in range(0, blocks, per_share)]

    def block(rows: np.ndarray) -> tuple[Any, ...]:
        """What a worker needs for a block: its impacts alone."""
        return data.impacts(rows), *jax.tree.map(lambda leaf: np.asarray(leaf)[rows], by_impact)

    # In this process no block is copied before its turn comes.
    items = ((function, [block(rows) for rows in share]) for share in shares)
    parts_by_share: dict[int, list[Any]] = {}
    for number, parts in computed(_of_share, items, jobs=jobs, scheduler=scheduler):
        parts_by_share[number] = parts
        progress(sum(map(len, parts_by_share.values())), blocks)
    ordered = [part for number in range(len(shares)) for part in parts_by_share[number]]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *ordered)


def _of_share(item: tuple[Callable[..., Any], list[Any]]) -> list[Any]:
    function, blocks = item
    return [jax.tree.map(np.asarray, function(*block)) for block in blocks]
