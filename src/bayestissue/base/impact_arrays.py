"""Arrays of impacts: their types, by what they have a number of, and axes filled up to one of a few lengths.

Those of numpy come from files and go to tables; those of jax, whose names begin with Jax, stand in what is
compiled. A function that is compiled for impacts takes a few more, copies of the first, whose numbers are as
good as any; `bayestissue.inference.execution.compiling.padded` cuts what they give off again: what is
compiled for one dataset serves others. Samples that are added are 0, and past a trace's end. Where numbers
are summed over impacts, zeros are added instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

if TYPE_CHECKING:
    from jax import Array

type PerImpact = Float[np.ndarray, " impact"]
type IndexPerImpact = Int[np.ndarray, " impact"]
type MaskPerImpact = Bool[np.ndarray, " impact"]
type PerSample = Float[np.ndarray, "impact sample"]
type PerParameter = Float[np.ndarray, "impact parameter"]
type PerDraw = Float[np.ndarray, "chain draw"]
type JaxPerImpact = Float[Array, " impact"]
type JaxPerSample = Float[Array, "impact sample"]
type JaxPerParameter = Float[Array, "impact parameter"]


def evenly_spaced(count: int, most: int) -> Int[np.ndarray, " chosen"]:
    """Numbers of at most so many of ``count``, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def bucket(size: int) -> int:
    """The least of a few sizes that holds ``size``: four to each power of two, at most a fourth too many."""
    step = max(1, 2 ** (int(size).bit_length() - 3))
    return step * -(-int(size) // step)


def padded_rows(count: int) -> Int[np.ndarray, " row"]:
    """The numbers of ``count`` impacts, and that of the first as often again as fills their `bucket`."""
    return np.pad(np.arange(count), (0, bucket(count) - count))


def padded_impacts(values: Any, axis: int = 0) -> Any:
    """A tree of arrays with impacts along one axis, filled up with copies of the first.

    An axis of one, which broadcasts, stays so.
    """
    import jax

    return jax.tree.map(lambda leaf: np.asarray(leaf).take(padded_rows(leaf.shape[axis]), axis), values)


def padded_zeros(values: Any, axis: int = 0) -> Any:
    """A tree of arrays filled up with zeros along one axis."""
    import jax

    def filled(leaf: Any) -> np.ndarray:
        widths = [(0, 0)] * np.ndim(leaf)
        widths[axis] = (0, bucket(np.shape(leaf)[axis]) - np.shape(leaf)[axis])
        return np.pad(leaf, widths)

    return jax.tree.map(filled, values)
