"""A smooth motion of unknown shape: its values and rates by a few fixed functions of time.

Over a window of length T, with t in [0, 1] of it,

    x(t) = a_0 + a_1 t + a_2 t^2 + s int_0^t (t - u)^2 / 2 g(u) dW(u),    g(u) = (1 + u / e)^-2:

a jerk that is white noise of the intensity s^2 g(u)^2, from a beginning of which nothing is known. What is
hit at a speed is stopped in a jerk, and pressed smoothly from then on: the jerk falls within e = `SETTLES`.
Were it as great everywhere, x would be a quintic smoothing spline (Wahba 1978,
doi:10.1111/j.2517-6161.1978.tb01050.x). The integral has the covariance s^2 k; with w = 1 + u / e,
b = 1 + t / e, b' = 1 + t' / e, S = b + b', P = b b', and a the less of b and b',

    k(t, t') = e^5 / 4 int_1^a w^-4 (b - w)^2 (b' - w)^2 dw
             = e^5 / 4 [w - 2 S log w - (S^2 + 2 P) / w + S P / w^2 - P^2 / (3 w^3)]_1^a,

and is taken as s sum_j z_j f_j(t), z standard normal, f_j being the root of k's j-th eigenvalue times its
eigenfunction (Nystroem's method on Gauss and Legendre's nodes). Eigenvalues fall as j^-6.
"""

from __future__ import annotations

from functools import cache

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

# a_0, a_1 and a_2 come first.
POWERS = 3
MODES = 16
_NODES = 64
# Of the window. By then the jerk is a quarter of what it was at contact.
SETTLES = 0.4
# Of `interpolated`: from where to where, in windows, and in how many steps.
_BEGIN, _END, _STEPS = -0.5, 1.5, 256


def kernel(
    t: Float[np.ndarray, "*time"], t_prime: Float[np.ndarray, "*#time"]
) -> tuple[Float[np.ndarray, "*time"], Float[np.ndarray, "*time"]]:
    """k(t, t') and its slope in t; 0 before contact, from where the parabola alone goes back."""
    b, b_prime = 1 + t / SETTLES, 1 + t_prime / SETTLES
    S, P, a = b + b_prime, b * b_prime, np.maximum(np.minimum(b, b_prime), 1.0)
    log, inverse = np.log(a), [a**-power - 1 for power in range(4)]
    value = a - 1 - 2 * S * log - (S**2 + 2 * P) * inverse[1] + S * P * inverse[2] - P**2 * inverse[3] / 3
    # The derivatives in S and in P: at w = b the integrand is 0.
    of_S = -2 * log - 2 * S * inverse[1] + P * inverse[2]
    of_P = -2 * inverse[1] + S * inverse[2] - 2 / 3 * P * inverse[3]
    return SETTLES**5 / 4 * value, SETTLES**4 / 4 * (of_S + b_prime * of_P)


@cache
def _eigenvectors() -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, "node mode"]]:
    """Nodes in [0, 1], and the weights that k(t, node) has in each f_j(t)."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    node, root = (node + 1) / 2, np.sqrt(weight / 2)
    values, vectors = np.linalg.eigh(root[:, None] * kernel(node[:, None], node)[0] * root)
    values, vectors = values[: -MODES - 1 : -1], vectors[:, : -MODES - 1 : -1]
    return node, root[:, None] * vectors / np.sqrt(values)


def functions(
    t: Float[np.ndarray, "impact sample"],
) -> tuple[Float[np.ndarray, "impact sample function"], Float[np.ndarray, "impact sample function"]]:
    """1, t, t^2 and f_1 to f_`MODES` at each time, and their slopes.

    Args:
        t: since contact, as a fraction of the window.
    """
    node, weights = _eigenvectors()
    value, slope = kernel(t[..., None], node)
    one = np.ones_like(t)
    powers = np.stack([one, t, t**2], axis=-1), np.stack([0 * one, one, 2 * t], axis=-1)
    basis, slopes = (
        np.concatenate([first, part @ weights], axis=-1)
        for first, part in zip(powers, (value, slope), strict=True)
    )
    return basis, slopes


@cache
def _table() -> tuple[Float[np.ndarray, "node function"], Float[np.ndarray, "node function"]]:
    """`functions` on a grid of even steps."""
    basis, slopes = functions(np.linspace(_BEGIN, _END, _STEPS + 1)[None])
    return basis[0], slopes[0]


def interpolated(t: Float[Array, "impact sample"]) -> Float[Array, "impact sample function"]:
    """The functions at times that depend on a parameter: Hermite's cubics between the nodes of a grid.

    They miss each f_j by less than 1e-8.
    """
    step = (_END - _BEGIN) / _STEPS
    position = (t - _BEGIN) / step
    node = jnp.clip(jnp.floor(position).astype(int), 0, _STEPS - 1)
    p = (position - node)[..., None]
    (lower, upper), (rise, fall) = (
        (jnp.asarray(values)[node], jnp.asarray(values)[node + 1]) for values in _table()
    )
    of_slopes = step * p * (1 - p) * ((1 - p) * rise - p * fall)
    return (1 + 2 * p) * (1 - p) ** 2 * lower + p**2 * (3 - 2 * p) * upper + of_slopes
