"""The conditional of each impact's parameters, its factor being a Gaussian site: u integrated out, or drawn.

With a site exp(l + g'(u - m) - (u - m)'P (u - m) / 2) and the prior u ~ N(X b, D^-1), u given X b is
N(m + V (g + D (X b - m)), V) with V = (P + D)^-1, and the site with u integrated out is, as a function of
X b, another such site about m, of precision W = D V P and slope D V g. Written so, and not as D - D V D, W
keeps its digits where a standard deviation tends to 0, and is 0 where the site says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.likelihood import small
from bayestissue.padding import adds_nothing


@adds_nothing
class Sites(NamedTuple):
    """Gaussian sites: each trace's log likelihood to second order.

    Attributes:
        centre: m, where it was made.
        slope: g.
        precision: P, positive definite.
        log_likelihood: l, the log likelihood at m.
    """

    centre: Float[Any, "impact parameter"]
    slope: Float[Any, "impact parameter"]
    precision: Float[Any, "impact parameter parameter"]
    log_likelihood: Float[Any, " impact"]

    def log_density(self, u: Any) -> Any:
        """Log of the sites at ``u``."""
        deviation = u - self.centre
        curved = (self.precision * deviation[..., None, :]).sum(-1)
        return self.log_likelihood + (deviation * (self.slope - curved / 2)).sum(-1)


class SitesFirst(NamedTuple):
    """`Sites` with the axes of parameters before those of impacts, of which there may be several.

    Arranged by `sites_by_cell` they have one axis more before all of these, of blocks.
    """

    centre: Float[Array, " ..."]
    slope: Float[Array, " ..."]
    precision: Float[Array, " ..."]
    log_likelihood: Float[Array, " ..."]


class ImpactPrior(NamedTuple):
    """The conditional prior of impacts' parameters about X b.

    Attributes:
        precision: D.
        log_determinant: of D.
    """

    precision: Float[Array, "parameter parameter *#impact"]
    log_determinant: Float[Array, " *#impact"]


@dataclass(frozen=True)
class ImpactConditional:
    """u of impacts given X b, in entries: see `bayestissue.likelihood.small`.

    Attributes:
        prior: of u, whose axes behind the parameters broadcast with the sites' own.
        sites: of the impacts, as `parameters_first` makes them.
        factor: L, with L L' = P + D.
    """

    prior: ImpactPrior
    sites: SitesFirst
    factor: small.Triangle

    @classmethod
    def from_sites(cls, prior: ImpactPrior, sites: SitesFirst) -> ImpactConditional:
        """Of sites with the parameters first."""
        size, (p, d) = len(sites.precision), (sites.precision, prior.precision)
        precision = [[p[a][b] + d[a][b] for b in range(a + 1)] for a in range(size)]
        return cls(prior, sites, small.cholesky(precision))

    @cached_property
    def _root(self) -> small.Triangle:
        """L^-1."""
        return small.inverse_factor(self.factor)

    @cached_property
    def _of_prior(self) -> small.Matrix:
        """L^-1 D."""
        return small.product(self._root, self.prior.precision)

    @cached_property
    def _of_site(self) -> small.Matrix:
        """L^-1 P."""
        return small.product(self._root, self.sites.precision)

    @cached_property
    def covariance(self) -> small.Matrix:
        """V = L'^-1 L^-1."""
        return small.squared(self._root)

    @cached_property
    def shrinkage(self) -> small.Matrix:
        """V P, by which the mean of u moves from X b towards what the site says."""
        columns = small.transposed(self._of_site)
        return small.transposed([small.turned_times(self._root, column) for column in columns])

    @cached_property
    def marginal_precision(self) -> small.Matrix:
        """W = D V P, the precision with which a site tells X b."""
        columns = [small.transposed(part) for part in (self._of_prior, self._of_site)]
        return small.symmetric(len(self.factor), lambda a, b: small.dot(columns[0][a], columns[1][b]))

    def _toward_site(self, prior_mean: small.Vector) -> small.Vector:
        """L^-1 (g - P (X b - m))."""
        curved = small.times(self._of_site, self._deviation(prior_mean))
        return [g - b for g, b in zip(small.times(self._root, self.sites.slope), curved, strict=True)]

    def _deviation(self, prior_mean: small.Vector) -> small.Vector:
        return [v - m for v, m in zip(prior_mean, self.sites.centre, strict=True)]

    def mean_shift(self, prior_mean: small.Vector) -> small.Vector:
        """The mean of u less X b, where that is ``prior_mean``: V g - V P (X b - m)."""
        return small.turned_times(self._root, self._toward_site(prior_mean))

    def marginal_shift(self, prior_mean: small.Vector) -> small.Vector:
        """The slope of `log_density`: D V g - W (X b - m)."""
        return small.times(small.transposed(self._of_prior), self._toward_site(prior_mean))

    def log_density(self, prior_mean: small.Vector) -> small.Entry:
        """Log of the sites, u integrated out, where X b is ``prior_mean``."""
        half = small.times(self._root, self.sites.slope)
        toward = self._toward_site(prior_mean)
        # (X b - m)' (D V g - W (X b - m) / 2), in factors.
        near = [(h + t) / 2 for h, t in zip(half, toward, strict=True)]
        gained = small.dot(near, small.times(self._of_prior, self._deviation(prior_mean)))
        scale = self.prior.log_determinant / 2 - small.log_diagonal(self.factor)
        return self.sites.log_likelihood + scale + gained + small.dot(half, half) / 2

    def toward(self, prior_mean: small.Vector) -> small.Vector:
        """L^-1 (g + D (X b - m)), where X b is ``prior_mean``."""
        prior_shift = small.times(self.prior.precision, self._deviation(prior_mean))
        right = [g + p for g, p in zip(self.sites.slope, prior_shift, strict=True)]
        return small.solve_lower(self.factor, right)

    def draw(self, prior_mean: small.Vector, standard: small.Vector) -> small.Vector:
        """U from standard normals: N(m + V (g + D (X b - m)), V)."""
        half = [h + z for h, z in zip(self.toward(prior_mean), standard, strict=True)]
        pairs = zip(self.sites.centre, small.solve_upper(self.factor, half), strict=True)
        return [m + mean_shift for m, mean_shift in pairs]


