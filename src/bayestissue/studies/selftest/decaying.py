"""Three decaying exponentials, as the motion of a mass on a standard linear solid that is overdamped.

The poles -l of M x'' = -K x - r K (x - s), s' = r K (x - s) / C are those of

    (l^2 + (1 + r) K / M) (r K / C - l) = (r K)^2 / (M C),

so that with M = 1 kg, r K / C is the sum of the three rates l, (1 + r) K that of their products in pairs, and
r K^2 / C the product of all three. The motion is linear in where it begins, x, v and s, which are solved for.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.mechanics.elements import element
from bayestissue.mechanics.elements.element import Collision
from bayestissue.mechanics.elements.linear import transition
from bayestissue.studies.selftest.mixed_models import data

# NIST, Statistical Reference Datasets, nonlinear regression, Lanczos3 (generated to five digits).
TIME = np.arange(24) * 0.05
LANCZOS3 = np.ravel(data("lanczos3"))
# The second of the two starts that come with it.
_RATES = (0.7, 4.2, 6.3)
# Of Gauss and Newton, each of which leaves a thirtieth of what is left.
_STEPS = 6


def element_of_rates(rates: tuple[float, ...]) -> Float[np.ndarray, " 3"]:
    """K [N/m], C [N s/m] and arm_ratio of the standard linear solid on which 1 kg has these rates [1/s]."""
    total, product = sum(rates), float(np.prod(rates))
    pairs = (total**2 - sum(rate**2 for rate in rates)) / 2
    K = product / total
    return np.array([K, (pairs - K) / total, (pairs - K) / K])


@jax.jit
def _left(logs: Float[Array, " parameter"]) -> Float[Array, " time"]:
    """What the motions that begin with x, v or s alone leave of `LANCZOS3`."""
    which, one = element("standard_linear"), jnp.ones(1)
    values = dict(
        zip((parameter.name for parameter in which.parameters), jnp.exp(logs)[:, None], strict=True)
    )
    free = Collision.of(which, values, one, one)
    columns = transition(free, jnp.asarray(TIME)[None])[0, :, 0]
    basis, _ = jnp.linalg.qr(columns)
    series = jnp.asarray(LANCZOS3)
    return series - basis @ (basis.T @ series)


def fitted_exponentials() -> dict[str, float]:
    """Least squares of `LANCZOS3`, the linear parameters solved for at each step (variable projection).

    Returns:
        Amplitudes b1, b3, b5 and rates b2, b4, b6 of b1 exp(-b2 t) + ..., rates rising, and ``squares``, the
        sum of squares that is left.
    """
    from scipy.optimize import least_squares

    slopes = jax.jit(jax.jacfwd(_left))

    def left(logs: Float[np.ndarray, " parameter"]) -> Float[np.ndarray, " time"]:
        return np.asarray(_left(jnp.asarray(logs)))

    def slopes_of(logs: Float[np.ndarray, " parameter"]) -> Float[np.ndarray, "time parameter"]:
        return np.asarray(slopes(jnp.asarray(logs)))

    fitted = least_squares(
        left,
        np.log(element_of_rates(_RATES)),
        jac=slopes_of,
        method="lm",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    # Those steps end where the sum of squares no longer falls by more than its rounding error, a hundred
    # thousandth of a standard deviation from its least and more. Gauss and Newton's go by its slope.
    logs = fitted.x
    for _ in range(_STEPS):
        logs = logs - np.linalg.lstsq(slopes_of(logs), left(logs))[0]
    K, C, ratio = np.exp(logs)
    arm = ratio * K
    rates = np.sort(np.roots([1.0, -arm / C, K + arm, -arm / C * K]).real)
    amplitudes = np.linalg.lstsq(np.exp(-np.outer(TIME, rates)), LANCZOS3, rcond=None)[0]
    named = {f"b{2 * n + 1 + k}": value[n] for n in range(3) for k, value in enumerate((amplitudes, rates))}
    return {name: float(value) for name, value in named.items()} | {"squares": float(left(logs) @ left(logs))}
