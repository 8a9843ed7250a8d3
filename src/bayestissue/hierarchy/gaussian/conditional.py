"""The hierarchy given its hyperparameters, a Gaussian site standing for each trace: all of it is normal.

Every impact's u and all effects b are integrated out in closed form, or drawn by an affine map of standard
normals. The map is exact whatever the sites are: only its whitening power depends on them, and the ratio of
likelihood to site puts things right.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.gaussian.effects import log_density_of_cells
from bayestissue.hierarchy.gaussian.impacts import CellSums, SitesFirst, cell_sums
from bayestissue.likelihood import small


class Expansion(NamedTuple):
    """What the sites leave out of the log density of each place's impacts, to second order.

    As a function of v, which holds X b, then the covariance (KK, KC, CC) of log K and log C about it, then
    the other parameters' variances.

    Attributes:
        about: X b where it was made.
        covariances: the rest of v where it was made.
        slope: first derivatives, summed over a place's impacts.
        bend: second derivatives.
    """

    about: Float[Array, "parameter place"]
    covariances: Float[Array, " entry"]
    slope: Float[Array, "v place"]
    bend: Float[Array, "v v place"]

    def value(self, about: Float[Array, "parameter place"], covariances: Covariances) -> Array:
        """Of each place, where X b is ``about``."""
        away = self._away(about, covariances)
        return (away * (self.slope + self._bent(away) / 2)).sum(0)

    def added_to(self, sums: CellSums, about: Float[Array, "parameter place"], to: Covariances) -> CellSums:
        """The sums at ``about`` with the expansion in them."""
        turned = self.slope + self._bent(self._away(about, to))
        size = len(about)
        weight, constant = sums.weight - self.bend[:size, :size], sums.constant + self.value(about, to)
        return CellSums(weight, sums.pull + turned[:size], constant)

    def _bent(self, away: Float[Array, "v place"]) -> Float[Array, "v place"]:
        return jnp.stack(small.times(self.bend, away))

    def _away(self, about: Array, covariances: Covariances) -> Array:
        moved = flat_covariances(covariances) - self.covariances
        common = jnp.broadcast_to(moved[:, None], (len(moved), about.shape[1]))
        return jnp.concatenate([about - self.about, common])


def flat_covariances(covariances: Covariances) -> Float[Array, "*draw entry"]:
    """The entries as `Expansion` has them."""
    return jnp.stack([*covariances.own, *(sd**2 for sd in covariances.nuisance)], axis=-1)


class Data(NamedTuple):
    """All that the marginal density asks of the data.

    Attributes:
        design: X, arranged.
        mean: b's prior mean.
        laid: the sites by place, see `bayestissue.hierarchy.gaussian.impacts.lay`.
        expansion: of what the sites leave out, where that is part of the density.
    """

    design: PopulationDesign
    mean: Float[Array, " location"]
    laid: SitesFirst
    expansion: Expansion | None = None

    def sums(self, covariances: Covariances) -> CellSums:
        """What the impacts of each place say of X b, their own parameters integrated out."""
        about = expected_by_cell(self.design, self.mean)
        sums = cell_sums(covariances.of_impact(), about, self.laid)
        return sums if self.expansion is None else self.expansion.added_to(sums, about, covariances)


def log_marginal(data: Data, covariances: Covariances) -> Float[Array, ""]:
    """Log density of all sites, b and every u integrated out.

    Differentiable by the standard deviations alone, once, and backwards.
    """
    return log_density_of_cells(data.design, covariances, data.sums(covariances))
