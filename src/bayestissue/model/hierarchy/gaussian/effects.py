"""Fixed and group effects integrated out of any design, or drawn, by a blocked Cholesky factor.

Given the hyperparameters, a Gaussian factor standing for each trace, all of the hierarchy is normal: every
impact's u and all effects b are integrated out in closed form, or drawn by an affine map of standard normals.
The map is exact whatever the factors are: only its whitening power depends on them, and the ratio of
likelihood to factor puts things right.

Once the impacts' own parameters are integrated out, the precision of b is X'WX + Lambda with Lambda that of
its prior. Its elements are eliminated in two steps: of the chosen grouping factor and all that is nested in
it level by level, a small factor L each; then all other elements by one dense factor F of what is left,
the Schur complement. This is the blocked Cholesky factor of mixed models (Bates et al. 2015,
doi:10.18637/jss.v067.i01, and MixedModels.jl); which elements are in which block is
`bayestissue.model.hierarchy.gaussian.arrangement`'s.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int

from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor, cell_factors
from bayestissue.model.likelihood import small


class Covariances(NamedTuple):
    """Covariance of an impact's parameters about X b, and the standard deviations of b's elements.

    Attributes:
        pair: of (log K, log C) at the recorded mass, as (KK, KC, CC).
        nuisance: standard deviation of each nuisance parameter between impacts.
        locations: prior standard deviation of each element of b.
    """

    pair: tuple[Array, Array, Array]
    nuisance: tuple[Array, ...]
    locations: Float[Array, " location"]

    @property
    def pair_matrix(self) -> Float[Array, "2 2 *batch"]:
        """That of (log K, log C) as a matrix."""
        kk, kc, cc = self.pair
        return small.stacked([[kk, kc], [kc, cc]])

    def of_impact(self) -> Float[Array, "parameter parameter *batch"]:
        """D, the precision of an impact's parameters about X b."""
        kk, kc, cc = self.pair
        determinant = kk * cc - kc**2
        size = 2 + len(self.nuisance)
        rows = [[jnp.zeros_like(kk)] * size for _ in range(size)]
        rows[0][0], rows[1][1] = cc / determinant, kk / determinant
        rows[0][1] = rows[1][0] = -kc / determinant
        for a, sd in enumerate(self.nuisance, start=2):
            rows[a][a] = sd**-2.0
        return jnp.stack([jnp.stack(row) for row in rows])

    def precision_among(self, elements: Int[Array, " inner *level"]) -> Float[Array, "inner inner *level"]:
        """Prior precision of b among some of its elements, level by level; one past the last: of none, 1."""
        size = len(elements)
        one = jnp.eye(size).reshape(size, size, *[1] * (elements.ndim - 1))
        return one * jnp.append(self.locations**-2.0, 1.0)[elements][None]

    def log_scale(self) -> Float[Array, ""]:
        """Half the log determinant of b's prior covariance."""
        return jnp.log(self.locations).sum()


