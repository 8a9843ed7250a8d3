"""Likelihood over summary wherever the posterior lets an impact's parameters be, for any population.

Each draw of the population asks for the mean of that ratio under its own normal conditional of an impact's
parameters. Some parameters move further from draw to draw than their conditional is wide, or have a
likelihood with a long tail: no set of points serves all draws there. These are tabulated one by one.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.special import logsumexp

from bayestissue.hierarchy.gaussian.conditional import Sites, prior_times
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.execution.compiling import compiled_quickly, compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.laplace import ConditionalPrior, times
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.factors.moments import log_site
from bayestissue.inference.samplers.psis import below_greatest
from bayestissue.likelihood import small

# Among an impact's parameters: the noise, and after it theta1.
NOISE, BESIDES = 2, 3
# Draws of one call of `log_evidence_corrections`.
DRAWS = 64
_NODES = 9
_POINTS_A_NODE = 16
_NORMAL_POINTS, _NORMAL_WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_NORMAL_WEIGHTS = _NORMAL_WEIGHTS / _NORMAL_WEIGHTS.sum()
_LEAST_RATIO = -50.0


class TabulatedRatio(NamedTuple):
    """The log ratio along one parameter over that at the reference, what comes before it integrated out.

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


class ImportanceRatios(NamedTuple):
    """Likelihood over summary of each impact.

    The noise is tabulated, whose spread between impacts may be next to nothing, and theta1, where it is part
    of the summary, which has a long tail towards 1. The points lie at the references of both. A last
    parameter that has a profile is no part of it: what is compared is the rest, whatever that parameter is.

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
    tables: tuple[TabulatedRatio, ...]


def importance_ratios(
    model: TraceModel,
    data: TraceData,
    summaries: Sites,
    anchors: ConditionalPrior,
    standard: Float[np.ndarray, "point parameter"],
    profile: LikelihoodGrid | None = None,
) -> ImportanceRatios:
    """Compare at one point from each of several draws of the population.

    The points' density is the mixture over these draws, so that wherever the posterior lets an impact's
    parameters be, there are points.

    Args:
        model: the model.
        data: the dataset.
        summaries: of its traces.
        anchors: what as many draws of the population as there are points expect of every impact.
        standard: standard normals of each point.
        profile: of the last parameter, if it has one; it is then drawn from the population.
    """
    known, tables = _known_and_tabulated(model, profile is not None)
    order, free = _order(known, tables), known - tables
    normals = _Conditionals.of(summaries, anchors, order)
    references, reaches = normals.reaches(free)
    lasts = anchors.mean[..., -1] + anchors.precision[..., -1, -1] ** -0.5 * standard[:, -1:]
    of_last = np.zeros(lasts.shape) if profile is None else np.asarray(_of_profile(profile, lasts))
    back = np.argsort(order)
    centre = np.asarray(summaries.centre)[:, :known]

    def ratio(away: np.ndarray, some: slice) -> tuple[np.ndarray, np.ndarray]:
        """With the tabulated parameters so far from the centre, the others from their conditional."""
        whole = np.broadcast_to(away, (*normals.shift[some].shape[:2], tables))
        moved = np.concatenate([normals.given(whole, standard[some, :free], some), whole], axis=-1)
        u = centre + moved[..., back]
        complete = u if profile is None else np.concatenate([u, lasts[some, :, None]], axis=-1)
        density = log_likelihoods(model, data, complete)
        summary = log_site(summaries, complete) + of_last[some]
        # Neither infinity less another, where the summary fails as well, is a ratio.
        has = np.isfinite(density) & np.isfinite(summary)
        return u, np.where(has, density - np.where(has, summary, 0.0), -np.inf)

    u, log_ratio = ratio(references, slice(None))
    log_density = normals.log_density((u - centre)[..., order], free)
    few = slice(None, None, max(1, len(standard) // _POINTS_A_NODE))
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)

    def table(number: int) -> TabulatedRatio:
        step = reaches * (np.arange(tables) == number)
        values = np.stack([logsumexp(ratio(references + node * step, few)[1], axis=0) for node in nodes])
        # Where no point has any likelihood the polynomial must not be torn by minus infinity. Where none has
        # it all along, the table is level, and the points' own ratios say so.
        values = np.maximum(below_greatest(values), _LEAST_RATIO)
        # The points have their ratios at the reference, which is the middle node.
        values = values - values[_NODES // 2]
        return TabulatedRatio(references[:, number], reaches[:, number], _chebyshev() @ values)  # type: ignore[arg-type]

    made = tuple(table(number) for number in range(tables))
    return ImportanceRatios(u, log_density, log_ratio, made)  # type: ignore[arg-type]


def _known_and_tabulated(model: TraceModel, profiled: bool) -> tuple[int, int]:
    """How many of an impact's parameters are compared, and how many of these have a table."""
    known = 2 + len(model.nuisance) - profiled
    besides = model.nuisance[BESIDES - NOISE : known - NOISE]
    return known, 2 if besides and besides[0] == "atanh_theta1" else 1


