"""Every impact's parameters integrated out, and what is left summed over cells."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.cells import Cells, Expansion
from bayestissue.hierarchy.population import Covariances
from bayestissue.likelihood import small

Entries = tuple[Array, ...]


class CellSums(NamedTuple):
    """Each place's sums over its impacts, all at the reference.

    Attributes:
        weight: W, the lower triangle's entries: minus the second derivatives of the log evidence by X b.
        pull: its first derivatives.
        constant: the log evidence less the level of `Cells`.
    """

    weight: tuple[Float[Array, " place"], ...]
    pull: tuple[Float[Array, " place"], ...]
    constant: Float[Array, " place"]

    def entry(self, a: int, b: int) -> Array:
        """An entry of W."""
        return self.weight[_lower(a, b)]


def cell_sums(cells: Cells, spread: Covariances) -> CellSums:
    """Integrate every impact's parameters out, and sum within places."""
    nuisance = spread.nuisance[: len(cells.slope) - 2]
    sums = _summed((*spread.own, *nuisance), cells.precision, cells.slope)
    number = len(cells.precision)
    found = CellSums(tuple(sums[:number]), tuple(sums[number:-1]), sums[-1])
    return found if cells.expansion is None else _corrected(found, cells.expansion, spread)


def flat_spreads(spread: Covariances, size: int) -> Float[Array, "*batch spread"]:
    """The spreads as `Expansion` has them, for impacts of ``size`` parameters."""
    return jnp.stack([*spread.own, *(sd**2 for sd in spread.nuisance[: size - 2])], axis=-1)


def _corrected(sums: CellSums, expansion: Expansion, spread: Covariances) -> CellSums:
    size = len(sums.pull)
    away = flat_spreads(spread, size) - expansion.spreads
    bent = expansion.bend[:, :, size:] @ away
    weight = tuple(sums.entry(a, b) - expansion.bend[:, a, b] for a in range(size) for b in range(a + 1))
    pull = tuple(sums.pull[a] + expansion.slope[:, a] + bent[:, a] for a in range(size))
    return CellSums(weight, pull, sums.constant + (expansion.slope[:, size:] + bent[:, size:] / 2) @ away)


def _lower(a: int, b: int) -> int:
    return max(a, b) * (max(a, b) + 1) // 2 + min(a, b)


@jax.custom_vjp
def _summed(spreads: Entries, precision: Entries, slope: Entries) -> Entries:
    """W, pull and constant of every impact, summed over the first axis, a repeat at a time.

    One repeat of all places stays in a processor's cache, where all impacts at once would not.
    """

    def add(total: Entries, part: tuple[Entries, Entries]) -> tuple[Entries, None]:
        weight, pull, constant = _of_impacts(spreads, *part)
        return tuple(t + v for t, v in zip(total, (*weight, *pull, constant), strict=True)), None

    count = len(precision) + len(slope) + 1
    return jax.lax.scan(add, (jnp.zeros_like(slope[0][0]),) * count, (precision, slope))[0]


def _of_impacts(
    spreads: Entries, precision: Entries, slope: Entries
) -> tuple[list[Array], list[Array], Array]:
    """W = D - D V D with V = (P + D)^-1, D V g, and the log evidence, D being the spreads' precision."""
    size = len(slope)
    kk, kc, cc = spreads[:3]
    determinant = kk * cc - kc**2
    prior = {(0, 0): cc / determinant, (1, 0): -kc / determinant, (1, 1): kk / determinant}
    log_prior = -jnp.log(determinant) / 2
    for a, sd in enumerate(spreads[3:], start=2):
        prior[a, a] = sd**-2.0
        log_prior = log_prior - jnp.log(sd)
    factor = small.cholesky(
        [[precision[_lower(a, b)] + prior.get((a, b), 0.0) for b in range(a + 1)] for a in range(size)]
    )
    inverse = _inverse(factor)
    # Rows of L^-1 D, whose squares make D V D; a person's log K and log C are all that D ties.
    rows = [[_dot_prior(row, prior, a) for a in range(size)] for row in inverse]
    zero = jnp.zeros(())
    weight = [
        prior.get((a, b), zero) - sum((rows[k][a] * rows[k][b] for k in _reach(a, size)), zero)
        for a in range(size)
        for b in range(a + 1)
    ]
    half = [sum((inverse[k][j] * slope[j] for j in range(k + 1)), zero) for k in range(size)]
    pull = [sum((rows[k][a] * half[k] for k in _reach(a, size)), zero) for a in range(size)]
    return weight, pull, log_prior - small.log_diagonal(factor) + sum(h**2 for h in half) / 2


def _reach(a: int, size: int) -> range:
    """The rows of L^-1 D that are not 0 in column ``a``."""
    return range(0 if a < 2 else a, size)


def _dot_prior(row: list[Array], prior: dict[tuple[int, int], Array], a: int) -> Array:
    tied = [b for b in range(len(row)) if (max(a, b), min(a, b)) in prior]
    return sum((row[b] * prior[max(a, b), min(a, b)] for b in tied), jnp.zeros(()))


def _inverse(factor: list[list[Array]]) -> list[list[Array]]:
    """Rows of L^-1, lower triangle only."""
    inverse: list[list[Array]] = []
    for i, row in enumerate(factor):
        over = 1 / row[i]
        own = [-over * sum(row[k] * inverse[k][j] for k in range(j, i)) for j in range(i)]
        inverse.append([*own, over])
    return inverse


def _summed_forward(spreads: Entries, precision: Entries, slope: Entries) -> tuple[Entries, Any]:
    return _summed(spreads, precision, slope), (spreads, precision, slope)


def _summed_backward(given: Any, toward: Entries) -> tuple[Entries, None, None]:
    """By the spreads alone: dW = -W dS W, d pull = -W dS pull, d constant = (pull' dS pull - tr W dS) / 2."""
    spreads, precision, slope = given
    size, number = len(slope), len(precision)
    by_weight, by_pull, by_constant = toward[:number], toward[number:-1], toward[-1]
    whole = [[by_weight[_lower(a, b)] * (1.0 if a == b else 0.5) for b in range(size)] for a in range(size)]

    def add(total: Entries, part: tuple[Entries, Entries]) -> tuple[Entries, None]:
        weight, pull, _ = _of_impacts(spreads, *part)
        rows = [[weight[_lower(a, b)] for b in range(size)] for a in range(size)]
        over = [small.times(whole, row) for row in rows]
        moved = small.times(rows, by_pull)

        def entry(a: int, b: int) -> Array:
            bent = -small.dot(rows[a], over[b]) - (pull[a] * moved[b] + pull[b] * moved[a]) / 2
            return (bent + by_constant * (pull[a] * pull[b] - rows[a][b]) / 2).sum()

        kk, kc, cc = entry(0, 0), entry(0, 1), entry(1, 1)
        slopes = (kk, 2 * kc, cc, *(2 * sd * entry(a, a) for a, sd in enumerate(spreads[3:], start=2)))
        return tuple(t + s for t, s in zip(total, slopes, strict=True)), None

    found, _ = jax.lax.scan(add, (jnp.zeros(()),) * len(spreads), (precision, slope))
    return found, None, None


_summed.defvjp(_summed_forward, _summed_backward)