class EffectsPosterior(NamedTuple):
    """b given the hyperparameters and all data, less its prior mean: a normal of the precision's factors.

    Attributes:
        factor: L, of each level's inner elements.
        coupling: L^-1 times their products with the outer elements.
        half: L^-1 times their shift.
        outer_factor: F, of the outer elements once these are eliminated.
        outer_half: F^-1 times their shift then.
    """

    factor: small.Triangle
    coupling: Float[Array, "inner outer level"]
    half: Float[Array, "inner level"]
    outer_factor: Float[Array, "outer outer"]
    outer_half: Float[Array, " outer"]

    def log_density(self) -> Float[Array, ""]:
        """What integrating b out adds to the log density at its prior mean, but for the prior's scale."""
        squares = (self.half**2).sum() + (self.outer_half**2).sum()
        scale = small.log_diagonal(self.factor).sum() + jnp.log(jnp.diagonal(self.outer_factor)).sum()
        return squares / 2 - scale

    def solve_upper(
        self, inner: Float[Array, "inner level"], outer: Float[Array, " outer"]
    ) -> tuple[Float[Array, "inner level"], Float[Array, " outer"]]:
        """The inverse of the whole factor's transpose times a vector."""
        outer = solve_triangular(self.outer_factor, outer, lower=True, trans=1)
        left = inner - (self.coupling * outer[:, None]).sum(1)
        return _stacked(small.solve_upper(self.factor, left), inner), outer

    def times_upper(
        self, inner: Float[Array, "inner level"], outer: Float[Array, " outer"]
    ) -> tuple[Float[Array, "inner level"], Float[Array, " outer"]]:
        """The whole factor's transpose times a vector."""
        below = _stacked(small.turned_times(self.factor, list(inner)), inner)
        return below + (self.coupling * outer[:, None]).sum(1), self.outer_factor.T @ outer


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SitesByCell:
    """All that the marginal density asks of the data.

    Attributes:
        design: X, arranged.
        mean: b's prior mean.
        sites: of the impacts, see `PopulationDesign.blocked`.
    """

    design: PopulationDesign
    mean: Float[Array, " location"]
    sites: GaussianFactor

    def sums(self, covariances: Covariances) -> GaussianFactor:
        """What the impacts of each cell say of X b, their own parameters integrated out."""
        prior_mean = expected_by_cell(self.design, self.mean)
        return cell_factors(covariances.of_impact(), prior_mean, self.sites)

    def integrated(self, covariances: Covariances) -> tuple[EffectsPosterior, Float[Array, ""]]:
        """What is needed to draw b, and the log density of all sites, b and every u integrated out."""
        return integrate_effects(self.design, covariances, self.sums(covariances))


def integrate_effects(
    design: PopulationDesign, covariances: Covariances, sums: GaussianFactor
) -> tuple[EffectsPosterior, Float[Array, ""]]:
    """What is needed to draw b, and the log density of all data, b integrated out.

    Args:
        design: X, arranged.
        covariances: of which those of b count.
        sums: what the data of each cell say of X b, about X times b's prior mean.
    """
    inner, outer = _elements(design)
    of_prior = covariances.precision_among(inner), covariances.precision_among(outer)
    conditional = _eliminated(*of_prior, *design.of_parts(sums.precision, sums.shift), design)
    return conditional, sums.log_scale.sum() + conditional.log_density() - covariances.log_scale()


def effects_from_standard(
    design: PopulationDesign,
    conditional: EffectsPosterior,
    mean: Float[Array, " location"],
    standard: Float[Array, " location"] | None = None,
) -> Float[Array, " location"]:
    """B from standard normals, its conditional mean without them.

    The last element of b depends on the last standard normal alone, if the data say nothing of it.

    Args:
        design: X, arranged.
        conditional: of b.
        mean: b's prior mean.
        standard: as many standard normals as b has elements.
    """
    inner, outer = _elements(design)
    half, outer_half = conditional.half, conditional.outer_half
    if standard is not None:
        padded = jnp.append(standard, 0.0)
        half, outer_half = half + padded[inner], outer_half + padded[outer]
    half, outer_half = conditional.solve_upper(half, outer_half)
    moved = jnp.zeros(len(mean) + 1).at[outer].set(outer_half).at[inner].set(half)
    return mean + moved[:-1]


def standard_effects(
    design: PopulationDesign,
    conditional: EffectsPosterior,
    mean: Float[Array, " location"],
    b: Float[Array, " location"],
) -> Float[Array, " location"]:
    """The standard normals from which `effects_from_standard` makes ``b``; arguments likewise."""
    inner, outer = _elements(design)
    deviation = jnp.append(b - mean, 0.0)
    of_inner, of_outer = conditional.times_upper(deviation[inner], deviation[outer])
    standard = jnp.zeros(len(mean) + 1).at[outer].set(of_outer - conditional.outer_half)
    return standard.at[inner].set(of_inner - conditional.half)[:-1]


