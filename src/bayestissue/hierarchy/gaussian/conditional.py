"""Normal conditionals of the hierarchy, given a normal summary of what each trace says.

Each trace's likelihood L(u) is summarised by exp(g (u - m) - (u - m)' P (u - m) / 2). With it and the
standard deviations given, b and every u are jointly normal: both can be integrated out in closed form, and
drawn back by an affine map of standard normals. The map is exact whatever the summaries are; only its
whitening power depends on them, and the ratio of likelihood to summary puts things right.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float

from bayestissue.hierarchy.population import Covariances, PopulationDesign, expected
from bayestissue.likelihood import small
from bayestissue.padding import adds_nothing


@adds_nothing
class Sites(NamedTuple):
    """Second-order expansion of each trace's log likelihood.

    Attributes:
        centre: m, where it was made.
        slope: g.
        precision: P, positive definite.
        log_likelihood: log L(m).
    """

    centre: Float[Array, "impact parameter"]
    slope: Float[Array, "impact parameter"]
    precision: Float[Array, "impact parameter parameter"]
    log_likelihood: Float[Array, " impact"]

    def log_summary(self, u: list[Array]) -> Float[Array, " impact"]:
        """Log of the summary at ``u``, whose value at the centre is log L(m)."""
        away = [u[a] - self.centre[:, a] for a in range(len(u))]
        bent = small.times(small.entries(self.precision), away)
        change = sum(d * (self.slope[:, a] - bent[a] / 2) for a, d in enumerate(away))
        return self.log_likelihood + change


class Conditional(NamedTuple):
    """What is left once the standard deviations are given.

    Attributes:
        log_evidence: log density of all summaries, b and every u integrated out.
        mean: of b.
        factor: lower Cholesky factor of b's precision.
        parts: per impact, what `impact_parameters` and `log_evidence_of` need.
    """

    log_evidence: Float[Array, ""]
    mean: Float[Array, " location"]
    factor: Float[Array, "location location"]
    parts: ImpactParts


class ImpactParts(NamedTuple):
    """What the closed forms need of each impact, its precision D about X b and V = (P + D)^-1 given.

    Attributes:
        prior: D, as rows of entries.
        factor: lower Cholesky factor of P + D.
        weight: W = D V P, the precision with which the trace tells X b.
        pull: D V g, the slope of the log evidence where X b is the summary's centre.
        constant: the log evidence there.
    """

    prior: list[list[Array]]
    factor: list[list[Array]]
    weight: list[list[Array]]
    pull: list[Array]
    constant: Array


def integrate_out(
    design: PopulationDesign,
    spread: Covariances,
    mean: Float[Array, " location"],
    summaries: Sites,
) -> Conditional:
    """Integrate b and every u out, the standard deviations given.

    Args:
        design: X over cells.
        spread: the standard deviations.
        mean: b's prior mean.
        summaries: of the traces.
    """
    impacts = impact_parts(spread, summaries)
    size = summaries.centre.shape[1]
    # Everything is measured from X mean, which keeps the sums of squares small.
    prior_mean = expected(design, mean)
    away = [prior_mean[a] - summaries.centre[:, a] for a in range(size)]
    weighted = small.times(impacts.weight, away)
    toward = [impacts.pull[a] - weighted[a] for a in range(size)]
    constant = log_evidence_of(impacts, summaries, prior_mean)
    precision = information(design, impacts.weight) + spread.precision_matrix()
    right = score(design, toward)
    factor = jnp.linalg.cholesky(precision)
    half = solve_triangular(factor, right, lower=True)
    log_evidence = (
        constant.sum() - spread.log_scale() - jnp.log(jnp.diagonal(factor)).sum() + (half**2).sum() / 2
    )
    shift = solve_triangular(factor, half, lower=True, trans=1)
    return Conditional(log_evidence, mean + shift, factor, impacts)


def effects_from_standard(
    conditional: Conditional, standard: Float[Array, " location"]
) -> Float[Array, " location"]:
    """All location parameters b from standard normals."""
    return conditional.mean + solve_triangular(conditional.factor, standard, lower=True, trans=1)


def impact_parameters(
    conditional: Conditional,
    summaries: Sites,
    about: list[Float[Array, " impact"]],
    standard: Float[Array, "impact parameter"],
) -> list[Float[Array, " impact"]]:
    """Each impact's u from standard normals, given ``about`` = X b."""
    return impact_values(conditional.parts, summaries, about, standard)


