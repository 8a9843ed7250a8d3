"""The posterior mode of the standard deviations, and the curvature there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from bayestissue.hierarchy.half_normal import HalfNormalSpread
from bayestissue.hierarchy.traces import Hyperparameters

# Of the log of a standard deviation over its prior's scale, and of any other unconstrained coordinate.
_BOUNDS = (-9.0, 5.0)
# Where a mode is looked for unless one is known: a fifth of the prior's scale.
_BEGIN = -1.5
_STEP = 1e-4


def find_mode(
    model: Hyperparameters,
    names: tuple[str, ...],
    value_and_slope: Callable[[Float[np.ndarray, " site"]], tuple[float, Float[np.ndarray, " site"]]],
    start: Float[np.ndarray, " site"] | None = None,
) -> Float[np.ndarray, " site"]:
    """Where a function of the unconstrained hyperparameters is least.

    The way there goes by logs: an expansion about a point that is no maximum says nothing of values far
    beyond what it has seen, but has a minimum there, and on the coordinate y with sd = scale log(1 + e^y)
    a first step is long enough to find it.

    Args:
        model: whose hyperparameters they are.
        names: of the sites, one coordinate each.
        value_and_slope: of the function, at unconstrained coordinates.
        start: where to begin.
    """
    priors = {name: model.prior_of(name) for name in model.hyperparameters}
    by_log = np.array([isinstance(priors.get(name), HalfNormalSpread) for name in names])

    def at(flat: np.ndarray) -> tuple[float, np.ndarray]:
        sd = np.exp(np.where(by_log, flat, 0.0))
        value, slope = value_and_slope(_unconstrained(flat, by_log))
        return value, np.where(by_log, sd / -np.expm1(-sd), 1.0) * slope

    begin = np.full(len(names), _BEGIN)
    if start is not None:
        begin = np.where(by_log, np.log(np.logaddexp(0.0, start)), start)
    optimum = minimize(at, begin, jac=True, method="L-BFGS-B", bounds=[_BOUNDS] * len(begin)).x
    return _unconstrained(optimum, by_log)


def covariance_about(
    slope: Callable[[Float[np.ndarray, " site"]], Float[np.ndarray, " site"]],
    point: Float[np.ndarray, " site"],
) -> Float[np.ndarray, "site site"]:
    """The inverse of a function's curvature at a place, from differences of its slope.

    A direction that is flat there, as the log of a small standard deviation is, gets unit scale.

    Raises:
        FloatingPointError: the function has no finite slopes there.
    """
    steps = _STEP * np.eye(len(point))
    slopes = np.array([[slope(point + side * step) for step in steps] for side in (1, -1)])
    if not np.isfinite(slopes).all():
        raise FloatingPointError("the marginal density has no finite slope about its mode")
    curvature, axes = np.linalg.eigh((slopes[0] - slopes[1]) / (2 * _STEP))
    return (axes / np.maximum(curvature, 1.0)) @ axes.T


def _unconstrained(flat: np.ndarray, by_log: np.ndarray) -> np.ndarray:
    """Y of log(log(1 + e^y)), or the coordinate itself."""
    sd = np.exp(np.where(by_log, flat, 0.0))
    # log(e^s - 1), whose exponential must not overflow.
    return np.where(by_log, sd + np.log(-np.expm1(-sd)), flat)