def shapes(model: TraceModel, points: int, impacts: int, *, profiled: bool) -> ImportanceRatios:
    """Those of what `importance_ratios` finds."""
    known, tables = _known_and_tabulated(model, profiled)
    real: Any = partial(jax.ShapeDtypeStruct, dtype=jnp.float64)
    table = TabulatedRatio(real((impacts,)), real((impacts,)), real((_NODES, impacts)))
    pairs = real((points, impacts))
    return ImportanceRatios(real((points, impacts, known)), pairs, pairs, (table,) * tables)


_of_profile = compiled_quickly()(LikelihoodGrid.at)


class _Conditionals(NamedTuple):
    """The normal conditional of each impact's parameters, in some order, under each draw of a population.

    Attributes:
        shift: L^-1 (g + D (X b - m)).
        factor: L, with L L' = P + D.
    """

    shift: Float[np.ndarray, "draw impact parameter"]
    factor: Float[np.ndarray, "draw impact parameter parameter"]

    @classmethod
    def of(cls, summaries: Sites, anchors: ConditionalPrior, order: list[int]) -> _Conditionals:
        centre, slope, own = (np.asarray(part) for part in summaries[:3])
        whole = (own + anchors.precision)[..., order, :][..., order]
        right = slope + times(anchors.precision, anchors.mean - centre)
        factor = np.linalg.cholesky(whole)
        return cls(np.linalg.solve(factor, right[..., order, None])[..., 0], factor)

    def reaches(self, free: int) -> tuple[np.ndarray, np.ndarray]:
        """Middle and reach of each tabulated parameter over all draws, less the centre, [impact, table]."""
        inverse = np.linalg.inv(self.factor)
        mean = times(inverse.swapaxes(-1, -2), self.shift)[..., free:]
        sd = np.sqrt(np.square(inverse).sum(-2))[..., free:]
        reference = mean.mean(0)
        return reference, np.abs(mean - reference).max(0) + 4 * sd.max(0)

    def given(self, away: np.ndarray, z: np.ndarray, some: slice) -> np.ndarray:
        """The free parameters, less the centre, of some draws, the tabulated ones being ``away``."""
        free = z.shape[-1]
        upper = self.factor[some].swapaxes(-1, -2)
        right = self.shift[some][..., :free] + z[:, None] - times(upper[..., :free, free:], away)
        return np.linalg.solve(upper[..., :free, :free], right[..., None])[..., 0]

    def log_density(self, moved: Float[np.ndarray, "point impact parameter"], free: int) -> np.ndarray:
        """Of the mixture over the draws, as `_log_normal`, at points less the centre."""
        total = np.full(moved.shape[:2], -np.inf)
        for shift, factor in zip(self.shift, self.factor, strict=True):
            z = times(factor[..., :free].swapaxes(-1, -2), moved) - shift[:, :free]
            scale = np.log(np.diagonal(factor, axis1=-2, axis2=-1)[:, :free]).sum(-1)
            total = np.logaddexp(total, scale - np.square(z).sum(-1) / 2)
        return total


def _chebyshev() -> np.ndarray:
    """From values at the nodes to coefficients."""
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)
    return np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, _NODES - 1))


def log_evidence_corrections(
    summaries: Sites, ratios: ImportanceRatios, anchors: ConditionalPrior
) -> Float[np.ndarray, "draw impact"]:
    """`log_corrections` of what each of any number of draws of the population expects."""
    return in_calls(partial(corrections_of, summaries, ratios), tuple(anchors), DRAWS)


@compiled_sooner()
def corrections_of(
    summaries: Sites,
    ratios: ImportanceRatios,
    mean: Float[Array, "draw impact parameter"],
    precision: Array,
    number: int,
) -> Float[Array, "draw impact"]:
    """What is compiled of `log_evidence_corrections`: the first so many of `DRAWS` draws."""

    def one(place: Any) -> Array:
        about = [mean[place, :, a] for a in range(mean.shape[2])]
        return log_corrections(ratios, summaries, small.entries(precision[place, 0]), about)

    return first_rows(one, DRAWS, number)


def log_corrections(
    ratios: ImportanceRatios, summaries: Sites, prior: small.Matrix, about: list[Array]
) -> Float[Array, " impact"]:
    """Log of each trace's true evidence over its summary's, given X b and D.

    The mean of likelihood over summary under the normal conditional of u: those of the tables, times that of
    the points, reweighted, over the other parameters. A last parameter that has a profile is left out: its
    evidence is another factor.
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
    prior: small.Matrix, summaries: Sites, about: list[Array], order: list[int]
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


def _log_normal(
    u: Array, summaries: Sites, shift: Array, factor: Array, order: list[int], free: int
) -> Array:
    """Log density of the free parameters at the points, given the tabulated ones, up to a constant."""
    moved = [u[..., a] - summaries.centre[:, a] for a in order]
    total = jnp.log(jnp.stack([factor[a, a] for a in range(free)])).sum(0)
    for a in range(free):
        z = sum(factor[b, a] * moved[b] for b in range(a, len(order))) - shift[a]
        total = total - z**2 / 2
    return total
