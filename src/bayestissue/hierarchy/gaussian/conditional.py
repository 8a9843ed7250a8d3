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
    """What the sites leave out of the log density of each entry's impacts, to second order.

    As a function of v, which holds X b, then the covariance (KK, KC, CC) of log K and log C about it, then
    the other parameters' variances.

    Attributes:
        prior_mean: X b where it was made.
        covariances: the rest of v where it was made.
        slope: first derivatives, summed over an entry's impacts.
        bend: second derivatives.
    """

    prior_mean: Float[Array, "parameter entry"]
    covariances: Float[Array, " entry"]
    slope: Float[Array, "v entry"]
    bend: Float[Array, "v v entry"]

    def value(self, prior_mean: Float[Array, "parameter entry"], covariances: Covariances) -> Array:
        """Of each entry, where X b is ``prior_mean``."""
        deviation = self._deviation(prior_mean, covariances)
        return (deviation * (self.slope + self._curved(deviation) / 2)).sum(0)

    def added_to(
        self, sums: CellSums, prior_mean: Float[Array, "parameter entry"], to: Covariances
    ) -> CellSums:
        """The sums at ``prior_mean`` with the expansion in them."""
        slope = self.slope + self._curved(self._deviation(prior_mean, to))
        size = len(prior_mean)
        precision, constant = (
            sums.precision - self.bend[:size, :size],
            sums.constant + self.value(prior_mean, to),
        )
        return CellSums(precision, sums.shift + slope[:size], constant)

    def _curved(self, deviation: Float[Array, "v entry"]) -> Float[Array, "v entry"]:
        return jnp.stack(small.times(self.bend, deviation))

    def _deviation(self, prior_mean: Array, covariances: Covariances) -> Array:
        moved = flat_covariances(covariances) - self.covariances
        common = jnp.broadcast_to(moved[:, None], (len(moved), prior_mean.shape[1]))
        return jnp.concatenate([prior_mean - self.prior_mean, common])


def flat_covariances(covariances: Covariances) -> Float[Array, "*draw entry"]:
    """The entries as `Expansion` has them."""
    return jnp.stack([*covariances.pair, *(sd**2 for sd in covariances.nuisance)], axis=-1)


class Data(NamedTuple):
    """All that the marginal density asks of the data.

    Attributes:
        design: X, arranged.
        mean: b's prior mean.
        blocked_sites: see `bayestissue.hierarchy.gaussian.impacts.sites_by_cell`.
        expansion: of what the sites leave out, where that is part of the density.
    """

    design: PopulationDesign
    mean: Float[Array, " location"]
    blocked_sites: SitesFirst
    expansion: Expansion | None = None

    def sums(self, covariances: Covariances) -> CellSums:
        """What the impacts of each entry say of X b, their own parameters integrated out."""
        prior_mean = expected_by_cell(self.design, self.mean)
        sums = cell_sums(covariances.of_impact(), prior_mean, self.blocked_sites)
        return sums if self.expansion is None else self.expansion.added_to(sums, prior_mean, covariances)


def log_marginal(data: Data, covariances: Covariances) -> Float[Array, ""]:
    """Log density of all sites, b and every u integrated out.

    Differentiable by the standard deviations alone, once, and backwards.
    """
    return log_density_of_cells(data.design, covariances, data.sums(covariances))
