"""Likelihood over summary wherever the posterior lets an impact's parameters be, for any population.

Each draw of the population asks for the mean of that ratio under its own normal conditional of an impact's
parameters. Some parameters move further from draw to draw than their conditional is wide, or have a
likelihood with a long tail: no set of points serves all draws there. These are tabulated one by one.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.conditional import Summaries, impact_parts, prior_times
from bayestissue.hierarchy.population import Spread, expected
from bayestissue.hierarchy.traces import TraceData, TraceModel, log_likelihood, population
from bayestissue.inference.compiling import compiled_sooner
from bayestissue.inference.trace_profile import Profile
from bayestissue.likelihood import small

# Among an impact's parameters: the noise, and after it theta1.
NOISE, BESIDES = 2, 3
_NODES = 9
_POINTS_A_NODE = 16
_NORMAL_POINTS, _NORMAL_WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_NORMAL_WEIGHTS = _NORMAL_WEIGHTS / _NORMAL_WEIGHTS.sum()
_LEAST_RATIO = -50.0


class Table(NamedTuple):
    """The log ratio along one parameter, what comes before it in the order integrated out.

    Attributes:
        reference: where the others' tables and the points have this parameter, less the summary's centre.
        reach: of the table, on either side of the reference.
        coefficients: of Chebyshev polynomials.
    """

    reference: Float[Array, " impact"]
    reach: Float[Array, " impact"]
    coefficients: Float[Array, "power impact"]

    def log_mean(self, mean: Array, sd: Array) -> Float[Array, " impact"]:
        """Log of the mean of the ratio under a normal parameter, its mean less the summary's centre."""
        away = mean - self.reference + sd * jnp.asarray(_NORMAL_POINTS)[:, None]
        x = jnp.clip(away / self.reach, -1.0, 1.0)
        before, now = jnp.ones_like(x), x
        total = self.coefficients[0] + self.coefficients[1] * now
        for coefficient in self.coefficients[2:]:
            before, now = now, 2 * x * now - before
            total = total + coefficient * now
        return jax.nn.logsumexp(total, axis=0, b=jnp.asarray(_NORMAL_WEIGHTS)[:, None])


class Ratios(NamedTuple):
    """Likelihood over summary of each impact.

    The noise is tabulated, whose spread between impacts may be next to nothing, and theta1, where it is part
    of the summary, which has a long tail towards 1. The points lie at the references of both.

    Attributes:
        u: points, [point, impact, parameter].
        log_density: log density of the parameters without a table there, given those with one, up to a
            constant.
        log_ratio: log of likelihood over summary there.
        tables: of the parameters that have one.
    """

    u: Float[Array, "point impact parameter"]
    log_density: Float[Array, "point impact"]
    log_ratio: Float[Array, "point impact"]
    tables: tuple[Table, ...]


@compiled_sooner("model")
def compare_over(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    draws: tuple[dict[str, Array], Array],
    standard: Float[Array, "point parameter"],
    profile: Profile | None = None,
) -> Ratios:
    """Compare at one point from each of several draws of the population, (spreads, b).

    The points' density is the mixture over these draws, so that wherever the posterior lets an impact's
    parameters be, there are points. A last parameter that has a profile is left out of them: what is
    compared is the rest, whatever that parameter is.
    """
    sites, b = draws
    spreads = jax.lax.map(partial(population, model), sites)
    abouts = jax.lax.map(partial(expected, data.design), b)
    return compare_over_about(model, data, summaries, spreads, abouts, standard, profile)


def compare_over_about(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    spreads: Spread,
    abouts: list[Float[Array, "draw impact"]],
    standard: Float[Array, "point parameter"],
    profile: Profile | None = None,
) -> Ratios:
    """`compare_over` for the spreads and X b of each draw."""
    size = summaries.centre.shape[1]
    known = size if profile is None else size - 1
    besides = model.nuisance[BESIDES - NOISE : known - NOISE]
    tables = 2 if besides and besides[0] == "atanh_theta1" else 1
    order = _order(known, tables)
    lasts = abouts[-1] + spreads.nuisance[-1][:, None] * standard[:, -1:]

    def conditional(part: tuple[Spread, list[Array]]) -> tuple[Array, Array]:
        spread, about = part
        return _conditional(impact_parts(spread, summaries).prior, summaries, about, order)

    shifts, factors = jax.lax.map(conditional, (spreads, abouts))
    places = _tabulated(jnp.moveaxis(shifts, 0, 1), jnp.moveaxis(factors, 0, 2), tables)
    references = [mean.mean(0) for mean, _ in places]
    reaches = [
        jnp.abs(mean - reference).max(0) + 4 * sd.max(0)
        for (mean, sd), reference in zip(places, references, strict=True)
    ]
    free = known - len(references)

    def ratio(away: list[Array], shift: Array, factor: Array, z: Array, last: Array) -> tuple[Array, Array]:
        """With the tabulated parameters so far from the centre, the others from their conditional."""
        moved = [*_given(shift, factor, away, z), *away]
        u = [summaries.centre[:, a] + moved[order.index(a)] for a in range(known)]
        whole = u if profile is None else [*u, last]
        found = log_likelihood(model, data, whole) - summaries.log_summary(whole)
        if profile is not None:
            found = found - profile.at(last)
        return jnp.stack(u, axis=-1), jnp.where(jnp.isfinite(found), found, -jnp.inf)

    rows = (shifts, factors, standard[:, :free], lasts)
    u, log_ratio = jax.lax.map(lambda row: ratio(references, *row), rows)

    def add(total: Array, part: tuple[Array, Array]) -> tuple[Array, None]:
        return jnp.logaddexp(total, _log_normal(u, summaries, *part, order, free)), None

    start = jnp.full(log_ratio.shape, -jnp.inf)
    log_density, _ = jax.lax.scan(add, start, (shifts, factors))
    few = jax.tree.map(lambda each: each[:: max(1, len(standard) // _POINTS_A_NODE)], rows)

    def table(number: int) -> Table:
        def at_node(node: Array) -> Array:
            away = [*references]
            away[number] = away[number] + node * reaches[number]
            ratios = jax.lax.map(lambda row: ratio(away, *row)[1], few)
            return jax.nn.logsumexp(ratios, axis=0)

        values = jax.lax.map(at_node, jnp.asarray(np.polynomial.chebyshev.chebpts1(_NODES)))
        # Where no point has any likelihood the polynomial must not be torn by minus infinity.
        values = jnp.maximum(values - values.max(0), _LEAST_RATIO)
        return Table(references[number], reaches[number], jnp.asarray(_chebyshev()) @ values)

    return Ratios(u, log_density, log_ratio, tuple(table(number) for number in range(len(references))))


def _chebyshev() -> np.ndarray:
    """From values at the nodes to coefficients."""
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)
    return np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, _NODES - 1))


