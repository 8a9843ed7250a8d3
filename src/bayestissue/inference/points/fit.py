"""Point estimates of K and C for all impacts at once: ARMA(2,1), then A(2), then spring and damper."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Num

from bayestissue.inference.execution.compiling import FULLY, compiled_quickly
from bayestissue.inference.execution.workers import cluster, computed
from bayestissue.inference.points.profile import Profile, fit_conditional, fit_exact
from bayestissue.likelihood import SineTransforms, sine_transforms
from bayestissue.likelihood.transforms import FILLED
from bayestissue.oscillator import arccos_branch, from_differences, spring_damper
from bayestissue.padding import bucket

Method = Literal["exact", "dds"]
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
    method: Method,
    *,
    gravity: Column | None = None,
) -> PointFit:
    """Fit every impact by itself, all of them in one compiled function.

    Args:
        x: displacements from the rest position [m], padded at the end.
        n_samples: samples of each impact, at least 8.
        dt: sampling interval of each [s].
        mass: impacting mass of each [kg].
        method: "dds" is the thesis's conditional least squares on the deviations from the sample mean;
            "exact" maximises the exact likelihood with a free start about the zero of ``x``, where the fit of
            an ARMA(2,1) begins.
        gravity: along the motion of each [m/s^2], which gives "exact" the mean g / omega_n^2; "dds" takes the
            sample mean whatever it is.

    Raises:
        ValueError: an impact has fewer than eight samples.
    """
    x, n_samples = np.asarray(x, float), np.asarray(n_samples)
    if n_samples.min(initial=8) < 8:
        raise ValueError("an ARMA(2,1) needs at least eight samples")
    if len(x) == 0:
        return PointFit(*(np.empty(0, _TYPES.get(name, float)) for name in PointFit._fields))
    x = np.pad(x, ((0, 0), (0, _width(x.shape[1]) - x.shape[1])))
    few = len(x) < _FEW
    fall = np.zeros(len(x)) if gravity is None or method == "dds" else np.asarray(gravity, float)
    columns = (x, n_samples, np.asarray(dt, float), np.asarray(mass, float), fall)
    items = [(*(column[rows] for column in columns), method, few) for rows in _batches(len(x))]
    parts = dict(computed(_fit_of_batch, items, scheduler=cluster() if len(items) > 1 else None))
    ordered = [parts[number] for number in range(len(items))]
    whole = {name: np.concatenate([part[name] for part in ordered])[: len(x)] for name in PointFit._fields}
    return PointFit(**whole)


# With gravity w_t = x''_t + c1 x'_{t-1} + c2 x_{t-2} - c2 g / omega_n^2, of which the last is nearly g dt^2
# whatever the tissue is: what is left of an error of omega_n in it is its zeta omega_n dt-th part each round.
_ROUNDS = 6


def _fit_of_batch(
    item: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, Method, bool],
) -> dict[str, np.ndarray]:
    x, n_samples, dt, mass, gravity, method, few = item
    data = _prepared(x, n_samples, centred=method == "dds")
    fitted = _fit_few if few else _fit_batch
    fit, values = fitted(data, dt, mass, method)
    if gravity.any():
        # The second differences of a parabola are 1.
        one = sine_transforms(np.arange(x.shape[1]) ** 2 / 2 + np.zeros_like(x), n_samples).columns[0]
        share = np.ones_like(dt)
        for _ in range(_ROUNDS):
            falls = (data.columns[0] - (gravity * dt**2 * share)[:, None] * one, *data.columns[1:])
            fit, values = fitted(data._replace(columns=falls), dt, mass, method)
            omega_n, c2 = np.asarray(values["omega_n"]), np.asarray(fit.c2)
            known = np.isfinite(omega_n) & (omega_n > 0)
            equilibrium = np.where(known, gravity / np.where(known, omega_n, 1.0) ** 2, 0.0)
            share = np.where(known, c2 * equilibrium / (gravity * dt**2 + (gravity == 0)), 1.0)
    return {name: np.asarray(value) for name, value in values.items()}


def _batches(count: int) -> Iterator[np.ndarray]:
    """Batches of 16, 32 ... impacts, so that few sizes are ever compiled; filled up with the last impact."""
    size = -(-count // -(-count // BATCH))
    size = max(_FEWEST, 2 ** (size - 1).bit_length())
    for begin in range(0, count, size):
        yield np.minimum(np.arange(begin, begin + size), count - 1)


def _width(samples: int) -> int:
    """A width not much above ``samples`` from a short list, so that few widths are ever compiled."""
    return 2 + FILLED * bucket(max(1, -(-(samples - 2) // FILLED)))


def _prepared(x: np.ndarray, n_samples: np.ndarray, *, centred: bool) -> SineTransforms:
    inside = np.arange(x.shape[1]) < n_samples[:, None]
    if centred:
        x = np.where(inside, x - np.where(inside, x, 0).sum(1, keepdims=True) / n_samples[:, None], 0)
    data = sine_transforms(x, n_samples)
    shape = (data.spread.shape[0], len(x), data.spread.shape[2])
    return data._replace(spread=jnp.broadcast_to(data.spread, shape))


def _fit(
    data: SineTransforms, dt: Float[Array, " impact"], mass: Float[Array, " impact"], method: Method
) -> tuple[Profile, dict[str, Float[Array, " impact"]]]:
    fit = fit_conditional(data) if method == "dds" else fit_exact(data)
    phi1, phi2 = 2 - fit.c1, (fit.c1 - fit.c2) - 1
    # n samples that do not turn back are less than half a period, so the main value of arccos is right
    w, zeta = from_differences(fit.c1, fit.c2, None, 1.0)
    K, C = spring_damper(w / dt, zeta, mass)
    return fit, {
        "phi1": phi1,
        "phi2": phi2,
        "theta1": fit.theta1,
        "sigma_a": jnp.sqrt(fit.form / data.size),
        "omega_n": w / dt,
        "zeta": zeta,
        "K": K,
        "C": C,
        "branch": arccos_branch(phi1, phi2, fit.theta1),
        "noiseless": fit.form <= 4 * fit.floor,
        "theta1_at_limit": jnp.abs(fit.theta1) > 1 - 1 / data.size,
    }


_fit_batch = jax.jit(_fit, static_argnames="method", compiler_options=FULLY)
# Compiled in half the time, and ten times as long at it, which for few is not felt.
_fit_few = compiled_quickly(_fit, static_argnames="method")
