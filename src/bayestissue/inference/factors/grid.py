"""The likelihood of a parameter that traces may leave open, where no normal describes it."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.interpolate import pchip_interpolate
from scipy.special import logsumexp

from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.factors.conditional import ConditionalPrior, normals
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.padding import adds_nothing

PLACES = np.linspace(-8.0, 8.0, 161)
STEP = float(PLACES[1] - PLACES[0])


@adds_nothing
class LikelihoodGrid(NamedTuple):
    """Log likelihood of each impact's last parameter at `PLACES`, the others integrated out.

    For theta1, which a trace may leave open all the way to -1, and for what an element has besides K and C,
    which it leaves open where that is not needed: no normal describes such a likelihood.

    Attributes:
        log_likelihood: relative to the site, which is level along the last parameter.
    """

    log_likelihood: Float[Array, "grid impact"]

    def at(self, value: Float[Array, "*batch impact"]) -> Float[Array, "*batch impact"]:
        """Cubic interpolation, level beyond the grid."""
        number = self.log_likelihood.shape[0]
        place = jnp.clip((value - PLACES[0]) / STEP, 0.0, number - 1.0)
        index = jnp.clip(jnp.floor(place).astype(int), 1, number - 3)
        t = place - index
        columns = jnp.arange(self.log_likelihood.shape[1])
        a, b, c, d = (self.log_likelihood[index + k, columns] for k in (-1, 0, 1, 2))
        bend = a * (-0.5) + 1.5 * b - 1.5 * c + 0.5 * d
        return ((bend * t + a - 2.5 * b + 2 * c - 0.5 * d) * t + (c - a) / 2) * t + b

    @property
    def resolved(self) -> bool:
        """Whether the likelihoods are finite, and wide enough not to fall between the places.

        Where they do, the nearest place stands for each, and impacts that share it for a population without
        spread. A few such among many have their parameter off by half a step, and matter little.
        """
        table = np.asarray(self.log_likelihood)
        if not np.isfinite(table).all():
            return False
        place = np.clip(table.argmax(0), 1, len(table) - 2)
        before, top, after = (np.take_along_axis(table, (place + k)[None], 0)[0] for k in (-1, 0, 1))
        narrow = 2 * top - before - after > (STEP / LEAST_SD) ** 2
        return bool(narrow.mean() < _FEW_NARROW)

    def total(self, mean: Array, sd: Array) -> Float[Array, ""]:
        """The log evidence of all impacts together."""
        return self.log_evidence(mean, sd).sum()

    def log_evidence(self, mean: Array, sd: Array) -> Float[Array, " impact"]:
        """Log of the integral over a normal last parameter, by Gauss-Hermite quadrature."""
        points = mean + sd * jnp.asarray(_HERMITE_POINTS)[:, None]
        weights = jnp.asarray(_HERMITE_WEIGHTS / _HERMITE_WEIGHTS.sum())[:, None]
        return jax.nn.logsumexp(self.at(points), axis=0, b=weights)


# The narrowest likelihood of a last parameter, as its standard deviation: cubics between places 0.1 apart are
# off by some tenths there, and by anything below. No trace tells theta1 so well.
LEAST_SD, _FEW_NARROW = 0.025, 0.1
_DEEPEST = 200.0
# Stands for the log of no likelihood.
_NONE = -1e6
# Where only the place is asked for, every so many points of the grid are enough.
_ROUGHLY = 4
# At most 1.6 of a likelihood's standard deviations apart where that is a fourth of its population's or more:
# the integral's relative error is below 1e-3 then.
_HERMITE_POINTS, _HERMITE_WEIGHTS = np.polynomial.hermite_e.hermegauss(64)


def cleared_of_last(sites: Sites) -> Sites:
    """Sites that say nothing of the last parameter."""
    slope, precision = np.array(sites.slope), np.array(sites.precision)
    slope[:, -1], precision[:, -1], precision[:, :, -1] = 0.0, 0.0, 0.0
    return sites._replace(precision=precision, slope=slope)


def integrated_likelihood_grid(
    model: TraceModel,
    data: TraceData,
    cleared: Sites,
    anchor: ConditionalPrior,
    standard: Float[np.ndarray, "point parameter"],
    *,
    roughly: bool = False,
) -> LikelihoodGrid:
    """Tabulate the last parameter's likelihood, of which the sites are cleared.

    ``roughly`` is enough to tell where it is greatest, at a quarter of the cost.
    """
    grid = PLACES[:: _ROUGHLY if roughly else 1]
    u = normals(cleared, anchor).at(standard[:, None])
    number, impacts, size = u.shape
    moved = np.repeat(u[None], len(grid), axis=0)
    moved[..., -1] = grid[:, None, None]
    density = log_likelihoods(model, data, moved.reshape(-1, impacts, size))
    ratios = density.reshape(-1, number, impacts) - cleared.log_density(u)
    table = logsumexp(np.maximum(ratios, _NONE), axis=1) - np.log(number)
    # Cubics overshoot where a steep fall ends; so far down it does not matter.
    table = np.maximum(table, table.max(0) - _DEEPEST)
    if roughly:
        table = pchip_interpolate(grid, table, PLACES)
    return LikelihoodGrid(jnp.asarray(table))