def log_corrections(
    ratios: Ratios, summaries: Summaries, prior: small.Matrix, about: list[Array]
) -> Float[Array, " impact"]:
    """Log of each trace's true evidence over its summary's, given X b and D, up to a constant.

    The mean of likelihood over summary under the normal conditional of u: those of the tables, times that of
    the points, reweighted, over the other parameters.
    """
    order = _order(ratios.u.shape[-1], len(ratios.tables))
    shift, factor = _conditional(prior, summaries, about, order)
    free = len(order) - len(ratios.tables)
    log_weight = _log_normal(ratios.u, summaries, shift, factor, order, free) - ratios.log_density
    weighted, weight = (jax.nn.logsumexp(w, axis=0) for w in (log_weight + ratios.log_ratio, log_weight))
    places = _tabulated(shift, factor, len(ratios.tables))
    means = [table.log_mean(*place) for table, place in zip(ratios.tables, places, strict=True)]
    return weighted - weight + sum(means)


def _order(size: int, tables: int) -> list[int]:
    """An impact's first ``size`` parameters, those with a table last."""
    tabulated = [BESIDES, NOISE][-tables:]
    return [a for a in range(size) if a not in tabulated] + tabulated


def _conditional(
    prior: small.Matrix, summaries: Summaries, about: list[Array], order: list[int]
) -> tuple[Float[Array, "parameter impact"], Float[Array, "parameter parameter impact"]]:
    """The normal conditional of an impact's parameters in that order: L^-1 (g + D (X b - m)) and L.

    L L' = P + D. Rows before the last so many are the conditional of these parameters given the last.
    Parameters that the order leaves out have no part in the summaries.
    """
    own, size = small.entries(summaries.precision), len(order)
    factor = small.cholesky([[own[a][b] + prior[a][b] for b in order] for a in order])
    away = [about[a] - summaries.centre[:, a] for a in range(size)]
    pulled = prior_times(prior, away)
    shift = small.forward_solve(factor, [summaries.slope[:, a] + pulled[a] for a in order])
    zero = jnp.zeros_like(shift[0])
    lower = [[factor[a][b] + zero if b <= a else zero for b in range(size)] for a in range(size)]
    return jnp.stack(shift), jnp.stack([jnp.stack(row) for row in lower])


def _tabulated(shift: Array, factor: Array, tables: int) -> list[tuple[Array, Array]]:
    """Mean, less the summaries' centre, and standard deviation of each of the last parameters.

    L' (u - m) - L^-1 (...) is standard normal, and L' upper triangular: the last follows alone.
    """
    places: list[tuple[Array, Array]] = []
    size = factor.shape[0]
    for a in reversed(range(size - tables, size)):
        mean, variance = shift[a], jnp.ones(())
        for (later, sd), b in zip(places, range(a + 1, size), strict=True):
            mean, variance = mean - factor[b, a] * later, variance + (factor[b, a] * sd) ** 2
        places.insert(0, (mean / factor[a, a], jnp.sqrt(variance) / factor[a, a]))
    return places


def _given(shift: Array, factor: Array, away: list[Array], z: Array) -> list[Array]:
    """The free parameters, less the centre, from standard normals, the tabulated ones being ``away``."""
    size, free = factor.shape[0], factor.shape[0] - len(away)
    lower = [[factor[a, b] for b in range(a + 1)] for a in range(free)]
    right = [
        shift[a] - sum(factor[b, a] * away[b - free] for b in range(free, size)) + z[a] for a in range(free)
    ]
    return small.backward_solve(lower, right)


def _log_normal(
    u: Array, summaries: Summaries, shift: Array, factor: Array, order: list[int], free: int
) -> Array:
    """Log density of the free parameters at the points, given the tabulated ones, up to a constant."""
    moved = [u[..., a] - summaries.centre[:, a] for a in order]
    total = jnp.log(jnp.stack([factor[a, a] for a in range(free)])).sum(0)
    for a in range(free):
        z = sum(factor[b, a] * moved[b] for b in range(a, len(order))) - shift[a]
        total = total - z**2 / 2
    return total