def impact_values(
    parts: ImpactParts,
    summaries: Sites,
    about: list[Float[Array, " impact"]],
    standard: Float[Array, "impact parameter"],
) -> list[Float[Array, " impact"]]:
    """The same from the impacts' parts alone."""
    size = len(about)
    away = [about[a] - summaries.centre[:, a] for a in range(size)]
    pulled = prior_times(parts.prior, away)
    right = [summaries.slope[:, a] + pulled[a] for a in range(size)]
    half = small.forward_solve(parts.factor, right)
    whole = small.backward_solve(parts.factor, [half[a] + standard[:, a] for a in range(size)])
    return [summaries.centre[:, a] + whole[a] for a in range(size)]


def prior_times(prior: small.Matrix, away: small.Vector) -> list[Array]:
    """D times a vector; only the first two parameters, log K and log C, are coupled."""
    pair = [small.dot(row[:2], away[:2]) for row in prior[:2]]
    return [*pair, *(prior[a][a] * away[a] for a in range(2, len(away)))]


def log_evidence_of(
    parts: ImpactParts, summaries: Sites, about: list[Float[Array, " impact"]]
) -> Float[Array, " impact"]:
    """Log density of each trace's summary given X b, its u integrated out."""
    size = len(about)
    away = [about[a] - summaries.centre[:, a] for a in range(size)]
    weighted = small.times(parts.weight, away)
    return parts.constant + sum(away[a] * (parts.pull[a] - weighted[a] / 2) for a in range(size))


def impact_parts(spread: Covariances, summaries: Sites) -> ImpactParts:
    """With D the prior precision and V = (P + D)^-1: W = D V P and D V g, and the constant."""
    size = summaries.centre.shape[1]
    kk, kc, cc = spread.own
    prior = prior_precision(spread)
    log_prior = -jnp.log(kk * cc - kc**2) / 2 - sum(jnp.log(sd) for sd in spread.nuisance)
    own, zeros = small.entries(summaries.precision), jnp.zeros_like(summaries.log_likelihood)
    factor = small.cholesky([[own[a][b] + prior[a][b] for b in range(size)] for a in range(size)])
    # Columns of L^-1 D and L^-1 P: W = (L^-1 D)' (L^-1 P), which equals D - D V D but stays exact where a
    # spread is so small that D dwarfs P, and where P has nothing to say.
    firsts = [0 if a < 2 else a for a in range(size)]
    columns = [
        small.forward_solve(factor, [entry + zeros for entry in prior[a][first:]], first)
        for a, first in enumerate(firsts)
    ]
    told = [small.forward_solve(factor, column) for column in own]
    slope = small.forward_solve(factor, [summaries.slope[:, a] for a in range(size)])
    lower = {
        (a, b): small.dot(columns[a], told[b][firsts[a] :])
        for b, a in itertools.combinations_with_replacement(range(size), 2)
    }
    weight = [[lower[max(a, b), min(a, b)] for b in range(size)] for a in range(size)]
    pull = [small.dot(columns[a], slope[first:]) for a, first in enumerate(firsts)]
    constant = (
        summaries.log_likelihood
        + log_prior
        - small.log_diagonal(factor)
        + sum((value**2 for value in slope), jnp.zeros(())) / 2
    )
    return ImpactParts(prior, factor, weight, pull, constant)


def prior_precision(spread: Covariances) -> list[list[Array]]:
    """D, the precision of an impact's parameters about X b, as rows of entries."""
    kk, kc, cc = spread.own
    determinant = kk * cc - kc**2
    size = 2 + len(spread.nuisance)
    prior = [[jnp.zeros_like(kk)] * size for _ in range(size)]
    prior[0][0], prior[0][1] = cc / determinant, -kc / determinant
    prior[1][0], prior[1][1] = prior[0][1], kk / determinant
    for a, sd in enumerate(spread.nuisance, start=2):
        prior[a][a] = sd**-2.0
    return prior


def information(
    design: PopulationDesign, weight: Sequence[Sequence[Array]]
) -> Float[Array, "location location"]:
    """X' W X, the precision with which all traces tell b, W being a matrix of entries over impacts."""
    size = range(len(weight))
    upper = {
        (a, b): design.columns[a].T @ (_to_cells(design, weight[a][b])[:, None] * design.columns[b])
        for a, b in itertools.combinations_with_replacement(size, 2)
    }
    return jnp.block([[upper[a, b] if a <= b else upper[b, a].T for b in size] for a in size])


def score(design: PopulationDesign, values: Sequence[Float[Array, " impact"]]) -> Float[Array, " location"]:
    """X' times a vector of entries over impacts."""
    return jnp.concatenate(
        [columns.T @ _to_cells(design, each) for columns, each in zip(design.columns, values, strict=True)]
    )


def _to_cells(design: PopulationDesign, values: Float[Array, " impact"]) -> Float[Array, " cell"]:
    cells = design.columns[0].shape[0]
    if cells == values.shape[0]:
        return values
    return jax.ops.segment_sum(values, design.cell, cells)
