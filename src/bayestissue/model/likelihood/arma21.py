"""The exact log likelihood of an ARMA(2,1): no filter, no matrix (thesis, section 2.4, eq. 4).

Given its first two values, an ARMA(2,1) is an MA(1) seen through w_t = x''_t + c1 x'_{t-1} + c2 x_{t-2}
(backward differences). The MA(1)'s covariance over sigma^2, T, is tridiagonal, 1 + theta1^2 on and -theta1
beside the diagonal, and has the sine basis of the DST-I for its eigenvectors whatever theta1 is. Since w is
linear in (c1, c2), so is its transform.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float
from scipy import fft

from bayestissue.base.impact_arrays import IndexPerImpact, PerSample
from bayestissue.mechanics.entire import sinc_root
from bayestissue.model.likelihood.small import LOG_2PI

Start = Literal["free", "stationary"]
# Sums over frequencies run over this many blocks first: a loop short enough to be unrolled by the compiler,
# whose body then runs over the lanes in vector registers. The lanes come in whole registers.
BLOCKS = 8
FILLED = 8 * BLOCKS


@partial(jax.jit, static_argnames="start")
def arma21_log_likelihood(
    x: ArrayLike,
    phi1: ArrayLike,
    phi2: ArrayLike,
    theta1: ArrayLike,
    sigma_a: ArrayLike,
    start: Start = "free",
) -> Array:
    """The exact log likelihood of x_t = phi1 x_{t-1} + phi2 x_{t-2} + a_t - theta1 a_{t-1} (eq. 4).

    Free start: -(N log(2 pi sigma_a^2) + log det T + W' L^-1 W / sigma_a^2) / 2, N = n - 2, with
    W = DST(x''_t + c1 x'_{t-1} + c2 x_{t-2}), c1 = 2 - phi1, c2 = 1 - phi1 - phi2, and L
    the eigenvalues of T.

    Args:
        x: one series of at least three samples on the last axis [m]; leading axes broadcast with the
            parameters.
        phi1: first autoregressive coefficient.
        phi2: second autoregressive coefficient.
        theta1: moving-average coefficient, any real number.
        sigma_a: standard deviation of the shocks a_t [m].
        start: "free" gives the density of x_3 ... x_n given x_1 and x_2, the shock a_2 being as unknown
            as any other; "stationary" that of the whole series, -inf where no stationary distribution
            exists.

    Returns:
        The log density, differentiable by all arguments.

    Raises:
        ValueError: ``x`` is shorter than three samples, or ``start`` is neither word.
    """
    x = jnp.asarray(x, float)
    if x.ndim == 0 or x.shape[-1] < 3:
        raise ValueError("x needs at least three samples on its last axis")
    if start not in ("free", "stationary"):
        raise ValueError(f'start is "free" or "stationary", not {start!r}')
    phi1, phi2, theta1, sigma_a = (jnp.asarray(p, float) for p in (phi1, phi2, theta1, sigma_a))
    count, c1, c2 = x.shape[-1] - 2, 2 - phi1, (1 - phi1) - phi2
    slope = jnp.diff(x, axis=-1)
    w = jnp.diff(slope, axis=-1) + c1[..., None] * slope[..., :-1] + c2[..., None] * x[..., :-2]
    transformed = sine_transform(w)
    spread = jnp.asarray(spread_of(count), x.dtype)
    over = transformed / eigenvalues(theta1[..., None], spread)
    size = jnp.asarray(float(count))
    scale = size * (LOG_2PI + 2 * jnp.log(sigma_a)) + log_determinant(theta1, size)
    free = -(scale + (transformed * over).sum(-1) / sigma_a**2) / 2
    if start == "free":
        return free
    first = jnp.sqrt(spread * (4 - spread) / (2 * (count + 1)))
    end = (first * over).sum(-1)
    return free + _stationary(x[..., 0], x[..., 1], end, (c1, c2, theta1, sigma_a), size)


def arma21_series(
    first: Float[Array, "*batch 2"],
    shocks: Float[Array, " later *batch"],
    c1: Array,
    c2: Array,
    theta1: Array,
) -> Float[Array, "*batch sample"]:
    """The ARMA(2,1) that shocks drive from its first two values on.

    Args:
        first: x_1 and x_2 [m].
        shocks: a_2 ... a_n [m].
        c1: 2 - phi1.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient.
    """
    x1, x2 = (jnp.broadcast_to(first[..., i], shocks.shape[1:]) for i in (0, 1))

    def step(carry: tuple[Array, Array, Array], shock: Array) -> tuple[tuple[Array, Array, Array], Array]:
        before, now, last_shock = carry
        slope = now - before
        after = now + slope - c1 * slope - c2 * before + shock - theta1 * last_shock
        return (now, after, shock), after

    _, later = jax.lax.scan(step, (x1, x2, shocks[0]), shocks[1:])
    return jnp.moveaxis(jnp.concatenate([x1[None], x2[None], later]), 0, -1)


def _stationary(x1: Array, x2: Array, end: Array, parameters: tuple[Array, ...], count: Array) -> Array:
    """Log density of x_1 and x_2 given w: of all w only w_3 shares a shock, a_2, with them.

    Written for x_1 and x_2 - x_1, whose covariance keeps its digits when sampling is fine: of gamma_0 and of
    the drop gamma_0 - gamma_1, without cancellation.

    Args:
        x1: first displacement.
        x2: second displacement.
        end: first element of T^-1 w.
        parameters: c1, c2, theta1, sigma_a.
        count: N.
    """
    c1, c2, theta1, sigma_a = parameters
    one_minus_phi2 = 2 - (c1 - c2)
    # this is (1 - phi2)(1 + theta1^2) - 2 theta1 phi1
    top = one_minus_phi2 * (1 - theta1) ** 2 + 2 * theta1 * c2
    flat = sigma_a**2 * top / ((c1 - c2) * (4 - 2 * c1 + c2))
    gamma0, drop = flat / c2, (flat + theta1 * sigma_a**2) / one_minus_phi2
    corner = jnp.exp(log_determinant(theta1, count - 1) - log_determinant(theta1, count))
    step_variance = 2 * drop - theta1**2 * sigma_a**2 * corner
    determinant = gamma0 * step_variance - drop**2
    stationary = (c2 > 0) & (c1 > c2) & (4 - 2 * c1 + c2 > 0) & (determinant > 0)
    safe = jnp.where(stationary, determinant, 1.0)
    step = x2 - x1 + theta1 * end
    form = (step_variance * x1**2 + 2 * drop * x1 * step + gamma0 * step**2) / safe
    return jnp.where(stationary, -(2 * LOG_2PI + jnp.log(safe) + form) / 2, -jnp.inf)


def transformed(
    x: PerSample, lengths: IndexPerImpact, registers: int, *further: PerSample
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


def eigenvalues(theta1: Array, spread: Array) -> Array:
    """1 + theta1^2 - 2 theta1 cos(j pi / (N + 1)) with spread = 2 - 2 cos(j pi / (N + 1))."""
    return (1 - theta1) ** 2 + theta1 * spread


@jax.custom_jvp
def sums_over_frequencies(terms: tuple[Array, ...]) -> tuple[Array, ...]:
    """The sum over block and lane of every term, all in one pass over what they share.

    The blocks are summed first, lane by lane: that loop is short enough to be unrolled, and then runs over
    the lanes in vector registers. One reduction of several operands is one loop, several are several.

    Args:
        terms: two or more, each [block, impact, lane].
    """
    zeros = (jnp.zeros((), terms[0].dtype),) * len(terms)
    lanes = tuple(jax.lax.reduce(terms, zeros, _plus, (0,)))
    return tuple(jax.lax.reduce(lanes, zeros, _plus, (1,)))


def _plus(a: tuple[Array, ...], b: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(x + y for x, y in zip(a, b, strict=True))


@sums_over_frequencies.defjvp
def _sums_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    # JAX's own derivative of a reduction of several operands is far slower than that of plain sums.
    return sums_over_frequencies(*primals), tuple(d.sum((0, -1)) for d in tangents[0])


def log_determinant(theta1: Array, count: Array) -> Array:
    """Log det T = log(1 + theta1^2 + theta1^4 + ... + theta1^(2 N)) for N = count values.

    With a = log |theta1| that is N a + log(sinh((N + 1) a) / sinh a), smooth where a is 0. Away from there
    it is the geometric sum (1 - q^(N+1)) / (1 - q) of q = theta1^2, beyond 1 read backwards. Arguments
    broadcast.
    """
    square, terms = theta1**2, count + 1
    beyond = square > 1
    inner = jnp.where(beyond, 1 / jnp.where(beyond, square, 1.0), square)
    near = -terms * jnp.log(jnp.maximum(inner, 1e-300)) < 1
    a = jnp.log(jnp.where(near, square, 1.0)) / 2
    by_sines = count * a + jnp.log(terms * sinc_root(-((terms * a) ** 2)) / sinc_root(-(a**2)))
    far = jnp.where(near, 0.5, inner)
    by_sum = jnp.log1p(-(far**terms)) - jnp.log1p(-far)
    reversed_ = count * jnp.log(jnp.where(beyond & ~near, square, 1.0))
    return jnp.where(near, by_sines, by_sum + reversed_)
