"""The hierarchy given its hyperparameters, a Gaussian factor standing for each trace: all of it is normal.

Every impact's u and all effects b are integrated out in closed form, or drawn by an affine map of standard
normals. The map is exact whatever the factors are: only its whitening power depends on them, and the ratio of
likelihood to factor puts things right.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.gaussian.effects import log_density_of_cells
from bayestissue.hierarchy.gaussian.factor import GaussianFactor, cell_factors


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Data:
    """All that the marginal density asks of the data.

    Attributes:
        design: X, arranged.
        mean: b's prior mean.
        sites: of the impacts, see `PopulationDesign.blocked`.
    """

    design: PopulationDesign
    mean: Float[Array, " location"]
    sites: GaussianFactor

    @classmethod
    def from_sites(
        cls, design: PopulationDesign, mean: Float[Array, " location"], sites: GaussianFactor
    ) -> Data:
        """Without each impact's cell, so that what is compiled serves other numbers of impacts."""
        data = cls(design._replace(cell=np.zeros(0, int)), mean, design.blocked(sites))
        return jax.tree.map(jnp.asarray, data)

    def sums(self, covariances: Covariances) -> GaussianFactor:
        """What the impacts of each cell say of X b, their own parameters integrated out."""
        prior_mean = expected_by_cell(self.design, self.mean)
        return cell_factors(covariances.of_impact(), prior_mean, self.sites)


def log_marginal(data: Data, covariances: Covariances) -> Float[Array, ""]:
    """Log density of all sites, b and every u integrated out."""
    return log_density_of_cells(data.design, covariances, data.sums(covariances))
