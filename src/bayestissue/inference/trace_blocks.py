"""Impacts a few hundred at a time, so that what a step works on stays in a processor's cache."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from bayestissue.hierarchy.traces import TraceData
from bayestissue.inference.sampling import Progress, silent

BLOCK = 512


def impacts_of(data: TraceData, rows: Int[np.ndarray, " row"]) -> TraceData:
    """Some impacts' traces, masses and cells."""

    def chosen(leaf: Any) -> Any:
        # Sums run over blocks of samples first, so that there the impacts come second.
        whole = np.asarray(leaf)
        return whole[:, rows] if whole.ndim == 3 else whole[rows]

    return data._replace(
        record=jax.tree.map(chosen, data.record),
        design=data.design._replace(cell=np.asarray(data.design.cell)[rows]),
        log_mass=chosen(data.log_mass),
        log_peak=chosen(data.log_peak),
    )


def in_blocks(
    data: TraceData, function: Callable[[TraceData, np.ndarray], Any], *, progress: Progress = silent
) -> Any:
    """What ``function`` makes of each block and its rows, one after another along the first axis.

    Every block has the same number of impacts, so that one compilation serves all: the last is filled up
    with its last impact. ``progress`` is told how many are done, and of how many.
    """
    count = len(data.log_mass)
    blocks = -(-count // BLOCK)
    size = -(-count // blocks)
    # The design matrices stay behind: what is done block by block is told X b.
    data = data._replace(design=data.design._replace(columns=()))
    parts = []
    for number in range(blocks):
        rows = np.minimum(np.arange(number * size, (number + 1) * size), count - 1)
        part = jax.tree.map(np.asarray, function(impacts_of(data, rows), rows))
        kept = min(size, count - number * size)
        parts.append(jax.tree.map(lambda leaf: leaf[:kept], part))  # noqa: B023
        progress(number + 1, blocks)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
