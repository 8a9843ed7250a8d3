"""A smooth motion of unknown shape: its values and rates by a few fixed functions of time.

Over a window of length T, with t in [0, 1] of it,

    x(t) = a_0 + a_1 t + a_2 t^2 + s int_0^t (t - u)^2 / 2 dW(u):

a jerk that is white noise of the intensity s^2, from a beginning of which nothing is known. Its mean given
samples is a quintic smoothing spline (Wahba 1978, doi:10.1111/j.2517-6161.1978.tb01050.x). The integral has
the covariance s^2 k,

    k(t, t') = (a^5 / 5 + d a^4 / 2 + d^2 a^3 / 3) / 4,    a = min(t, t'), d = |t - t'|,

and is taken as s sum_j z_j f_j(t), z standard normal, f_j being the root of k's j-th eigenvalue times its
eigenfunction (Nystroem's method on Gauss and Legendre's nodes). Eigenvalues fall as j^-6.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float

# a_0, a_1 and a_2 come first.
POWERS = 3
MODES = 16
_NODES = 64


def kernel(
    t: Float[np.ndarray, "*time"], t_prime: Float[np.ndarray, "*#time"]
) -> tuple[Float[np.ndarray, "*time"], Float[np.ndarray, "*time"]]:
    """k(t, t') and its slope in t."""
    a, d = np.minimum(t, t_prime), np.abs(t - t_prime)
    value = (a**5 / 5 + d * a**4 / 2 + d**2 * a**3 / 3) / 4
    # int_0^a (t - u) (t' - u)^2 / 2 du, the longer of the two reaching d beyond a.
    slope = np.where(t <= t_prime, a**4 / 4 + 2 * d * a**3 / 3 + d**2 * a**2 / 2, a**4 / 4 + d * a**3 / 3) / 2
    return value, slope


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
