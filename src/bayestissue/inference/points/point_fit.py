"""Point estimates of K and C for all impacts at once: ARMA(2,1), then A(2), then spring and damper."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Num

from bayestissue.base.padding import bucket
from bayestissue.inference.execution.compiling import FULLY, compiled_quickly, in_parts
from bayestissue.inference.points.profile import fit_conditional
from bayestissue.mechanics.oscillator import arccos_branch, from_differences, spring_damper
from bayestissue.model.likelihood.transforms import FILLED

Column = Float[np.ndarray, " impact"]
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

    phi1: Column
    phi2: Column
    theta1: Column
    sigma_a: Column
    omega_n: Column
    zeta: Column
    K: Column
    C: Column
    branch: Num[np.ndarray, " impact"]
    noiseless: Num[np.ndarray, " impact"]
    theta1_at_limit: Num[np.ndarray, " impact"]


def fit_points(
    x: Float[np.ndarray, "impact sample"],
    n_samples: Num[np.ndarray, " impact"],
    dt: Column,
    mass: Column,
    gravity: Column | None = None,
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

    def batch(*columns: np.ndarray) -> PointFit:
        count = len(columns[0])
        rows = np.minimum(np.arange(size), count - 1)
        return PointFit(*(np.asarray(values)[:count] for values in fitted(*(c[rows] for c in columns))))

    fit: PointFit = in_parts(batch, columns, size)
    return fit


def _fit(
    x: Float[Array, "impact sample"],
    size: Float[Array, " impact"],
    dt: Float[Array, " impact"],
    mass: Float[Array, " impact"],
    fall: Float[Array, " impact"],
) -> PointFit:
    fit = fit_conditional(x, size, fall)
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
