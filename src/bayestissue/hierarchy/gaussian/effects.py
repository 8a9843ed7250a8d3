"""Fixed and group effects integrated out of any design, or drawn, by a blocked Cholesky factor.

Once the impacts' own parameters are integrated out, the precision of b is X'WX + Lambda with Lambda that of
its prior. Its elements are eliminated in two steps: of the chosen grouping factor and all that is nested in
it level by level, a small factor L each; then all other elements by one dense factor F of what is left,
the Schur complement. This is the blocked Cholesky factor of mixed models (Bates et al. 2015,
doi:10.18637/jss.v067.i01, and MixedModels.jl); which elements are in which block is
`bayestissue.hierarchy.gaussian.arrangement`'s.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.gaussian.impacts import CellSums
from bayestissue.likelihood import small


class EffectsConditional(NamedTuple):
    """b given the hyperparameters and all data, less its prior mean: a normal of the precision's factors.

    Attributes:
        factor: L, of each level's own elements.
        coupling: L^-1 times their products with the rest.
        half: L^-1 times what pulls them.
        rest_factor: F, of the rest once these are eliminated.
        rest_half: F^-1 times what then pulls the rest.
    """

    factor: small.Triangle
    coupling: Float[Array, "own rest level"]
    half: Float[Array, "own level"]
    rest_factor: Float[Array, "rest rest"]
    rest_half: Float[Array, " rest"]

    def log_density(self) -> Float[Array, ""]:
        """What integrating b out adds to the log density at its prior mean, but for the prior's scale."""
        squares = (self.half**2).sum() + (self.rest_half**2).sum()
        scale = small.log_diagonal(self.factor).sum() + jnp.log(jnp.diagonal(self.rest_factor)).sum()
        return squares / 2 - scale

    def solve_upper(
        self, own: Float[Array, "own level"], rest: Float[Array, " rest"]
    ) -> tuple[Float[Array, "own level"], Float[Array, " rest"]]:
        """The inverse of the whole factor's transpose times a vector."""
        rest = solve_triangular(self.rest_factor, rest, lower=True, trans=1)
        left = own - (self.coupling * rest[:, None]).sum(1)
        return _stacked(small.solve_upper(self.factor, left), own), rest


def log_density_of_cells(
    design: PopulationDesign, covariances: Covariances, sums: CellSums
) -> Float[Array, ""]:
    """Log density of all data, b integrated out.

    Differentiable by the covariances and the sums, once, and backwards: see `_backward`.

    Args:
        design: X, arranged.
        covariances: of which those of b count.
        sums: what the data of each place say of X b.
    """
    own, rest = _elements(design)
    precision = covariances.of_effects()
    gained = _integrated(precision.among(own), precision.among(rest), sums.weight, sums.pull, design)
    return sums.constant.sum() + gained - covariances.log_scale()


def integrate_effects(
    design: PopulationDesign, covariances: Covariances, sums: CellSums
) -> tuple[EffectsConditional, Float[Array, ""]]:
    """What is needed to draw b, and `log_density_of_cells`."""
    own, rest = _elements(design)
    precision = covariances.of_effects()
    found = _eliminated(precision.among(own), precision.among(rest), sums.weight, sums.pull, design)
    return found, sums.constant.sum() + found.log_density() - covariances.log_scale()


