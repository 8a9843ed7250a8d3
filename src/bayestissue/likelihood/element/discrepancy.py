"""What a trace holds beside the model's impact and the chain's errors: a smooth force of unknown shape.

delta(t), a Gaussian process on the force per mass (Kennedy and O'Hagan 2001), with the covariance
s^2 exp(-(t - t')^2 / (2 l^2)) over the window's own time t in [0, 1] and l = 0.3, by its first six
eigenvectors on the samples: delta = U c with c_j ~ N(0, s^2 lambda_j). Added to white noise of variance
sigma^2 it makes sigma^2 T with T = 1 + (s / sigma)^2 U diag(lambda) U'.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.likelihood import small
from bayestissue.likelihood.linear_errors import Products

# Half a swing of a force in a window, and no less: what changes faster is not a tissue's law.
LENGTH = 0.3
MODES = 6
# The kernel is a polynomial of this many terms in either time to rounding error.
_NODES = 24


def modes(
    n_samples: Int[np.ndarray, " impact"], width: int
) -> tuple[Float[np.ndarray, "mode impact sample"], Float[np.ndarray, "impact mode"]]:
    """Eigenvectors U and eigenvalues lambda of the kernel on each impact's samples.

    The kernel is taken through its polynomial at Chebyshev's points, so that the eigenvectors of 24 by 24
    matrices give those on any number of samples.

    Args:
        n_samples: of each impact, six or more.
        width: number of samples of the longest row.

    Returns:
        U, orthonormal over each impact's samples and 0 past its end, and lambda, greatest first, with the
        sum n_samples, so that s is the root of delta's mean square.
    """
    count = np.asarray(n_samples)[:, None]
    index = np.arange(width)
    time = np.where(index < count, 2 * index / (count - 1) - 1, 0.0)
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)
    to_values = np.polynomial.chebyshev.chebvander(time, _NODES - 1)
    through = to_values @ np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, _NODES - 1))
    through = np.where((index < count)[..., None], through, 0.0)
    # Chebyshev's times go from -1 to 1.
    kernel = np.exp(-((nodes[:, None] - nodes) ** 2) / (2 * (2 * LENGTH) ** 2))
    frame, triangle = np.linalg.qr(through)
    values, vectors = np.linalg.eigh(triangle @ kernel @ triangle.swapaxes(1, 2))
    values, vectors = values[:, : -MODES - 1 : -1], vectors[:, :, : -MODES - 1 : -1]
    basis = np.moveaxis(frame @ vectors, -1, 0)
    return np.where(index < count, basis, 0.0), values * count / values.sum(1, keepdims=True)


def ratios(
    log_sigma: Float[Array, " impact"],
    log_discrepancy: Float[Array, " impact"],
    share: Float[Array, "impact mode"],
) -> Float[Array, "mode impact"]:
    """r_j = (s / sigma)^2 lambda_j: the discrepancy's variance in each mode over that of the noise."""
    return jnp.exp(2 * (log_discrepancy - log_sigma)) * share.T


def with_discrepancy(
    plain: Products,
    along: Sequence[Array],
    ratio: Float[Array, "mode *cell impact"],
    modes_gram: small.Matrix | None = None,
) -> Products:
    """The products under T^-1 from those without the discrepancy.

    G - B' diag(r / (1 + r)) B with B = U' (residual and columns), by Woodbury's identity, and
    log det T = sum_j log(1 + r_j). Where noise is not white, with the covariance sigma^2 N, B is U' N^-1
    (residual and columns) and 1 + r becomes 1 + S U' N^-1 U S, S = diag(r)^1/2.

    Args:
        plain: products of the parts under the noise alone.
        along: B of each, [mode, ..., impact].
        ratio: see `ratios`.
        modes_gram: U' N^-1 U as rows of entries; the modes are orthonormal unless given.
    """
    if modes_gram is not None:
        factor, half = _system(ratio, modes_gram)
        solved = [jnp.stack(small.solve_lower(factor, list(_alike(half, part) * part))) for part in along]
        entries = tuple(
            tuple(entry - (solved[a] * solved[b]).sum(0) for b, entry in enumerate(row))
            for a, row in enumerate(plain.gram)
        )
        return Products(entries, plain.log_determinant + 2 * small.log_diagonal(factor), plain.n_values)
    shrinkage = ratio / (1 + ratio)
    entries = tuple(
        tuple(entry - (shrinkage * along[a] * along[b]).sum(0) for b, entry in enumerate(row))
        for a, row in enumerate(plain.gram)
    )
    return Products(entries, plain.log_determinant + jnp.log1p(ratio).sum(0), plain.n_values)


