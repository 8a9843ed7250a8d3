"""What is kept of many impacts: some draws of each, and everything of some of them."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.model.hierarchy.trace_data import Prepared

# Up to so many impacts everything is kept of each. Of more everything is kept of so many of them, and of each
# `IMPACT_DRAWS` draws in single precision: the ends of its 90 % interval are then unsure by 0.1 of its sd.
FEW, IMPACT_DRAWS = 1000, 400
# Draws times impacts: of 25,000 impacts or more fewer draws of each.
MOST_PAIRS = 10_000_000


def some_impacts(count: int) -> Int[np.ndarray, " shown"]:
    """The impacts for which everything is kept: all, or `FEW` evenly spaced ones."""
    return evenly_spaced(count, FEW)


def all_kept(impacts: int) -> bool:
    """Whether everything is kept of each of so many impacts."""
    return impacts <= FEW


def kept_draws(chains: int, draws: int, impacts: int) -> Int[np.ndarray, " kept"]:
    """Numbers of the draws of each chain that are kept of single impacts, evenly spaced."""
    if all_kept(impacts):
        return np.arange(draws)
    most = max(10, min(IMPACT_DRAWS, MOST_PAIRS // impacts) // chains)
    return np.arange(0, draws, -(-draws // most))


def some_of(prepared: Prepared, rows: Int[np.ndarray, " row"]) -> Prepared:
    """The same fit with these impacts alone, the population as it was."""
    if np.array_equal(rows, np.arange(len(prepared.impacts))):
        return prepared

    data = replace(prepared.data.impacts(rows), design=prepared.data.design.subset(rows))
    data = jax.tree.map(jnp.asarray, data)
    return replace(
        prepared,
        force=prepared.force and prepared.force.impacts(rows),
        data=data,
        signal=prepared.signal.impacts(rows),
        impacts=prepared.impacts.iloc[rows].reset_index(drop=True),
        mass_group=None if prepared.mass_group is None else prepared.mass_group[rows],
    )