def parameters_first(sites: Sites) -> SitesFirst:
    """The same with the axes of parameters before those of impacts."""
    centre, slope, precision, level = sites
    move = precision.__array_namespace__().moveaxis
    return SitesFirst(move(centre, -1, 0), move(slope, -1, 0), move(precision, (-2, -1), (0, 1)), level)


class CellSums(NamedTuple):
    """What the impacts of each entry of the design say of X b there, their own parameters integrated out.

    Each entry's log density is constant + shift'(v - v0) - (v - v0)' precision (v - v0) / 2 as a function of
    v = X b, v0 being X b at b's prior mean. Of an estimate y ~ N(v, D^-1) that is known exactly the precision
    is D, the shift D (y - v0), and the constant its log density at v0.
    """

    precision: Float[Array, "parameter parameter entry"]
    shift: Float[Array, "parameter entry"]
    constant: Float[Array, " entry"]


def sites_by_cell(design: PopulationDesign, sites: Sites) -> SitesFirst:
    """The sites, parameters first, of every entry's impacts: [block, parameter, ..., repeat, entry].

    Entries without an impact have sites that say nothing, of which nothing is left in any sum.
    """
    xp = sites.precision.__array_namespace__()

    def blocked(values: Any) -> Any:
        none = xp.zeros((1, *values.shape[1:]))
        return xp.moveaxis(xp.concat([values, none])[design.members], (1, 2), (-2, -1))

    return SitesFirst(*map(blocked, sites))


@jax.custom_vjp
def cell_sums(prior: ImpactPrior, prior_mean: Float[Array, "parameter entry"], sites: SitesFirst) -> CellSums:
    """Integrate every impact's parameters out, and sum what is left over each entry's impacts.

    Differentiable by the prior alone, once, and backwards: the derivatives of the sums by D are expectations
    (Fisher's identity), with half of the operations.

    Args:
        prior: of an impact's parameters, one of all impacts.
        prior_mean: X b at b's prior mean.
        sites: as `sites_by_cell` arranges them.
    """
    precision, shift, constant = _over_blocks(partial(_sums_of_block, prior, prior_mean), sites)
    return CellSums(small.stacked(precision), jnp.stack(shift), constant)


def _over_blocks(function: Any, sites: SitesFirst) -> Any:
    """Sum over blocks of what ``function`` makes of each, one after the other."""
    if len(sites.centre) == 1:
        return function(jax.tree.map(lambda leaf: leaf[0], sites))

    def add(total: Any, block: SitesFirst) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, function(block)), None

    first = jax.eval_shape(function, jax.tree.map(lambda leaf: leaf[0], sites))
    return jax.lax.scan(add, jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), first), sites)[0]


def _sums_of_block(prior: ImpactPrior, prior_mean: Array, sites: SitesFirst) -> Any:
    conditional = ImpactConditional.from_sites(prior, sites)
    terms = (
        conditional.marginal_precision,
        conditional.marginal_shift(prior_mean),
        conditional.log_density(prior_mean),
    )
    return jax.tree.map(lambda values: values.sum(-2), terms)


def _forward(prior: ImpactPrior, prior_mean: Array, sites: SitesFirst) -> tuple[CellSums, Any]:
    return cell_sums(prior, prior_mean, sites), (prior, prior_mean, sites)


def _backward(saved: Any, change: CellSums) -> tuple[ImpactPrior, None, None]:
    prior, prior_mean, sites = saved
    # Whoever reads one half of a precision alone, as a Cholesky factor does, has a change of that half.
    change = change._replace(precision=(change.precision + change.precision.swapaxes(0, 1)) / 2)
    of_precision = _over_blocks(partial(_change_of_block, prior, prior_mean, change), sites)
    slots = sites.log_likelihood.shape[0] * sites.log_likelihood.shape[1]
    return ImpactPrior(small.stacked(of_precision), slots * change.constant.sum() / 2), None, None


def _change_of_block(prior: ImpactPrior, prior_mean: Array, change: CellSums, sites: SitesFirst) -> Any:
    """By D: T W T' + (T p t' + t p' T') / 2 - c (V + t t') / 2 with changes W, p and c of the three sums.

    T is V P, and t the mean of u - X b.
    """
    conditional = ImpactConditional.from_sites(prior, sites)
    shrink, mean, covariance = (
        conditional.shrinkage,
        conditional.mean_shift(prior_mean),
        conditional.covariance,
    )
    curved = small.product(shrink, change.precision)
    pulled = small.times(shrink, change.shift)

    def entry(a: int, b: int) -> Array:
        across = (pulled[a] * mean[b] + pulled[b] * mean[a]) / 2
        squares = covariance[a][b] + mean[a] * mean[b]
        return (small.dot(curved[a], shrink[b]) + across - change.constant / 2 * squares).sum()

    return small.symmetric(len(mean), entry)


cell_sums.defvjp(_forward, _backward)
