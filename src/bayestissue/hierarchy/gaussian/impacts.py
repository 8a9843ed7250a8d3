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

from bayestissue.hierarchy.gaussian import blocks
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign
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
        away = u - self.centre
        bent = (self.precision * away[..., None, :]).sum(-1)
        return self.log_likelihood + (away * (self.slope - bent / 2)).sum(-1)


class SitesFirst(NamedTuple):
    """`Sites` with the axes of parameters before those of impacts, of which there may be several.

    Laid out by `lay` they have one axis more before all of these, of blocks.
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
    """u of impacts given X b, all of it with the parameters first, as `parameters_first` makes them.

    Attributes:
        prior: of u, whose axes behind the parameters broadcast with the sites' own.
        sites: of the impacts.
        factor: L, with L L' = P + D.
    """

    prior: ImpactPrior
    sites: SitesFirst
    factor: Any

    @classmethod
    def of(cls, prior: ImpactPrior, sites: SitesFirst) -> ImpactConditional:
        """Of sites with the parameters first; either may lack leading axes that the other has."""
        axes = max(prior.precision.ndim, sites.precision.ndim) - 2
        precision = blocks.with_axes(sites.precision, 2, axes)
        centre, slope = (blocks.with_axes(part, 1, axes) for part in sites[:2])
        prior = prior._replace(precision=blocks.with_axes(prior.precision, 2, axes))
        factor = blocks.cholesky(precision + prior.precision)
        return cls(prior, SitesFirst(centre, slope, precision, sites.log_likelihood), factor)

    @cached_property
    def covariance(self) -> Any:
        """V."""
        root = blocks.inverse_factor(self.factor)
        return blocks.product(blocks.transposed(root), root)

    @cached_property
    def shrinkage(self) -> Any:
        """V P, by which the mean of u moves from X b towards what the site says."""
        return blocks.product(self.covariance, self.sites.precision)

    @cached_property
    def weight(self) -> Any:
        """W = D V P, the precision with which a site tells X b."""
        return blocks.product(self.prior.precision, self.shrinkage)

    def moved(self, about: Any) -> Any:
        """The mean of u less X b, where that is ``about``: V g - V P (X b - m)."""
        away = about - self.sites.centre
        return blocks.times(self.covariance, self.sites.slope) - blocks.times(self.shrinkage, away)

    def pull(self, about: Any) -> Any:
        """The slope of `log_density`: D V g - W (X b - m)."""
        return blocks.times(self.prior.precision, self.moved(about))

    def log_density(self, about: Any) -> Any:
        """Log of the sites, u integrated out, where X b is ``about``."""
        away, (_, slope, precision, level) = about - self.sites.centre, self.sites
        half = blocks.solve_lower(self.factor, slope)
        # (X b - m)' (D V g - W (X b - m) / 2), in factors.
        near = half - blocks.solve_lower(self.factor, blocks.times(precision, away)) / 2
        gained = near * blocks.solve_lower(self.factor, blocks.times(self.prior.precision, away))
        scale = self.prior.log_determinant / 2 - blocks.log_diagonal(self.factor)
        return level + scale + (gained + half**2 / 2).sum(0)

    def toward(self, about: Any) -> Any:
        """L^-1 (g + D (X b - m)), where X b is ``about``."""
        right = self.sites.slope + blocks.times(self.prior.precision, about - self.sites.centre)
        return blocks.solve_lower(self.factor, right)

    def draw(self, about: Any, standard: Any) -> Any:
        """U from standard normals: N(m + V (g + D (X b - m)), V)."""
        half = self.toward(about)
        axes = max(half.ndim, standard.ndim) - 1
        centre, half, standard = (blocks.with_axes(v, 1, axes) for v in (self.sites.centre, half, standard))
        return centre + blocks.solve_upper(self.factor, half + standard)


def parameters_first(sites: Sites) -> SitesFirst:
    """The same with the axes of parameters before those of impacts."""
    centre, slope, precision, level = sites
    move = precision.__array_namespace__().moveaxis
    return SitesFirst(move(centre, -1, 0), move(slope, -1, 0), move(precision, (-2, -1), (0, 1)), level)


class CellSums(NamedTuple):
    """What the impacts of each place of the design say of X b there, their own parameters integrated out.

    Each place's log density is constant + pull'(v - v0) - (v - v0)' weight (v - v0) / 2 as a function of
    v = X b, v0 being X b at b's prior mean. Of an estimate y ~ N(v, D^-1) that is known exactly the weight is
    D, the pull D (y - v0), and the constant its log density at v0.
    """

    weight: Float[Array, "parameter parameter place"]
    pull: Float[Array, "parameter place"]
    constant: Float[Array, " place"]


def lay(design: PopulationDesign, sites: Sites) -> SitesFirst:
    """The sites, parameters first, of every place's impacts: [block, parameter, ..., repeat, place].

    Places without an impact have sites that say nothing, of which nothing is left in any sum.
    """
    xp = sites.precision.__array_namespace__()

    def laid(values: Any) -> Any:
        none = xp.zeros((1, *values.shape[1:]))
        return xp.moveaxis(xp.concat([values, none])[design.members], (1, 2), (-2, -1))

    return SitesFirst(*map(laid, sites))


@jax.custom_vjp
def cell_sums(prior: ImpactPrior, about: Float[Array, "parameter place"], laid: SitesFirst) -> CellSums:
    """Integrate every impact's parameters out, and sum what is left over each place's impacts.

    Differentiable by the prior alone, once, and backwards: the derivatives of the sums by D are expectations
    (Fisher's identity), with half of the operations.

    Args:
        prior: of an impact's parameters, one of all impacts.
        about: X b at b's prior mean.
        laid: the sites, see `lay`.
    """
    return _over_blocks(partial(_sums_of_block, prior, about), laid)


def _over_blocks(function: Any, laid: SitesFirst) -> Any:
    """Sum over blocks of what ``function`` makes of each, one after the other."""
    if len(laid.centre) == 1:
        return function(jax.tree.map(lambda leaf: leaf[0], laid))

    def add(total: Any, block: SitesFirst) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, function(block)), None

    first = jax.eval_shape(function, jax.tree.map(lambda leaf: leaf[0], laid))
    return jax.lax.scan(add, jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), first), laid)[0]


def _sums_of_block(prior: ImpactPrior, about: Array, sites: SitesFirst) -> CellSums:
    given, about = ImpactConditional.of(prior, sites), about[:, None]
    made = given.weight, given.pull(about), given.log_density(about)
    return CellSums(*(values.sum(-2) for values in made))


def _forward(prior: ImpactPrior, about: Array, laid: SitesFirst) -> tuple[CellSums, Any]:
    return cell_sums(prior, about, laid), (prior, about, laid)


def _backward(given: Any, change: CellSums) -> tuple[ImpactPrior, None, None]:
    prior, about, laid = given
    of_precision = _over_blocks(partial(_change_of_block, prior, about, change), laid)
    slots = laid.log_likelihood.shape[0] * laid.log_likelihood.shape[1]
    return ImpactPrior(of_precision, slots * change.constant.sum() / 2), None, None


def _change_of_block(prior: ImpactPrior, about: Array, change: CellSums, sites: SitesFirst) -> Array:
    """By D: T W T' + (T p t' + t p' T') / 2 - c (V + t t') / 2 with changes W, p and c of the three sums.

    T is V P, and t the mean of u - X b.
    """
    given = ImpactConditional.of(prior, sites)
    shrink, mean = given.shrinkage, given.moved(about[:, None])
    of_weight, of_pull, of_constant = (part[..., None, :] for part in change)
    bent = blocks.product(blocks.product(shrink, of_weight), blocks.transposed(shrink))
    pulled = blocks.outer(blocks.times(shrink, of_pull), mean)
    squares = given.covariance + blocks.outer(mean, mean)
    whole = bent + (pulled + blocks.transposed(pulled) - of_constant * squares) / 2
    return whole.sum((-2, -1))


cell_sums.defvjp(_forward, _backward)
