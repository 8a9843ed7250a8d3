"""Gaussian factors: functions exp(s + g'(u - m) - (u - m)'P (u - m) / 2) of a vector u.

A trace's likelihood to second order is one, of the impact's parameters u: its site. With u ~ N(v, D^-1)
and v = X b, u given v is N(m + V (g + D (v - m)), V) where V = (P + D)^-1. With u integrated out the site is
another factor, of v, with precision W = D V P and, about m, shift D V g. Written so, and not as D - D V D,
W keeps its digits where a standard deviation tends to 0, and is 0 where the site says nothing.

The algebra is that of one factor: parameters are the first axes, and whatever axes follow are a batch. Where
they are stored, and for `GaussianFactor.log_density`, many impacts' factors have the impacts first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from operator import add
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.likelihood import small


class GaussianFactor(NamedTuple):
    """A Gaussian factor of a vector, or one of each impact's parameters.

    Attributes:
        centre: m, about which it is written.
        shift: g, the slope of its log there.
        precision: P.
        log_scale: s, its log there.
    """

    centre: Float[Any, "impact parameter"]
    shift: Float[Any, "impact parameter"]
    precision: Float[Any, "impact parameter parameter"]
    log_scale: Float[Any, " impact"]

    def log_density(self, u: Float[Any, "*point impact parameter"]) -> Float[Any, "*point impact"]:
        """Log of the factors at ``u``, impacts first."""
        deviation = u - self.centre
        curved = (self.precision * deviation[..., None, :]).sum(-1)
        return self.log_scale + (deviation * (self.shift - curved / 2)).sum(-1)

    def batch_last(self) -> GaussianFactor:
        """The same with the axes of parameters before those of impacts."""
        move = self.precision.__array_namespace__().moveaxis
        centre, shift = move(self.centre, -1, 0), move(self.shift, -1, 0)
        return GaussianFactor(centre, shift, move(self.precision, (-2, -1), (0, 1)), self.log_scale)

    def recentred(self, centre: Array) -> GaussianFactor:
        """The same factor written about another centre, parameters first."""
        deviation = centre - self.centre
        curved = jnp.stack(small.times(self.precision, deviation))
        log_scale = self.log_scale + small.dot(deviation, self.shift - curved / 2)
        return GaussianFactor(centre, self.shift - curved, self.precision, log_scale)

    def condition(self, last: Array) -> GaussianFactor:
        """The factor of the first elements where these are the last ones, parameters first."""
        size = len(self.centre) - len(last)
        moved = self.recentred(jnp.concatenate([self.centre[:size], last]))
        first = slice(size)
        return GaussianFactor(
            moved.centre[first], moved.shift[first], moved.precision[first, first], moved.log_scale
        )

    def product(self, factor: GaussianFactor) -> GaussianFactor:
        """Of this factor and another, about this one's centre, parameters first."""
        sums = map(add, self[1:], factor.recentred(self.centre)[1:])
        return GaussianFactor(self.centre, *sums)


@dataclass(frozen=True)
class Conditional:
    """The vector u given v, where u ~ N(v, D^-1) has a Gaussian factor: lists of entries, see `small`.

    Attributes:
        prior: D, whose axes behind the parameters broadcast with the factor's own.
        factor: of u, parameters first.
    """

    prior: Float[Any, "parameter parameter *#batch"]
    factor: GaussianFactor

    @cached_property
    def root(self) -> small.Triangle:
        """L, with L L' = P + D."""
        P, D = self.factor.precision, self.prior
        return small.cholesky([[P[a][b] + D[a][b] for b in range(a + 1)] for a in range(len(P))])

    @cached_property
    def _inverse(self) -> small.Triangle:
        """L^-1."""
        return small.inverse_factor(self.root)

    @cached_property
    def _of_prior(self) -> small.Matrix:
        """L^-1 D."""
        return small.product(self._inverse, self.prior)

    @cached_property
    def _of_factor(self) -> small.Matrix:
        """L^-1 P."""
        return small.product(self._inverse, self.factor.precision)

    @cached_property
    def covariance(self) -> small.Matrix:
        """V = L'^-1 L^-1."""
        return small.squared(self._inverse)

    @cached_property
    def shrinkage(self) -> small.Matrix:
        """V P, by which the mean of u moves from v towards what the factor says."""
        columns = small.transposed(self._of_factor)
        return small.transposed([small.turned_times(self._inverse, column) for column in columns])

    def _deviation(self, v: small.Vector) -> small.Vector:
        return [x - m for x, m in zip(v, self.factor.centre, strict=True)]

    def _toward_factor(self, v: small.Vector) -> small.Vector:
        """L^-1 (g - P (v - m))."""
        curved = small.times(self._of_factor, self._deviation(v))
        return [g - b for g, b in zip(small.times(self._inverse, self.factor.shift), curved, strict=True)]

    def mean_shift(self, v: small.Vector) -> small.Vector:
        """The mean of u less v: V g - V P (v - m)."""
        return small.turned_times(self._inverse, self._toward_factor(v))

    def half(self, v: small.Vector) -> small.Vector:
        """L^-1 (g + D (v - m)): L' (u - m) less this is standard normal."""
        pulled = small.times(self.prior, self._deviation(v))
        right = [g + p for g, p in zip(self.factor.shift, pulled, strict=True)]
        return small.solve_lower(self.root, right)

    def draw(self, v: small.Vector, standard: small.Vector) -> small.Vector:
        """A draw of u, N(m + V (g + D (v - m)), V), from standard normals."""
        half = [h + z for h, z in zip(self.half(v), standard, strict=True)]
        return [m + d for m, d in zip(self.factor.centre, small.solve_upper(self.root, half), strict=True)]

    def marginal(self, v: small.Vector) -> GaussianFactor:
        """The factor with u integrated out, a function of v written about ``v``."""
        g_half, toward = small.times(self._inverse, self.factor.shift), self._toward_factor(v)
        columns = [small.transposed(part) for part in (self._of_prior, self._of_factor)]
        precision = small.symmetric(len(self.root), lambda a, b: small.dot(columns[0][a], columns[1][b]))
        # (v - m)' (D V g - W (v - m) / 2), in factors.
        near = [(h + t) / 2 for h, t in zip(g_half, toward, strict=True)]
        gained = small.dot(near, small.times(self._of_prior, self._deviation(v)))
        scale = small.log_diagonal(small.cholesky(self.prior)) - small.log_diagonal(self.root)
        log_scale = self.factor.log_scale + scale + gained + small.dot(g_half, g_half) / 2
        return GaussianFactor(v, small.times(columns[0], toward), precision, log_scale)


