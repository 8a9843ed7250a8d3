"""Errors of the measuring chain that enter a trace linearly, integrated out in closed form.

A trace is y = f + sum_a e_a q_a + noise, with the errors e_a normal about 0 and independent, q_a known
columns, and noise with covariance sigma^2 T. All that the density needs of the data are the products of
the columns under T^-1, y - f being column 0. The last error may be uniform about 0 instead, as a moment
is that lies anywhere between two samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.special import log_ndtr
from jaxtyping import Bool, Float

from bayestissue.likelihood import small

LOG_2PI = 1.8378770664093453
_LOG_ROOT_HALF_PI = 0.22579135264472744
_ROOT_3 = 3**0.5
_LEAST_PIVOT = 1e-12


class Products(NamedTuple):
    """What is left of a set of traces once the shape of each is given.

    Attributes:
        gram: products of column a with column b under T^-1, as rows of entries [impact].
        log_determinant: log det T.
        n_values: number of values of each trace.
    """

    gram: Any
    log_determinant: Float[Array, " impact"]
    n_values: Float[Array, " impact"]


def marginal_log_likelihood(
    products: Products,
    log_sigma: Float[Array, " impact"],
    error_sd: Float[Array, "impact error"],
    uniform: Bool[Array, " impact"] | None = None,
) -> Float[Array, " impact"]:
    """Log density of each trace with its errors integrated out.

    -(N log(2 pi sigma^2) + log det T + log det M + G_00 / sigma^2 - h' M^-1 h) / 2 with
    M = 1 + S G S / sigma^2, h = S G_.0 / sigma^2 and S the standard deviations of the errors: the matrix
    determinant lemma and the Woodbury identity. Where the last error is uniform, M has no 1 for it and S its
    half width; with L L' = M and y = L^-1 h the integral over it leaves the factor
    (pi / 2)^1/2 (Phi(l - y) - Phi(-l - y)), l and y the last of L's diagonal and of y.

    Args:
        products: of residual and error columns.
        log_sigma: log of the noise's standard deviation.
        error_sd: standard deviation of each error; 0 where there is none.
        uniform: where the last error is uniform, with that standard deviation above 0; nowhere unless given.
    """
    factor, right, precision = _system(products, log_sigma, error_sd, uniform)
    solved = small.solve_lower(factor, right)
    explained = sum(value**2 for value in solved)
    scale = products.n_values * (LOG_2PI + 2 * log_sigma) + products.log_determinant
    log_density = -(scale + products.gram[0][0] * precision - explained) / 2 - small.log_diagonal(factor)
    if uniform is None:
        return log_density
    return log_density + jnp.where(uniform, _log_share(factor[-1][-1], solved[-1]), 0.0)


def predicted_given(
    products: Products,
    log_sigma: Float[Array, " impact"],
    error_sd: Float[Array, "impact error"],
    columns: Float[Array, "error row *cell impact"],
    uniform: Bool[Array, " impact"] | None = None,
) -> tuple[Float[Array, "row *cell impact"], list[Float[Array, "row *cell impact"]]]:
    """What the errors add to further values given the trace: their mean, and what is unknown of it.

    Given the trace the errors are normal with mean S M^-1 h and covariance S M^-1 S, so that they add
    q' S M^-1 h + b' z to a value with the entries q in the columns, z being standard normals that all values
    share and b = L^-1 S q, L L' = M.

    Args:
        products: of residual and error columns over the values that are there.
        log_sigma: log of the noise's standard deviation.
        error_sd: as of `marginal_log_likelihood`.
        columns: of the errors, at the further values.
        uniform: as there; the normal is not cut off at the bounds here.
    """
    factor, right, _ = _system(products, log_sigma, error_sd, uniform)
    unit = scales(error_sd, uniform)
    along = small.solve_lower(factor, [unit[..., a] * column for a, column in enumerate(columns)])
    return small.dot(along, small.solve_lower(factor, right)), along


def _log_share(half: Array, centre: Array) -> Array:
    """Log of (pi / 2)^1/2 times a standard normal's probability within ``half`` of ``centre``."""
    near, far = log_ndtr(half - jnp.abs(centre)), log_ndtr(-half - jnp.abs(centre))
    return _LOG_ROOT_HALF_PI + near + jnp.log1p(-jnp.exp(far - near))


def from_lower_entries(entries: Sequence[Array]) -> tuple[tuple[Array, ...], ...]:
    """The rows of a symmetric matrix from those of its lower triangle."""
    size = int((8 * len(entries) + 1) ** 0.5) // 2
    return tuple(
        tuple(entries[max(a, b) * (max(a, b) + 1) // 2 + min(a, b)] for b in range(size)) for a in range(size)
    )


def draw_errors(
    key: Array,
    products: Products,
    log_sigma: Float[Array, " impact"],
    error_sd: Float[Array, "impact error"],
    uniform: Bool[Array, " impact"] | None = None,
) -> Float[Array, "impact error"]:
    """The errors given the trace and everything else: normal with mean S M^-1 h and covariance S M^-1 S.

    A uniform last error is drawn from its normal cut off at its bounds, the others given it. Arguments as
    those of `marginal_log_likelihood`.
    """
    factor, right, _ = _system(products, log_sigma, error_sd, uniform)
    standard = jax.random.normal(key, error_sd.shape)
    mean = small.solve_lower(factor, right)
    whole = [value + standard[..., a] for a, value in enumerate(mean)]
    if uniform is not None:
        half, centre = factor[-1][-1], mean[-1]
        key_of_last = jax.random.fold_in(key, 1)
        within = jax.random.truncated_normal(key_of_last, -half - centre, half - centre, centre.shape)
        whole[-1] = jnp.where(uniform, centre + within, whole[-1])
    return scales(error_sd, uniform) * jnp.stack(small.solve_upper(factor, whole), axis=-1)


def prior_errors(
    key: Array,
    shape: tuple[int, ...],
    error_sd: Float[Array, "impact error"],
    uniform: Bool[Array, " impact"] | None = None,
) -> Float[Array, "*batch impact error"]:
    """Draws of the errors before any trace is seen, for batches of ``shape`` over the impacts' own axis."""
    number = error_sd.shape[-1]
    errors = error_sd * jax.random.normal(key, (*shape, number))
    if uniform is None:
        return errors
    even = jax.random.uniform(jax.random.fold_in(key, 1), shape, minval=-1.0, maxval=1.0)
    last = jnp.where(uniform, _ROOT_3 * error_sd[:, -1] * even, errors[..., -1])
    return errors.at[..., -1].set(last)


def part_of(
    error: Float[Array, " impact"], sd: Float[Array, " impact"], share: Float[Array, " impact"], key: Array
) -> Float[Array, " impact"]:
    """A draw of one of two normal errors whose sum is known: N(share error, share (1 - share) sd^2).

    Args:
        error: the sum.
        sd: its standard deviation.
        share: of its variance that of the one.
        key: of the draw.
    """
    spread = sd * jnp.sqrt(share * (1 - share))
    return share * error + spread * jax.random.normal(key, error.shape)


def scales(error_sd: Float[Array, "impact error"], uniform: Bool[Array, " impact"] | None) -> Array:
    """The errors' units: their standard deviations, and a uniform one's half width."""
    if uniform is None:
        return error_sd
    return error_sd.at[..., -1].multiply(jnp.where(uniform, _ROOT_3, 1.0))


def _system(
    products: Products, log_sigma: Array, error_sd: Array, uniform: Array | None
) -> tuple[list[list[Array]], list[Array], Array]:
    precision = jnp.exp(-2 * log_sigma)
    entries, number = products.gram, error_sd.shape[-1]
    unit = scales(error_sd, uniform)
    scale = [unit[..., a] for a in range(number)]
    prior = [jnp.ones(()) for _ in range(number)]
    if uniform is not None:
        # A trace that said nothing of a uniform error would leave a zero pivot.
        prior[-1] = jnp.where(uniform, _LEAST_PIVOT, 1.0)
    matrix = [
        [
            scale[a] * scale[b] * entries[a + 1][b + 1] * precision + (prior[a] if a == b else 0.0)
            for b in range(number)
        ]
        for a in range(number)
    ]
    right = [scale[a] * entries[a + 1][0] * precision for a in range(number)]
    return small.cholesky(matrix), right, precision
