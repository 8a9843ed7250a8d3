"""What is kept of many impacts: some draws of each, and everything of some of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from bayestissue.hierarchy.trace_data import Prepared

SHOWN = 1000
# Draws times impacts that fit into memory.
MOST_PAIRS = 20_000_000


def evenly_spaced(count: int, most: int) -> Int[np.ndarray, " chosen"]:
    """Numbers of at most so many of ``count``, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def some_impacts(count: int) -> Int[np.ndarray, " shown"]:
    """The impacts for which everything is kept: all, or a thousand evenly spaced ones."""
    return evenly_spaced(count, SHOWN)


def all_fit(draws: int, impacts: int) -> bool:
    """Whether everything can be made for so many draws of so many impacts."""
    return draws * impacts <= MOST_PAIRS


def kept_draws(chains: int, draws: int, impacts: int) -> Int[np.ndarray, " kept"]:
    """Numbers of the draws of each chain that are kept of single impacts, evenly spaced."""
    if all_fit(chains * draws, impacts):
        return np.arange(draws)
    most = max(10, MOST_PAIRS // (2 * chains * impacts))
    return np.arange(0, draws, -(-draws // most))


def in_single(values: np.ndarray) -> np.ndarray:
    """Draws in single precision, whose seven digits are more than they know."""
    return values.astype(np.float32)


def some_of(prepared: Prepared, rows: Int[np.ndarray, " row"]) -> Prepared:
    """The same fit with these impacts alone, the population as it was."""
    signal: Any = prepared.signal
    count = len(prepared.impacts)
    if np.array_equal(rows, np.arange(count)):
        return prepared

    def chosen(name: str) -> Any:
        value = getattr(signal, name)
        if isinstance(value, list):
            return [value[row] for row in rows]
        return value[rows] if len(value) == count else value

    data = replace(prepared.data.impacts(rows), design=prepared.data.design.subset(rows))
    data = jax.tree.map(jnp.asarray, data)
    return replace(
        prepared,
        force=prepared.force and prepared.force.impacts(rows),
        data=data,
        signal=replace(signal, **{name: chosen(name) for name in signal.__dataclass_fields__}),
        impacts=prepared.impacts.iloc[rows].reset_index(drop=True),
        mass_group=None if prepared.mass_group is None else prepared.mass_group[rows],
    )