@jax.custom_vjp
def cell_factors(
    prior: Float[Array, "parameter parameter"], prior_mean: Float[Array, "parameter entry"], sites: Any
) -> GaussianFactor:
    """Integrate every impact's parameters out, and multiply what is left over each entry's impacts.

    Differentiable by the prior alone, once, and backwards: the derivatives of the sums by D are expectations
    (Fisher's identity), with half of the operations.

    Args:
        prior: D of an impact's parameters, one of all impacts.
        prior_mean: X b of each entry of the design, about which the products are written.
        sites: `GaussianFactor` of the impacts, as `PopulationDesign.blocked` arranges them.
    """

    def product(block: GaussianFactor) -> Any:
        _, *terms = Conditional(prior, block).marginal(prior_mean)
        return jax.tree.map(lambda values: values.sum(-2), terms)

    shift, precision, log_scale = _over_blocks(product, sites)
    return GaussianFactor(prior_mean, jnp.stack(shift), small.stacked(precision), log_scale)


def _over_blocks(function: Any, sites: GaussianFactor) -> Any:
    """Sum over blocks of what ``function`` makes of each, one after the other."""
    if len(sites.centre) == 1:
        return function(jax.tree.map(lambda leaf: leaf[0], sites))

    def step(total: Any, block: GaussianFactor) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, function(block)), None

    first = jax.eval_shape(function, jax.tree.map(lambda leaf: leaf[0], sites))
    return jax.lax.scan(step, jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), first), sites)[0]


def _forward(prior: Array, prior_mean: Array, sites: GaussianFactor) -> tuple[GaussianFactor, Any]:
    return cell_factors(prior, prior_mean, sites), (prior, prior_mean, sites)


def _backward(saved: Any, change: GaussianFactor) -> tuple[Array, None, None]:
    """By D: T W T' + (T p t' + t p' T') / 2 - c (V + t t' - D^-1) / 2 with changes W, p, c of the sums.

    T is V P, and t the mean of u - X b.
    """
    prior, prior_mean, sites = saved
    # Whoever reads one half of a precision alone, as a Cholesky factor does, has a change of that half.
    W, c = (change.precision + change.precision.swapaxes(0, 1)) / 2, change.log_scale

    def of_block(block: GaussianFactor) -> Any:
        conditional = Conditional(prior, block)
        T, t, V = conditional.shrinkage, conditional.mean_shift(prior_mean), conditional.covariance
        curved, pulled = small.product(T, W), small.times(T, change.shift)

        def entry(a: int, b: int) -> Array:
            across = (pulled[a] * t[b] + pulled[b] * t[a]) / 2
            return (small.dot(curved[a], T[b]) + across - c / 2 * (V[a][b] + t[a] * t[b])).sum()

        return small.symmetric(len(t), entry)

    slots = sites.log_scale.shape[0] * sites.log_scale.shape[1]
    of_scale = slots * c.sum() / 2 * small.stacked(small.inverse(prior))
    return small.stacked(_over_blocks(of_block, sites)) + of_scale, None, None


cell_factors.defvjp(_forward, _backward)