def effects_from_standard(
    design: PopulationDesign,
    conditional: EffectsConditional,
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
    own, rest = _elements(design)
    half, rest_half = conditional.half, conditional.rest_half
    if standard is not None:
        padded = jnp.append(standard, 0.0)
        half, rest_half = half + padded[own], rest_half + padded[rest]
    half, rest_half = conditional.solve_upper(half, rest_half)
    moved = jnp.zeros(len(mean) + 1).at[rest].set(rest_half).at[own].set(half)
    return mean + moved[:-1]


def _elements(design: PopulationDesign) -> tuple[Array, Array]:
    """Elements of b that are each level's own, and the others."""
    return jnp.concatenate(design.inner_element), jnp.concatenate(design.rest_element)


def _eliminated(
    own_prior: Array, rest_prior: Array, weight: Array, pull: Array, design: PopulationDesign
) -> EffectsConditional:
    table = design.inner[0].shape[1:]
    inner, rest = design.inner, design.rest
    weight, pull = weight.reshape(*weight.shape[:2], *table), pull.reshape(len(pull), *table)

    def by_level(values: Array) -> Array:
        return _by_level(values, design)

    def of_own(a: int, b: int) -> Array:
        return by_level((inner[a][:, None] * weight[a, b] * inner[b][None]).sum(-1))

    def across(a: int, b: int) -> Array:
        return by_level(_times_rest(inner[a] * weight[a, b], rest[b]))

    def of_rest(a: int, b: int) -> Array:
        left, right = (_flat(columns) for columns in (rest[a], rest[b]))
        return left.T @ (_as_rest(weight[a, b], rest[a])[:, None] * right)

    size = range(len(weight))
    factor = small.cholesky(_symmetric(of_own, size) + own_prior)
    coupled = _assembled(across, size)
    coupling = _stacked(small.solve_lower(factor, coupled), coupled)
    pulled = by_level(jnp.concatenate([(inner[a] * pull[a]).sum(-1) for a in size]))
    half = _stacked(small.solve_lower(factor, pulled), pulled)
    left = _symmetric(of_rest, size) + rest_prior - jnp.einsum("iql,ipl->qp", coupling, coupling)
    right = jnp.concatenate([_flat(rest[a]).T @ _as_rest(pull[a], rest[a]) for a in size])
    rest_factor = jnp.linalg.cholesky(left)
    right = right - (coupling * half[:, None]).sum((0, 2))
    return EffectsConditional(
        factor, coupling, half, rest_factor, solve_triangular(rest_factor, right, lower=True)
    )


def _stacked(entries: Sequence[Array], like: Array) -> Array:
    return jnp.stack(entries) if entries else like


def _flat(columns: Float[Array, "#row slot part"]) -> Float[Array, "place part"]:
    return columns.reshape(-1, columns.shape[2])


def _as_rest(values: Float[Array, "row slot"], columns: Float[Array, "#row slot part"]) -> Array:
    """Sums over the rows of the table for which the columns are alike."""
    return values.sum(0) if len(columns) == 1 else values.ravel()


def _times_rest(
    values: Float[Array, "own row slot"], columns: Float[Array, "#row slot part"]
) -> Float[Array, "own part row"]:
    """Products with the columns of the rest, summed over slots."""
    if len(columns) == 1:
        return jnp.moveaxis(values @ columns[0], 2, 1)
    return jnp.einsum("irs,rsq->iqr", values, columns)


def _by_level(values: Float[Array, "*own row"], design: PopulationDesign) -> Float[Array, "*own level"]:
    """Sums over each level's rows of the table."""
    levels = design.inner_element[0].shape[1]
    if levels == values.shape[-1]:
        return values
    return jnp.moveaxis(jax.ops.segment_sum(jnp.moveaxis(values, -1, 0), design.level, levels), 0, -1)


def _assembled(entry: Callable[[int, int], Array], size: Sequence[int]) -> Array:
    """A matrix of blocks."""
    rows = [jnp.concatenate([entry(a, b) for b in size], axis=1) for a in size]
    return jnp.concatenate(rows)


def _symmetric(entry: Callable[[int, int], Array], size: Sequence[int]) -> Array:
    """A symmetric matrix of blocks, those of its upper triangle given."""
    upper = {pair: entry(*pair) for pair in itertools.combinations_with_replacement(size, 2)}
    return _assembled(lambda a, b: upper[a, b] if a <= b else upper[b, a].swapaxes(0, 1), size)


@jax.custom_vjp
def _integrated(
    own_prior: Array, rest_prior: Array, weight: Array, pull: Array, design: PopulationDesign
) -> Array:
    return _eliminated(own_prior, rest_prior, weight, pull, design).log_density()


def _forward(own_prior: Array, rest_prior: Array, weight: Array, pull: Array, design: Any) -> tuple[Any, Any]:
    found = _eliminated(own_prior, rest_prior, weight, pull, design)
    return found.log_density(), (found, design)


def _backward(kept: tuple[EffectsConditional, PopulationDesign], change: Array) -> tuple[Any, ...]:
    """By Fisher's identity minus half the expected squares of what each precision is of, given the data.

    By pull that is the mean of X b less its prior mean.
    """
    found, design = kept
    size = range(len(design.inner))
    rest_covariance = cho_solve((found.rest_factor, True), jnp.eye(len(found.rest_half)))
    gain = _stacked(small.solve_upper(found.factor, found.coupling), found.coupling)
    across = -jnp.einsum("iql,qp->ipl", gain, rest_covariance)
    covariance = -jnp.einsum("iql,jql->ijl", across, gain)
    if found.factor:
        covariance = covariance + small.stacked(small.squared(small.inverse_factor(found.factor)))
    own, rest = found.solve_upper(found.half, found.rest_half)
    inner_parts, rest_parts = _parts(design.inner, 0), _parts(design.rest, 2)
    rows = jnp.asarray(design.level)

    def mean(a: int) -> Array:
        value = (design.inner[a] * own[inner_parts[a]][:, rows, None]).sum(0)
        return (value + design.rest[a] @ rest[rest_parts[a]]).ravel()

    def one_side(a: int, b: int) -> Array:
        own_to_rest = jnp.moveaxis(across[inner_parts[a], rest_parts[b]][..., rows], 1, 2)
        if len(design.rest[b]) == 1:
            between = own_to_rest @ design.rest[b][0].T
        else:
            between = jnp.einsum("irq,rsq->irs", own_to_rest, design.rest[b])
        return (design.inner[a] * between).sum(0)

    def scatter(a: int, b: int) -> Array:
        of_own = covariance[inner_parts[a], inner_parts[b]][..., rows, None]
        within = (design.inner[a][:, None] * of_own * design.inner[b][None]).sum((0, 1))
        of_rest = (design.rest[a] @ rest_covariance[rest_parts[a], rest_parts[b]]) * design.rest[b]
        return (within + of_rest.sum(-1) + one_side(a, b) + one_side(b, a)).ravel()

    about = jnp.stack([mean(a) for a in size])
    upper = {pair: scatter(*pair) for pair in itertools.combinations_with_replacement(size, 2)}
    squares = jnp.stack([jnp.stack([upper[min(a, b), max(a, b)] for b in size]) for a in size])
    return (
        -change / 2 * (covariance + own[:, None] * own[None]),
        -change / 2 * (rest_covariance + rest[:, None] * rest[None]),
        -change / 2 * (squares + about[:, None] * about[None]),
        change * about,
        None,
    )


def _parts(columns: Sequence[Array], axis: int) -> list[slice]:
    """Where each parameter's columns are among those of all."""
    ends = list(itertools.accumulate(matrix.shape[axis] for matrix in columns))
    return [slice(end - matrix.shape[axis], end) for end, matrix in zip(ends, columns, strict=True)]


_integrated.defvjp(_forward, _backward)
