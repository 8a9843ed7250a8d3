"""Point estimates of K and C for all impacts at once: ARMA(2,1), then A(2), then spring and damper.

The ARMA(2,1) is by the thesis's conditional least squares (section 2.3): the shocks are run forward as
a_t = w_t + theta1 a_{t-1} from a_2 = 0, with

    w_t = x''_t + c1 x'_{t-1} + c2 x_{t-2},   c1 = 2 - phi1,   c2 = 1 - phi1 - phi2,

and their sum of squares is least. Given theta1 it is quadratic in c1 and c2, so these are solved for and one
dimension is left to search: on a grid, since the sum may have several minima, and on ever finer ones around
the best point. theta1 = tanh(eta) is finest towards -1 and 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Num

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerSample, PerImpact, PerSample, bucket
from bayestissue.inference.execution.compiling import FULLY, compiled_quickly, filled_up, in_parts
from bayestissue.mechanics.oscillator import arccos_branch, from_differences, spring_damper
from bayestissue.model.likelihood.arma21 import FILLED

_GRID = 17
_ROUNDS = 7
# A variance below this share of the terms it is the remainder of is their rounding error.
_ROUNDING = (64 * 2.2e-16) ** 2
# x''_t, to which c1 and c2 times the others are added, x'_{t-1} and x_{t-2}; 0 past the end of an impact.
Columns = Float[Array, "3 sample impact"]
# Sums of products of the shocks of these columns, for one theta1 of each impact.
Moments = Float[Array, "3 3 impact"]
BATCH = 256
_FEWEST = 16
_FEW = 500
_TYPES: dict[str, type] = {"branch": int, "noiseless": bool, "theta1_at_limit": bool}


class PointFit(NamedTuple):
    """Point estimates of a set of impacts, each attribute with one value per impact.

    Attributes:
        phi1, phi2, theta1: ARMA(2,1) coefficients (thesis, eq. 4).
        sigma_a: standard deviation of the shocks [m].
        omega_n: natural frequency [rad/s]; NaN where no A(2) has these coefficients.
        zeta: damping ratio.
        K: stiffness [N/m].
        C: damping [N s/m].
        branch: which value of arccos theta1 asks for; K and C are those of the main one, 0.
        noiseless: whether the residual is no more than rounding errors.
        theta1_at_limit: whether theta1 is nearer to -1 or 1 than N samples can tell.
    """

    phi1: PerImpact
    phi2: PerImpact
    theta1: PerImpact
    sigma_a: PerImpact
    omega_n: PerImpact
    zeta: PerImpact
    K: PerImpact
    C: PerImpact
    branch: Num[np.ndarray, " impact"]
    noiseless: Num[np.ndarray, " impact"]
    theta1_at_limit: Num[np.ndarray, " impact"]


def fit_points(
    x: PerSample,
    n_samples: Num[np.ndarray, " impact"],
    dt: PerImpact,
    mass: PerImpact,
    gravity: PerImpact | None = None,
) -> PointFit:
    """Fit every impact by itself, all of them in one compiled function, by conditional least squares.

    Args:
        x: displacements from the rest position [m], padded at the end; from their mean by the thesis.
        n_samples: samples of each impact, at least 8.
        dt: sampling interval of each [s].
        mass: impacting mass of each [kg].
        gravity: along the motion of each [m/s^2], if it is to count. It adds g dt^2 to the second
            differences, but for a share zeta omega_n dt that is left out.

    Raises:
        ValueError: an impact has fewer than eight samples.
    """
    x, n_samples = np.asarray(x, float), np.asarray(n_samples)
    if n_samples.min(initial=8) < 8:
        raise ValueError("an ARMA(2,1) needs at least eight samples")
    if len(x) == 0:
        return PointFit(*(np.empty(0, _TYPES.get(name, float)) for name in PointFit._fields))
    # To a width not much above, from a short list, so that few widths are ever compiled.
    width = 2 + FILLED * bucket(max(1, -(-(x.shape[1] - 2) // FILLED)))
    x = np.pad(x, ((0, 0), (0, width - x.shape[1])))
    fall = np.zeros(len(x)) if gravity is None else np.asarray(gravity * dt**2, float)
    columns = (x, n_samples - 2.0, np.asarray(dt, float), np.asarray(mass, float), fall)
    fitted = _fit_few if len(x) < _FEW else _fit_batch
    # Batches of 16, 32 ... impacts, so that few sizes are ever compiled; filled up with the last impact.
    size = min(BATCH, max(_FEWEST, 2 ** (len(x) - 1).bit_length()))
    fit: PointFit = in_parts(filled_up(lambda *batch: fitted(*batch[:-1]), size), columns, size)
    return fit


def _fit(
    x: JaxPerSample, size: JaxPerImpact, dt: JaxPerImpact, mass: JaxPerImpact, fall: JaxPerImpact
) -> PointFit:
    fit = _least_squares(x, size, fall)
    phi1, phi2 = 2 - fit.c1, (fit.c1 - fit.c2) - 1
    # n samples that do not turn back are less than half a period, so the main value of arccos is right
    w, zeta = from_differences(fit.c1, fit.c2, None, 1.0)
    K, C = spring_damper(w / dt, zeta, mass)
    estimates: dict[str, Any] = {
        "phi1": phi1,
        "phi2": phi2,
        "theta1": fit.theta1,
        "sigma_a": jnp.sqrt(fit.form / size),
        "omega_n": w / dt,
        "zeta": zeta,
        "K": K,
        "C": C,
        "branch": arccos_branch(phi1, phi2, fit.theta1),
        "noiseless": fit.form <= 4 * fit.floor,
        "theta1_at_limit": jnp.abs(fit.theta1) > 1 - 1 / size,
    }
    return PointFit(**estimates)


_fit_batch = jax.jit(_fit, compiler_options=FULLY)
# Compiled in half the time, and ten times as long at it, which for few is not felt.
_fit_few = compiled_quickly(_fit)


class _Profile(NamedTuple):
    """The fit with everything but theta1 at its best.

    Attributes:
        c1, c2: coefficients.
        theta1: moving-average coefficient.
        form: sum of squares at the optimum.
        floor: the sum of squares that rounding alone would leave.
    """

    c1: JaxPerImpact
    c2: JaxPerImpact
    theta1: JaxPerImpact
    form: JaxPerImpact
    floor: JaxPerImpact


def _least_squares(x: JaxPerSample, size: JaxPerImpact, fall: JaxPerImpact) -> _Profile:
    """The least sum of squares over theta1 in [-1, 1], c1 and c2.

    Args:
        x: deviations from whatever is taken for the equilibrium.
        size: number of shocks of each impact, two less than there are samples.
        fall: what a constant force adds to every x''_t.
    """
    inside = (jnp.arange(x.shape[1] - 2) < size[:, None]).T
    slope = jnp.diff(x, axis=1)
    series = jnp.stack([jnp.diff(slope, axis=1) - fall[:, None], slope[:, :-1], x[:, :-2]])
    columns = jnp.where(inside, series.mT, 0.0)
    start = _start(columns, inside)
    left = _with_step(columns, start)

    def loss(theta1: Array) -> Array:
        return size * jnp.log(_least(_moments(left, theta1, inside), start.floor)) / 2

    theta1 = _search(loss, size)
    best = _moments(left, theta1, inside)
    c1, c2 = _solve(best)
    return _Profile(start.c1 + c1, start.c2 + c2, theta1, _least(best, start.floor), start.floor)


def _start(columns: Columns, inside: Bool[Array, "sample impact"]) -> _Profile:
    """Least squares for theta1 = 0 in two steps: what the first leaves may be less than its rounding."""
    zero = jnp.zeros_like(columns[0, 0])

    def refine(step: int, now: _Profile) -> _Profile:
        moments = _moments(_with_step(columns, now), zero, inside)
        c1, c2 = _solve(moments)
        terms = moments[0, 0] + c1**2 * moments[1, 1] + c2**2 * moments[2, 2]
        floor = jnp.where(step == 0, _ROUNDING * terms + jnp.finfo(zero.dtype).tiny, now.floor)
        return _Profile(now.c1 + c1, now.c2 + c2, zero, zero, floor)

    return jax.lax.fori_loop(0, 2, refine, _Profile(*(zero,) * 5))


def _with_step(columns: Columns, by: _Profile) -> Columns:
    """The same with c1 and c2 so much greater."""
    return columns.at[0].set(columns[0] + by.c1 * columns[1] + by.c2 * columns[2])


def _solve(m: Moments) -> tuple[Array, Array]:
    determinant = m[1, 1] * m[2, 2] - m[1, 2] ** 2
    c1, c2 = m[1, 2] * m[0, 2] - m[2, 2] * m[0, 1], m[1, 2] * m[0, 1] - m[1, 1] * m[0, 2]
    return c1 / determinant, c2 / determinant


def _least(m: Moments, floor: Array) -> Array:
    c1, c2 = _solve(m)
    return jnp.maximum(m[0, 0] + c1 * m[0, 1] + c2 * m[0, 2], 0.0) + floor


def _search(loss: Callable[[Array], Array], size: Array) -> Array:
    # tanh(reach) is nearer to the edge than the distance, 1/N, that N values can tell
    reach = jnp.log(20 * size) / 2

    def narrow(_: int, state: tuple[Array, Array]) -> tuple[Array, Array]:
        centre, width = state
        etas = jnp.clip(centre + width * jnp.linspace(-1, 1, _GRID)[:, None], -reach, reach)
        best = jnp.argmin(jax.lax.map(lambda eta: loss(_theta(eta, reach)), etas), axis=0)
        return etas[best, jnp.arange(len(size))], 2 * width / (_GRID - 1)

    centre, _ = jax.lax.fori_loop(0, _ROUNDS, narrow, (jnp.zeros_like(size), reach))
    return _theta(centre, reach)


def _theta(eta: Array, reach: Array) -> Array:
    """tanh, stretched so that the ends of the search are -1 and 1 themselves."""
    return jnp.tanh(eta) / jnp.tanh(reach)


def _moments(columns: Columns, theta1: Array, inside: Bool[Array, "sample impact"]) -> Moments:
    def step(carry: tuple[Array, Moments], part: tuple[Array, Array]) -> tuple[tuple[Array, Moments], None]:
        shocks, totals = carry
        values, now = part
        shocks = jnp.where(now, values + theta1 * shocks, 0.0)
        return (shocks, totals + shocks[:, None] * shocks), None

    shocks = jnp.zeros((3, len(theta1)), theta1.dtype)
    start = shocks, jnp.zeros((3, *shocks.shape), theta1.dtype)
    (_, totals), _ = jax.lax.scan(step, start, (columns.swapaxes(0, 1), inside))
    return totals
