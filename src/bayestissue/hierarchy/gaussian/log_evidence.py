"""The evidence of `bayestissue.hierarchy.gaussian.conditional` alone, with its derivatives in closed form.

A chain asks for nothing else, some ten thousand times, and has to wait until it is compiled: here matrices
are arrays and not entries, and the derivatives are expectations instead of each operation's own, which is
less than half of the operations. By Fisher's identity the derivative of a log evidence by a precision is the
mean of the joint density's, given the data.
"""

from __future__ import annotations

import itertools
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.conditional import (
    Sites,
    information,
    prior_precision,
    score,
)
from bayestissue.hierarchy.population import Covariances, PopulationDesign, expected
from bayestissue.likelihood import small


def log_evidence(
    design: PopulationDesign, spread: Covariances, mean: Float[Array, " location"], summaries: Sites
) -> Float[Array, ""]:
    """Log density of all summaries, b and every u integrated out, as `condition` has it.

    Differentiable by the standard deviations alone, once, and backwards.

    Args:
        design: X over cells.
        spread: the standard deviations.
        mean: b's prior mean.
        summaries: of the traces.
    """
    prior = jnp.stack([jnp.stack(row) for row in prior_precision(spread)])
    kk, kc, cc = spread.own
    scale = jnp.log(kk * cc - kc**2) / 2 + sum(jnp.log(sd) for sd in spread.nuisance)
    told = _integrated(prior, spread.precision_matrix(), (design, mean, summaries))
    return told - len(summaries.centre) * scale - spread.log_scale()


Given = tuple[PopulationDesign, Array, Sites]
Matrices = Float[Array, "row column impact"]
Vectors = Float[Array, "row impact"]


@jax.custom_vjp
def _integrated(
    prior: Float[Array, "parameter parameter"], of_locations: Float[Array, "location location"], given: Given
) -> Array:
    """The log evidence less what the precisions themselves add: D of an impact, and that of b."""
    return _forward(prior, of_locations, given)[0]


def _forward(prior: Array, of_locations: Array, given: Given) -> tuple[Array, tuple[Any, ...]]:
    design, mean, summaries = given
    centre, slope = summaries.centre.T, summaries.slope.T
    own = jnp.moveaxis(summaries.precision, 0, -1)
    inverse, log_determinant = _inverse(own + prior[..., None])
    # V P and V g, and W = D V P, the precision with which a trace tells X b.
    shrunk, moved = _product(inverse, own), _times(inverse, slope)
    weight, pull = jnp.tensordot(prior, shrunk, 1), prior @ moved
    away = jnp.stack(expected(design, mean)) - centre
    weighed = _times(weight, away)
    each = (slope * moved / 2 + away * (pull - weighed / 2)).sum(0) - log_determinant / 2
    told = information(design, small.entries(jnp.moveaxis(weight, -1, 0)))
    right = score(design, list(pull - weighed))
    factor = jnp.linalg.cholesky(told + of_locations)
    half = solve_triangular(factor, right, lower=True)
    value = (
        (summaries.log_likelihood + each).sum() - jnp.log(jnp.diagonal(factor)).sum() + (half**2).sum() / 2
    )
    return value, (design, inverse, shrunk, moved, away, factor, half)


def _backward(kept: tuple[Any, ...], change: Array) -> tuple[Array, Array, None]:
    """Minus half the expected squares about what each precision is of."""
    design, inverse, shrunk, moved, away, factor, half = kept
    columns = design.columns
    shift = solve_triangular(factor, half, lower=True, trans=1)
    covariance = cho_solve((factor, True), jnp.eye(len(half)))
    begins = [sum(matrix.shape[1] for matrix in columns[:a]) for a in range(len(columns))]
    parts = [slice(begin, begin + matrix.shape[1]) for begin, matrix in zip(begins, columns, strict=True)]
    # Of X b, cell by cell.
    about = {
        (a, b): ((columns[a] @ covariance[parts[a], parts[b]]) * columns[b]).sum(1)
        for a, b in itertools.combinations_with_replacement(range(len(columns)), 2)
    }
    size = range(len(columns))
    scatter = jnp.stack([jnp.stack([about[min(a, b), max(a, b)] for b in size]) for a in size])
    scatter = scatter[..., design.cell]
    mean = moved - _times(shrunk, away + jnp.stack(expected(design, shift)))
    spread = jnp.tensordot(_product(shrunk, scatter), shrunk, ((1, 2), (1, 2)))
    of_impacts = inverse.sum(-1) + spread + mean @ mean.T
    of_locations = covariance + jnp.outer(shift, shift)
    return -change / 2 * of_impacts, -change / 2 * of_locations, None


_integrated.defvjp(_forward, _backward)


def _product(left: Matrices, right: Matrices) -> Matrices:
    """Of the matrices of each impact; written as sums, since a small product is a call each."""
    return (left[:, :, None] * right[None]).sum(1)


def _times(matrix: Matrices, vector: Vectors) -> Vectors:
    return (matrix * vector[None]).sum(1)


def _inverse(matrix: Matrices) -> tuple[Matrices, Float[Array, " impact"]]:
    """Inverses of positive definite matrices, and the logs of their determinants (Gauss and Jordan)."""
    size = len(matrix)
    places, pivots = jnp.arange(size), []
    for k in range(size):
        row, column, pivot = matrix[k], matrix[:, k], matrix[k, k]
        own_row, own_column = (places == k)[:, None, None], (places == k)[None, :, None]
        rest = matrix - column[:, None] * (row / pivot)[None]
        sided = jnp.where(
            own_row, (row / pivot)[None], jnp.where(own_column, -(column / pivot)[:, None], rest)
        )
        matrix = jnp.where(own_row & own_column, 1 / pivot, sided)
        pivots.append(jnp.log(pivot))
    return matrix, sum(pivots, jnp.zeros(()))
