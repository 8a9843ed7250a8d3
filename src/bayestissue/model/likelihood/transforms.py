"""The sine transforms of the recorded impacts, made once: all the likelihood needs to know of the data.

Given its first two values, an ARMA(2,1) is an MA(1) seen through w_t = x''_t + c1 x'_{t-1} + c2 x_{t-2}
(backward differences), and the covariance of an MA(1) has the sine basis of the DST-I for its
eigenvectors whatever theta1 is. Since w is linear in (c1, c2), so is its transform.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, Num
from scipy import fft

# Sums over frequencies run over this many blocks first: a loop short enough to be unrolled by the compiler,
# whose body then runs over the lanes in vector registers. The lanes come in whole registers.
BLOCKS = 8
FILLED = 8 * BLOCKS


class SineTransforms(NamedTuple):
    """What the exact likelihood reads of a set of impacts.

    Attributes:
        x: the displacements themselves, zero after the last sample [m].
        columns: orthonormal DST-I of x''_t, x'_{t-1} and x_{t-2}, t = 3 ... n, in blocks of frequencies,
            zero beyond the last one [m].
        spread: 2 - 2 cos(j pi / (N + 1)), N = n - 2, one row for all impacts when all are equally long.
        size: N, the number of transformed values of each impact.
    """

    x: Float[Array, "impact sample"]
    columns: tuple[Float[Array, "block impact lane"], ...]
    spread: Float[Array, " block #impact lane"]
    size: Float[Array, " impact"]


def sine_transforms(
    x: Float[np.ndarray, "impact sample"], n_samples: Num[np.ndarray, " impact"] | None = None
) -> SineTransforms:
    """Transform all impacts, those of one length in one call.

    Args:
        x: displacement of each impact [m], padded at the end.
        n_samples: length of each impact, at least 3; the whole width of ``x`` unless given.
    """
    x = np.atleast_2d(np.asarray(x, float))
    lengths = np.broadcast_to(x.shape[1] if n_samples is None else np.asarray(n_samples, int), len(x))
    columns, spread = transformed(x, lengths, -(-(x.shape[1] - 2) // FILLED))
    one_length = len(np.unique(lengths)) == 1
    clean = np.where(np.arange(x.shape[1]) < lengths[:, None], x, 0.0)
    return SineTransforms(
        jax.device_put(clean), columns, spread[:, :1] if one_length else spread, jax.device_put(lengths - 2.0)
    )


def transformed(
    x: Float[np.ndarray, "impact sample"],
    lengths: Int[np.ndarray, " impact"],
    registers: int,
    *further: Float[np.ndarray, "impact sample"],
) -> tuple[tuple[Float[Array, "block impact lane"], ...], Float[Array, "block impact lane"]]:
    """Orthonormal DST-I of x''_t, x'_{t-1}, x_{t-2} and further series at t - 2, and the frequencies' spread.

    Args:
        x: displacement of each impact [m], padded at the end.
        lengths: of each impact.
        registers: how many times `FILLED` frequencies there is room for.
        further: other series.

    Raises:
        ValueError: an impact has fewer than three samples or more than ``x`` is wide.
    """
    if lengths.size and not 3 <= lengths.min() <= lengths.max() <= x.shape[1]:
        raise ValueError(f"every impact needs 3 to {x.shape[1]} samples")
    slope = np.diff(x, axis=1)
    series = (np.diff(slope, axis=1), slope, x, *further)
    columns = np.zeros((len(series), len(x), FILLED * registers))
    # padded frequencies count as an eigenvalue of 1 + theta1^2, never zero
    spread = np.full(columns.shape[1:], 2.0)
    for n in np.unique(lengths):
        rows = np.flatnonzero(lengths == n)
        for column, values in zip(columns, series, strict=True):
            column[rows, : n - 2] = fft.dst(values[rows, : n - 2], type=1, axis=1, norm="ortho")
        spread[rows, : n - 2] = spread_of(n - 2)
    return tuple(in_blocks(column) for column in columns), in_blocks(spread)


def spread_of(count: int) -> Float[np.ndarray, " frequency"]:
    """2 - 2 cos(j pi / (count + 1)) for j = 1 ... count, without cancellation for small j."""
    return 4 * np.sin(np.arange(1, count + 1) * (np.pi / (2 * (count + 1)))) ** 2


def in_blocks(rows: Float[np.ndarray, "row frequency"]) -> Float[Array, "block row lane"]:
    """Cut the frequencies, a multiple of `FILLED`, into `BLOCKS` blocks, and put these first."""
    blocks = rows.reshape(len(rows), BLOCKS, -1).swapaxes(0, 1)
    # As it is: `jnp.asarray` is compiled anew for every shape.
    return jax.device_put(np.ascontiguousarray(blocks))


def sine_transform(series: Float[Array, "*batch sample"]) -> Float[Array, "*batch sample"]:
    """Orthonormal DST-I over the last axis, differentiable, by one real FFT of the odd extension."""
    n = series.shape[-1]
    zero = jnp.zeros_like(series[..., :1])
    odd = jnp.concatenate([zero, series, zero, -series[..., ::-1]], axis=-1)
    return -jnp.fft.rfft(odd)[..., 1 : n + 1].imag / jnp.sqrt(2.0 * (n + 1))
