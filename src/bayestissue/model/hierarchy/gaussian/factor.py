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
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.model.likelihood import small


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

    def _deviation(self, v: small.Vector) -> small.Vector:
        return [x - m for x, m in zip(v, self.factor.centre, strict=True)]

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
        inverse, deviation = small.inverse_factor(self.root), self._deviation(v)
        of_prior, of_factor = (small.product(inverse, part) for part in (self.prior, self.factor.precision))
        columns = [small.transposed(part) for part in (of_prior, of_factor)]
        precision = small.symmetric(len(self.root), lambda a, b: small.dot(columns[0][a], columns[1][b]))
        # L^-1 g, and L^-1 (g - P (v - m)).
        g_half = small.times(inverse, self.factor.shift)
        toward = [g - b for g, b in zip(g_half, small.times(of_factor, deviation), strict=True)]
        # (v - m)' (D V g - W (v - m) / 2), in factors.
        near = [(h + t) / 2 for h, t in zip(g_half, toward, strict=True)]
        gained = small.dot(near, small.times(of_prior, deviation))
        scale = small.log_diagonal(small.cholesky(self.prior)) - small.log_diagonal(self.root)
        log_scale = self.factor.log_scale + scale + gained + small.dot(g_half, g_half) / 2
        return GaussianFactor(v, small.times(columns[0], toward), precision, log_scale)


def cell_factors(
    prior: Float[Array, "parameter parameter"], prior_mean: Float[Array, "parameter cell"], sites: Any
) -> GaussianFactor:
    """Integrate every impact's parameters out, and multiply what is left over each cell's impacts.

    Args:
        prior: D of an impact's parameters, one of all impacts.
        prior_mean: X b of each cell of the design, about which the products are written.
        sites: `GaussianFactor` of the impacts, as `PopulationDesign.blocked` arranges them.
    """

    # Made again on the way back, which is faster than reading from memory all that an impact's algebra has.
    @jax.checkpoint
    def product(block: GaussianFactor) -> Any:
        _, *terms = Conditional(prior, block).marginal(prior_mean)
        return jax.tree.map(lambda values: values.sum(-2), terms)

    def step(total: Any, block: GaussianFactor) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, product(block)), None

    first = jax.tree.map(lambda leaf: leaf[0], sites)
    if len(sites.centre) == 1:
        shift, precision, log_scale = product(first)
    else:
        # One block after the other.
        none = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), jax.eval_shape(product, first))
        shift, precision, log_scale = jax.lax.scan(step, none, sites)[0]
    return GaussianFactor(prior_mean, jnp.stack(shift), small.stacked(precision), log_scale)
