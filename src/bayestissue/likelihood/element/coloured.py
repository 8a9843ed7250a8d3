"""Noise that went through the recorder's low-pass, beside white noise that entered behind it.

Its covariance is sigma^2 T with T = f 1 + (1 - f) R, f the white share and R the correlations that the filter
leaves (`bayestissue.signal.recorder_noise`). R has few eigenvalues that count, about two for each period of
the filter's corner, so that T = f 1 + B B' with as many columns in B. With M = f 1 + B' B, by Woodbury's
identity, p' T^-1 q = (p'q - (B'p)' M^-1 (B'q)) / f, and log det T = (N - m) log f + log det M. Samples that a
trace lacks are rows that B lacks.

Where next to no noise entered behind the filter, T has eigenvalues near 0, of what changes faster than the
filter lets pass. A likelihood would believe those frequencies above all others, and whatever the filter's
description leaves out there, and it would take the noise's size from them. So only every k-th sample is
asked, as far apart as keeps the least eigenvalue of T at `LEAST_EIGENVALUE`: some four in a period of the
corner.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int
from scipy.linalg import toeplitz

from bayestissue.likelihood.element.recorder import Colour
from bayestissue.likelihood.linear_errors import Products

LEAST_EIGENVALUE = 0.02
# f, at the least: what is divided by it keeps nine digits.
_LEAST_WHITE = 1e-3
# Eigenvalues of the filtered part that are left out, over f.
_LEFT_OUT = 1e-4
# Samples of which those eigenvalues are.
_SAMPLES = 48


def colour_of(
    white: float,
    correlations: Sequence[Callable[[Int[np.ndarray, " lag"]], Float[np.ndarray, " lag"]]],
    rows: int,
) -> Colour:
    """The noise on so many rows.

    Args:
        white: f.
        correlations: for each sampling rate those of filtered noise at lags in samples.
        rows: of the longest trace, the samples before its first one included.
    """
    white = max(white, _LEAST_WHITE)
    roots = []
    for correlation in correlations:
        values, vectors = np.linalg.eigh((1 - white) * toeplitz(correlation(np.arange(rows))))
        counts = values > _LEFT_OUT * white
        roots.append((vectors[:, counts] * np.sqrt(values[counts])).T)
    most = max(len(root) for root in roots)
    filled = [np.pad(root, ((0, most - len(root)), (0, 0))) for root in roots]
    stride = max(_stride(white, correlation) for correlation in correlations)
    return Colour(jnp.asarray(white), jnp.asarray(np.stack(filled)), jnp.zeros(stride))


def _stride(
    white: float, correlations: Callable[[Int[np.ndarray, " lag"]], Float[np.ndarray, " lag"]]
) -> int:
    """How far apart samples must be for T to have no eigenvalue below `LEAST_EIGENVALUE`."""
    stride = 1
    while True:
        least = np.linalg.eigvalsh(toeplitz(correlations(stride * np.arange(_SAMPLES))))[0]
        if white + (1 - white) * least >= LEAST_EIGENVALUE:
            return stride
        stride += 1


def products(
    colour: Colour,
    rate: Int[Array, " impact"],
    inside: Bool[Array, "impact row"],
    parts: Sequence[Float[Array, "*cell impact row"]],
) -> Products:
    """Products of all parts with each other under T^-1, as of `bayestissue.likelihood.linear_errors`.

    Args:
        colour: the noise.
        rate: which of its sampling rates each impact has.
        inside: where there is a sample.
        parts: 0 where there is no sample; cells of contact may come first. Of all every k-th row is there:
            see `Colour.stride`.
    """
    root = _root(colour, rate, inside)
    number = root.shape[1]
    system = colour.white * jnp.eye(number) + jnp.einsum("imr,ikr->imk", root, root)
    factor = jnp.linalg.cholesky(system)
    unit = jnp.broadcast_to(jnp.eye(number), factor.shape)
    inverse = jax.scipy.linalg.solve_triangular(factor, unit, lower=True)
    root = jnp.einsum("ikm,imr->ikr", inverse, root)
    along = [jnp.einsum("ikr,...ir->...ik", root, part) for part in parts]
    entries = [
        [((parts[a] * parts[b]).sum(-1) - (along[a] * along[b]).sum(-1)) / colour.white for b in range(a + 1)]
        for a in range(len(parts))
    ]
    size = range(len(parts))
    count = inside.sum(-1) + 0.0
    determinant = (count - number) * jnp.log(colour.white)
    determinant = determinant + 2 * jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
    gram = tuple(tuple(entries[max(a, b)][min(a, b)] for b in size) for a in size)
    return Products(gram, determinant, count)


def drawn(
    colour: Colour,
    rate: Int[Array, " impact"],
    key: Array,
    standard: Float[Array, "*batch impact sample"],
) -> Float[Array, "*batch impact sample"]:
    """Noise over sigma; ``standard`` are standard normals for its white part."""
    root = _root(colour._replace(stride_marks=jnp.zeros(1)), rate, jnp.ones(standard.shape[-2:], bool))
    modes = jax.random.normal(key, (*standard.shape[:-1], root.shape[1]))
    return jnp.sqrt(colour.white) * standard + jnp.einsum("...im,imr->...ir", modes, root)


def innovations(
    colour: Colour, rate: Int[Array, " impact"], left: Float[Array, "impact row"]
) -> Float[Array, "impact row"]:
    """What each sample has beside what those before it say of it, as white as the noise's model is right.

    L^-1 e with T = L L': L of the first samples is the beginning of L.

    Args:
        colour: the noise.
        rate: which of its sampling rates each impact has.
        left: residuals at every k-th sample: see `Colour.stride`.
    """
    root = _on_rows(colour, left.shape[1])
    shape = colour.white * jnp.eye(left.shape[1]) + jnp.einsum("amr,ams->ars", root, root)
    whitened = jax.scipy.linalg.solve_triangular(
        jnp.linalg.cholesky(shape), jnp.broadcast_to(left.T, (len(root), *left.T.shape)), lower=True
    )
    return jnp.take_along_axis(whitened, rate[None, None], axis=0)[0].T


def _root(
    colour: Colour, rate: Int[Array, " impact"], inside: Bool[Array, "impact row"]
) -> Float[Array, "impact mode row"]:
    """B' of each impact, 0 where there is no sample."""
    return jnp.where(inside[:, None], _on_rows(colour, inside.shape[1])[rate], 0.0)


def _on_rows(colour: Colour, width: int) -> Float[Array, "rate mode row"]:
    """B' on the first so many samples that are asked, 0 beyond those that any trace has."""
    root = colour.root[:, :, :: colour.stride][:, :, :width]
    return jnp.pad(root, ((0, 0), (0, 0), (0, width - root.shape[2])))