def _elements(design: PopulationDesign) -> tuple[Array, Array]:
    """Elements of b that lie within a level, and the others."""
    return jnp.concatenate(design.inner_element), jnp.concatenate(design.outer_element)


def _eliminated(
    inner_prior: Array, outer_prior: Array, precision: Array, shift: Array, design: PopulationDesign
) -> EffectsPosterior:
    table = design.inner[0].shape[1:]
    inner, outer = design.inner, design.outer
    precision, shift = precision.reshape(*precision.shape[:2], *table), shift.reshape(len(shift), *table)

    levels = design.inner_element[0].shape[1]

    def by_level(values: Float[Array, "*inner row"]) -> Float[Array, "*inner level"]:
        """Sums over each level's rows of the table."""
        if levels == values.shape[-1]:
            return values
        return jnp.moveaxis(jax.ops.segment_sum(jnp.moveaxis(values, -1, 0), design.level, levels), 0, -1)

    def inner_covariance(a: int, b: int) -> Array:
        return by_level((inner[a][:, None] * precision[a, b] * inner[b][None]).sum(-1))

    def across(a: int, b: int) -> Array:
        return by_level(_times_outer(inner[a] * precision[a, b], outer[b]))

    def outer_square(a: int, b: int) -> Array:
        left, right = (_flat(columns) for columns in (outer[a], outer[b]))
        return left.T @ (_as_outer(precision[a, b], outer[a])[:, None] * right)

    size = range(len(precision))
    factor = small.cholesky(_symmetric(inner_covariance, size) + inner_prior)
    coupled = _assembled(across, size)
    coupling = _stacked(small.solve_lower(factor, coupled), coupled)
    inner_shift = by_level(jnp.concatenate([(inner[a] * shift[a]).sum(-1) for a in size]))
    half = _stacked(small.solve_lower(factor, inner_shift), inner_shift)
    left = _symmetric(outer_square, size) + outer_prior - jnp.einsum("iql,ipl->qp", coupling, coupling)
    right = jnp.concatenate([_flat(outer[a]).T @ _as_outer(shift[a], outer[a]) for a in size])
    outer_factor = jnp.linalg.cholesky(left)
    right = right - (coupling * half[:, None]).sum((0, 2))
    return EffectsPosterior(
        factor, coupling, half, outer_factor, solve_triangular(outer_factor, right, lower=True)
    )


def _stacked(entries: Sequence[Array], like: Array) -> Array:
    return jnp.stack(entries) if entries else like


def _flat(columns: Float[Array, "#row slot outer"]) -> Float[Array, "cell outer"]:
    return columns.reshape(columns.shape[0] * columns.shape[1], columns.shape[2])


def _as_outer(values: Float[Array, "row slot"], columns: Float[Array, "#row slot outer"]) -> Array:
    """Sums over the rows of the table for which the columns are alike."""
    return values.sum(0) if len(columns) == 1 else values.ravel()


def _times_outer(
    values: Float[Array, "inner row slot"], columns: Float[Array, "#row slot outer"]
) -> Float[Array, "inner outer row"]:
    """Products with the outer columns, summed over slots."""
    if len(columns) == 1:
        return jnp.moveaxis(values @ columns[0], 2, 1)
    return jnp.einsum("irs,rsq->iqr", values, columns)


def _assembled(entry: Callable[[int, int], Array], size: Sequence[int]) -> Array:
    """A matrix of blocks."""
    rows = [jnp.concatenate([entry(a, b) for b in size], axis=1) for a in size]
    return jnp.concatenate(rows)


def _symmetric(entry: Callable[[int, int], Array], size: Sequence[int]) -> Array:
    """A symmetric matrix of blocks, those of its upper triangle given."""
    upper = {pair: entry(*pair) for pair in itertools.combinations_with_replacement(size, 2)}
    return _assembled(lambda a, b: upper[a, b] if a <= b else upper[b, a].swapaxes(0, 1), size)
