"""Coordinates in which the posterior of the standard deviations is nearly normal, about its mode.

Of ten people or nine conditions the data may leave a standard deviation anywhere below some value, and its
log a tail that thins out as an exponential does: a chain that is as quick as the steep side allows is slow on
the other. Each coordinate is warped until its density along its own axis has the quantiles of a normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize
from scipy.stats import norm

from bayestissue.hierarchy.half_normal import HalfNormalSpread
from bayestissue.hierarchy.traces import Hyperparameters
from bayestissue.hierarchy.warp import SinhArcsinh

Densities = Callable[[Float[np.ndarray, "point coordinate"]], Float[np.ndarray, " point"]]

# Where an axis is looked at, as a normal's values: less often and it would be missed how it bends.
_POINTS = np.linspace(-4.0, 4.0, 17)
_FINELY = np.linspace(-4.0, 4.0, 801)
# Each time from where the last left off, since a scale that is not known yet is off by a few times; until
# no quantile moves by more than this share of the scale.
_MOST_TIMES, _SETTLED = 6, 0.05
_TAIL = float(norm.ppf(0.95))
# Between a line and where the hyperbola would turn back.
_MOST_BENT = 0.9
# Relative to the greatest; what is less likely is no part of the posterior.
_DEEPEST = -60.0

# Of the log of a standard deviation over its prior's scale, and of any other unconstrained coordinate.
_BOUNDS = (-9.0, 5.0)
# Where a mode is looked for unless one is known: a fifth of the prior's scale.
_BEGIN = -1.5
_STEP = 1e-4


@dataclass(frozen=True)
class Coordinates:
    """Warped coordinates y of a posterior's sites, each a number.

    Attributes:
        names: of the sites, one coordinate each.
        warp: from y to the sites' unconstrained values.
        covariance: of y about 0, to second order.
    """

    names: tuple[str, ...]
    warp: SinhArcsinh
    covariance: Float[np.ndarray, "coordinate coordinate"]

    def raw(self, y: Float[np.ndarray, "*draw coordinate"]) -> dict[str, Float[np.ndarray, "*draw"]]:
        """The sites' unconstrained values."""
        values = np.asarray(self.warp(np.asarray(y)))
        return {name: values[..., number] for number, name in enumerate(self.names)}


def unwarped(size: int) -> SinhArcsinh:
    """The map of so many numbers that changes nothing."""
    return SinhArcsinh(np.zeros(size), np.ones(size), np.zeros(size))


def warp_about(
    log_densities: Densities, mode: Float[np.ndarray, " coordinate"], scale: Float[np.ndarray, " coordinate"]
) -> SinhArcsinh:
    """The warp that gives the density along each axis a normal's 5, 50 and 95 % quantiles.

    Args:
        log_densities: of points, each of all coordinates, up to a constant.
        mode: where it is greatest.
        scale: of each coordinate there.

    Raises:
        FloatingPointError: no point along an axis has a density.
    """
    warp = SinhArcsinh(mode, scale, np.zeros_like(mode))
    last = np.full((3, len(mode)), np.inf)
    for _ in range(_MOST_TIMES):
        quantiles = np.array([_quantiles(log_densities, warp, number) for number in range(len(mode))]).T
        low, middle, high = quantiles
        along = (high - low) / (2 * _TAIL)
        bend = (high + low - 2 * middle) / (2 * (np.sqrt(1 + _TAIL**2) - 1))
        warp = SinhArcsinh(middle, along, np.clip(bend, -_MOST_BENT * along, _MOST_BENT * along))
        if (np.abs(quantiles - last) < _SETTLED * along).all():
            break
        last = quantiles
    return warp


def _quantiles(log_densities: Densities, warp: SinhArcsinh, number: int) -> Float[np.ndarray, 3]:
    """Of one coordinate, all others at the middle of the warp."""
    marginal = warp.part(number)
    points = np.repeat(np.array(warp.location)[None], len(_POINTS), axis=0)
    points[:, number] = marginal(_POINTS)
    values = np.nan_to_num(log_densities(points), nan=-np.inf)
    if not np.isfinite(values.max()):
        raise FloatingPointError("the density has no finite value along an axis about its mode")
    values = np.maximum(values - values.max(), _DEEPEST)
    density = np.exp(PchipInterpolator(_POINTS, values)(_FINELY)) * np.asarray(marginal.slope(_FINELY))
    below = np.cumsum(density) - density / 2
    # A scale too small sees tails that do not end: the quantiles are then at its own, and grow next time.
    quantiles = np.interp([1 - norm.cdf(_TAIL), 0.5, norm.cdf(_TAIL)], below / density.sum(), _FINELY)
    return np.asarray(marginal(quantiles))


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
    """The coordinate y whose log(log(1 + e^y)) is ``flat``, where it is one of logs."""
    sd = np.exp(np.where(by_log, flat, 0.0))
    # log(e^s - 1), whose exponential must not overflow.
    return np.where(by_log, sd + np.log(-np.expm1(-sd)), flat)


def coordinates_about(
    names: tuple[str, ...],
    potential: Callable[..., tuple[float, Float[np.ndarray, " site"]]],
    mode: Float[np.ndarray, " site"],
    log_densities: Densities | None = None,
) -> Coordinates:
    """Warped coordinates of a density about its mode.

    Args:
        names: of the sites, one coordinate each.
        potential: minus the log density of coordinates, and its gradient; those that a warp leads from, where
            there is one as a second argument.
        mode: of the unwarped coordinates.
        log_densities: of many points at once, where that is quicker than one after the other.
    """

    def one_by_one(points: np.ndarray) -> np.ndarray:
        return np.array([-potential(y)[0] for y in points])

    scale = np.sqrt(np.diagonal(covariance_about(lambda y: potential(y)[1], mode)))
    warp = warp_about(log_densities or one_by_one, mode, scale)
    return Coordinates(names, warp, covariance_about(lambda y: potential(y, warp)[1], np.zeros(len(mode))))
