"""Conditional priors N(X b, D^-1) of impacts' parameters, of any number of draws of the population.

With the sites they give normals to draw from and each trace's evidence. The algebra is that of
`bayestissue.model.hierarchy.gaussian.factor`; parameters are on the last axis.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayestissue.inference.execution.compiling import by_row
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.model.hierarchy.gaussian.factor import Conditional, GaussianFactor
from bayestissue.model.hierarchy.population import Population
from bayestissue.model.hierarchy.trace_models import TraceModel

# Draws of one call.
DRAWS = 64


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
        deviation = u - self.mean
        return -np.vecdot(deviation, np.matvec(self.precision, deviation)) / 2


class Normals(NamedTuple):
    """Where the population and the sites put impacts' parameters, of one or more draws of the population.

    Attributes:
        conditional: of the parameters, see `bayestissue.model.hierarchy.gaussian.factor`.
        prior_mean: X b, parameters first.
    """

    conditional: Conditional
    prior_mean: Float[np.ndarray, "parameter *draw impact"]

    def at(
        self, z: Float[np.ndarray, "*draw impact parameter"]
    ) -> Float[np.ndarray, "*draw impact parameter"]:
        """From standard normals."""
        return np.stack(self.conditional.draw(self.prior_mean, np.moveaxis(z, -1, 0)), axis=-1)


def normals(sites: GaussianFactor, prior: ConditionalPrior) -> Normals:
    """See `Normals`; of the sites and a conditional prior N(a, D^-1) of one or more draws."""
    precision = np.moveaxis(prior.precision, (-2, -1), (0, 1))
    return Normals(Conditional(precision, sites.batch_last()), np.moveaxis(prior.mean, -1, 0))


def log_evidence(sites: GaussianFactor, prior: ConditionalPrior) -> Float[np.ndarray, "*draw impact"]:
    """Log of the integral of each site over a conditional prior, of one or more draws of the population."""
    conditional, prior_mean = normals(sites, prior)
    return conditional.marginal(prior_mean).log_scale


def conditional_priors(
    model: TraceModel, design: PopulationDesign, population: Population, rows: Int[np.ndarray, " impact"]
) -> ConditionalPrior:
    """The conditional prior of some impacts in each draw [chain, draw, ...] of the population."""
    cell = np.asarray(design.cell)[rows]
    # Without each impact's cell, so that what is compiled serves other numbers of impacts.
    priors = _of_cells(model, design._replace(cell=np.zeros(0, int)), population)
    return priors._replace(mean=priors.mean[:, :, cell])


@by_row(DRAWS, constant=2, axes=2)
def _of_cells(model: TraceModel, design: PopulationDesign, population: Population) -> ConditionalPrior:
    D = model.covariances(population.hyperparameters).of_impact()
    return ConditionalPrior(expected_by_cell(design, population.b).T, D[None])