def draw_given(
    key: Array,
    left: Float[Array, "impact sample"],
    basis: Float[Array, "mode impact sample"],
    log_sigma: Float[Array, " impact"],
    ratio: Float[Array, "mode impact"],
) -> Float[Array, "impact sample"]:
    """Delta given what is left of the traces, the impact and the chain's errors taken off.

    c_j is normal with mean r_j / (1 + r_j) U_j' left and variance sigma^2 r_j / (1 + r_j).
    """
    shrinkage = ratio / (1 + ratio)
    standard = jax.random.normal(key, ratio.shape)
    weights = shrinkage * (basis * left).sum(-1) + jnp.exp(log_sigma) * jnp.sqrt(shrinkage) * standard
    return (weights[..., None] * basis).sum(0)


def draw_along(
    key: Array,
    along: Float[Array, "mode impact"],
    basis: Float[Array, "mode impact sample"],
    log_sigma: Float[Array, " impact"],
    ratio: Float[Array, "mode impact"],
    modes_gram: small.Matrix,
) -> Float[Array, "impact sample"]:
    """The same where noise is not white: normal with mean S M^-1 S along and covariance sigma^2 S M^-1 S.

    M, ``along`` and ``modes_gram`` as of `with_discrepancy`.
    """
    factor, half = _system(ratio, modes_gram)
    standard = jnp.exp(log_sigma) * jax.random.normal(key, ratio.shape)
    solved = jnp.stack(small.solve_lower(factor, list(half * along))) + standard
    weights = half * jnp.stack(small.solve_upper(factor, list(solved)))
    return (weights[..., None] * basis).sum(0)


def _system(ratio: Array, modes_gram: small.Matrix) -> tuple[list[list[Array]], Array]:
    """The factor of 1 + S U' N^-1 U S, and S."""
    half = jnp.sqrt(ratio)
    size = range(len(half))
    matrix = [[half[i] * half[j] * modes_gram[i][j] + (1.0 if i == j else 0.0) for j in size] for i in size]
    return small.cholesky(matrix), half


def _alike(half: Float[Array, "mode impact"], part: Float[Array, "mode *cell impact"]) -> Array:
    """One of each mode and impact, as `part` has them in every cell."""
    return half.reshape(len(half), *[1] * (part.ndim - half.ndim), *half.shape[1:])


def draw_prior(
    key: Array,
    shape: tuple[int, ...],
    basis: Float[Array, "mode impact sample"],
    log_discrepancy: Float[Array, " impact"],
    share: Float[Array, "impact mode"],
) -> Float[Array, "*batch impact sample"]:
    """Delta before any trace is seen, for batches of ``shape`` (the impacts its last axis)."""
    scale = jnp.exp(log_discrepancy)[:, None] * jnp.sqrt(share)
    weights = scale * jax.random.normal(key, (*shape, share.shape[-1]))
    return jnp.einsum("...ij,jin->...in", weights, basis)


def integrals(
    delta: Float[Array, "*batch impact sample"],
    first_time: Float[Array, " impact"],
    dt: Float[Array, " impact"],
) -> tuple[Float[Array, "*batch impact sample"], Float[Array, "*batch impact sample"]]:
    """The velocity and the displacement that delta takes off: its first and second integral from contact.

    By trapezia; between contact and the first sample delta is taken as it is there. Past a row's end the
    values mean nothing.
    """
    first, step = first_time[:, None], dt[:, None]
    begin = delta[..., :1]
    velocity = begin * first + _integral(delta, step)
    return velocity, begin * first**2 / 2 + _integral(velocity, step)


def _integral(values: Array, step: Array) -> Array:
    pieces = step * (values[..., 1:] + values[..., :-1]) / 2
    return jnp.pad(jnp.cumsum(pieces, axis=-1), [(0, 0)] * (values.ndim - 1) + [(1, 0)])
