"""Impacts' parameters given the population and the sites, as numpy arrays of any number of draws.

The algebra is that of `bayestissue.hierarchy.gaussian.impacts`; parameters are on the last axis.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import norm, qmc

from bayestissue.hierarchy.gaussian.impacts import (
    ImpactConditional,
    ImpactPrior,
    Sites,
    parameters_first,
)

POINTS = 64


def evenly_spaced(count: int, number: int = POINTS) -> Int[np.ndarray, " number"]:
    """Places of so many draws among ``count`` of them."""
    return np.linspace(0, count - 1, number).astype(int)


class ConditionalPrior(NamedTuple):
    """A normal prior of each impact's parameters: what the rest of the data say of them.

    Attributes:
        mean: of each impact.
        precision: of each impact, or one of all.
    """

    mean: Float[Any, "impact parameter"]
    precision: Float[Any, "*#impact parameter parameter"]

    def of_each(self) -> ConditionalPrior:
        """The same with a precision of each impact."""
        shape = (*self.mean.shape, self.mean.shape[-1])
        return self._replace(precision=np.broadcast_to(self.precision, shape))

    def log_density(
        self, u: Float[np.ndarray, "*point impact parameter"]
    ) -> Float[np.ndarray, "*point impact"]:
        """Up to a constant."""
        away = u - self.mean
        return -np.vecdot(away, np.matvec(self.precision, away)) / 2


def standard_points(size: int, number: int = POINTS) -> Float[np.ndarray, "point parameter"]:
    """Normal points that fill the space evenly: Sobol's sequence and its mirror image."""
    uniform = qmc.Sobol(size, seed=20).random(number // 2)
    half = norm.ppf(np.clip(uniform, 1e-9, 1 - 1e-9))
    return np.concatenate([half, -half])


class Normals(NamedTuple):
    """Where the population and the sites put impacts' parameters, of one or more draws of the population.

    Attributes:
        given: the conditional of `bayestissue.hierarchy.gaussian.impacts`.
        about: X b, the parameters first.
    """

    given: ImpactConditional
    about: Float[np.ndarray, "parameter *draw impact"]

    def at(
        self, z: Float[np.ndarray, "*draw impact parameter"]
    ) -> Float[np.ndarray, "*draw impact parameter"]:
        """From standard normals."""
        return np.stack(self.given.draw(self.about, np.moveaxis(z, -1, 0)), axis=-1)


def normals(sites: Sites, anchor: ConditionalPrior) -> Normals:
    """See `Normals`; of the sites and a conditional prior N(a, D^-1) of one or more draws."""
    precision = np.moveaxis(anchor.precision, (-2, -1), (0, 1))
    prior = ImpactPrior(precision, np.linalg.slogdet(anchor.precision)[1])
    given = ImpactConditional.of(prior, parameters_first(sites))
    return Normals(given, np.moveaxis(anchor.mean, -1, 0))


def log_evidence(sites: Sites, anchor: ConditionalPrior) -> Float[np.ndarray, "*draw impact"]:
    """Log of the integral of each site over a conditional prior, of one or more draws of the population."""
    given, about = normals(sites, anchor)
    return given.log_density(about)
