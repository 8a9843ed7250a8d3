"""Likelihood over site wherever the posterior lets an impact's parameters be, for any population.

Each draw of the population asks for the mean of that ratio under its own normal conditional of an impact's
parameters. Some parameters move further from draw to draw than their conditional is wide, or have a
likelihood with a long tail: no set of points serves all draws there. These are tabulated one by one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.special import logsumexp

from bayestissue.hierarchy.gaussian.factor import Conditional, GaussianFactor
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.execution.compiling import by_row, compiled_quickly
from bayestissue.inference.factors.conditional import (
    ConditionalPrior,
    evenly_spaced,
    standard_points,
)
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.samplers.psis import below_greatest
from bayestissue.likelihood import small
from bayestissue.padding import padded_impacts

# Among an impact's parameters: the noise, after log K and log C.
_NOISE = 2
# The last ones of `TraceModel.nuisance` that have no table: beside a discrepancy no parameter's ratio is that
# of its own times those of the others.
_WITHOUT_TABLE = ("discrepancy", "atanh_noise_correlation")
# Draws of one call of `log_evidence_corrections`.
DRAWS = 64
_NODES = 9
_NORMAL_POINTS, _NORMAL_WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_NORMAL_WEIGHTS = _NORMAL_WEIGHTS / _NORMAL_WEIGHTS.sum()
_LEAST_RATIO = -50.0


class TabulatedRatio(NamedTuple):
    """The log ratio along one parameter over that at the reference, what comes before it integrated out.

    Attributes:
        reference: where the others' tables and the points have this parameter, less the site's centre.
        reach: of the table, on either side of the reference.
        coefficients: of a polynomial, the highest power's first.
    """

    reference: Float[Any, " impact"]
    reach: Float[Any, " impact"]
    coefficients: Float[Any, "power impact"]

    def log_mean(self, mean: Array, sd: Array) -> Float[Array, " impact"]:
        """Log of the mean of the ratio under a normal parameter, its mean less the site's centre."""
        distance = mean - self.reference + sd * jnp.asarray(_NORMAL_POINTS)[:, None]
        log_ratio = jnp.polyval(self.coefficients, jnp.clip(distance / self.reach, -1.0, 1.0))
        return jax.nn.logsumexp(log_ratio, axis=0, b=jnp.asarray(_NORMAL_WEIGHTS)[:, None])


class ImportanceRatios(NamedTuple):
    """Likelihood over site of each impact.

    The noise, theta1 and an element's further parameters are tabulated, where they are part of the site:
    their spread between impacts may be next to nothing, and theta1 has a long tail towards 1. The points lie
    at the references of these. A last parameter that has a grid is no part of it: what is compared is the
    rest, whatever that parameter is.

    Attributes:
        u: points, [point, impact, parameter].
        log_density: log density of the parameters without a table there, given those with one, up to a
            constant.
        log_ratio: log of likelihood over site there.
        tables: of the parameters that have one.
    """

    u: Float[Array, "point impact parameter"]
    log_density: Float[Array, "point impact"]
    log_ratio: Float[Array, "point impact"]
    tables: tuple[TabulatedRatio, ...]

    def padded(self) -> ImportanceRatios:
        """Of as many impacts as a `bucket` holds."""
        u, log_density, log_ratio = padded_impacts((self.u, self.log_density, self.log_ratio), 1)
        return ImportanceRatios(u, log_density, log_ratio, padded_impacts(self.tables, -1))


def importance_ratios(
    model: TraceModel,
    data: TraceData,
    sites: GaussianFactor,
    priors: ConditionalPrior,
    standard: Float[np.ndarray, "point parameter"],
    grid: LikelihoodGrid | None = None,
) -> ImportanceRatios:
    """Compare at one point from each of several draws of the population.

    The points' density is the mixture over these draws, so that wherever the posterior lets an impact's
    parameters be, there are points.

    Args:
        model: the model.
        data: the dataset.
        sites: of its traces.
        priors: what as many draws of the population as there are points expect of every impact.
        standard: standard normals of each point.
        grid: of the last parameter, if it has one; it is then drawn from the population.
    """
    known, tables = _known_and_tabulated(model, grid is not None)
    order, free = _order(known, tables), known - tables
    normals = _OrderedConditional.from_sites(sites, priors, known, tables)
    means, sds = map(np.stack, normals.of_tabulated())
    references = means.mean(1)
    reaches = np.abs(means - references[:, None]).max(1) + 4 * sds.max(1)
    lasts = priors.mean[..., -1] + priors.precision[..., -1, -1] ** -0.5 * standard[:, -1:]
    of_last = np.zeros(lasts.shape)
    if grid is not None:
        of_last = np.asarray(_of_grid(*padded_impacts((grid, lasts), -1)))[:, : lasts.shape[1]]
    back = np.argsort(order)
    centre = sites.centre[:, :known]

    conditional = normals.at(slice(None))

    def ratio(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """With the tabulated parameters so far from the centre, the others from their conditional."""
        whole = np.broadcast_to(offset[:, None], (tables, *conditional.shift[0].shape))
        moved = np.concatenate([conditional.free_parameters(whole, standard[:, :free].T[..., None]), whole])
        u = centre + np.moveaxis(moved, 0, -1)[..., back]
        complete = u if grid is None else np.concatenate([u, lasts[..., None]], axis=-1)
        density = log_likelihoods(model, data, complete)
        of_site = sites.log_density(complete) + of_last
        # Neither infinity less another, where the site fails as well, is a ratio.
        has = np.isfinite(density) & np.isfinite(of_site)
        return u, np.where(has, density - np.where(has, of_site, 0.0), -np.inf)

    u, log_ratio = ratio(references)
    log_density = np.full(u.shape[:2], -np.inf)
    moved = np.moveaxis((u - centre)[..., order], -1, 0)
    for draw in range(len(standard)):
        log_density = np.logaddexp(log_density, normals.at((draw, None)).log_density(moved))
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)

    def table(number: int) -> TabulatedRatio:
        step = reaches * (np.arange(tables) == number)[:, None]
        # By all of the points: some of an even set are not even, and put the table of every impact off by the
        # same, which adds up in what the impacts share.
        values = np.stack([logsumexp(ratio(references + node * step)[1], axis=0) for node in nodes])
        # Where no point has any likelihood the polynomial must not be torn by minus infinity. Where none has
        # it all along, the table is level, and the points' own ratios say so.
        values = np.maximum(below_greatest(values), _LEAST_RATIO)
        # The points have their ratios at the reference, which is the middle node.
        values = values - values[_NODES // 2]
        return TabulatedRatio(references[number], reaches[number], np.linalg.solve(np.vander(nodes), values))

    tabulated = tuple(table(number) for number in range(tables))
    return ImportanceRatios(u, log_density, log_ratio, tabulated)  # type: ignore[arg-type]


def ratios_among(
    model: TraceModel,
    data: TraceData,
    sites: GaussianFactor,
    priors: ConditionalPrior,
    grid: LikelihoodGrid | None = None,
) -> ImportanceRatios:
    """`importance_ratios` at evenly spaced ones of any number of draws, which ``priors`` has."""
    subset = ConditionalPrior(*(part[evenly_spaced(len(priors.mean))] for part in priors))
    standard = standard_points(sites.centre.shape[1])
    return importance_ratios(model, data, sites, subset, standard, grid)


def _known_and_tabulated(model: TraceModel, profiled: bool) -> tuple[int, int]:
    """How many of an impact's parameters are compared, and how many of these have a table."""
    known = 2 + len(model.nuisance) - profiled
    return known, sum(name not in _WITHOUT_TABLE for name in model.nuisance[: known - _NOISE])


_of_grid = compiled_quickly(LikelihoodGrid.at)


class _OrderedConditional(NamedTuple):
    """The normal conditional of each impact's parameters less the site's centre, the tabulated ones last.

    L' (u - m) - shift is standard normal, with L L' = P + D: the last parameters follow alone, and the others
    given them. All are entries, as `bayestissue.likelihood.small` has them.

    Attributes:
        shift: L^-1 (g + D (X b - m)).
        factor: L.
        free: how many parameters have no table.
    """

    shift: small.Vector
    factor: small.Triangle
    free: int

    @classmethod
    def from_sites(
        cls, sites: GaussianFactor, prior: ConditionalPrior, size: int, tables: int
    ) -> _OrderedConditional:
        """Of an impact's first ``size`` parameters; others have no part in the sites."""
        order = np.array(_order(size, tables))
        rows = order[:, None]
        ordered = GaussianFactor(
            sites.centre[..., order],
            sites.shift[..., order],
            sites.precision[..., rows, order],
            sites.log_scale,
        )
        move = prior.precision.__array_namespace__().moveaxis
        conditional = Conditional(
            move(prior.precision[..., rows, order], (-2, -1), (0, 1)), ordered.batch_last()
        )
        return cls(conditional.half(move(prior.mean[..., order], -1, 0)), conditional.root, size - tables)

    def at(self, index: Any) -> _OrderedConditional:
        """With every entry indexed so."""
        shift, factor = jax.tree.map(lambda entry: entry[index], (self.shift, self.factor))
        return _OrderedConditional(shift, factor, self.free)

    def of_tabulated(self) -> tuple[small.Vector, small.Vector]:
        """Mean and standard deviation of each tabulated parameter."""
        factor = [row[self.free :] for row in self.factor[self.free :]]
        variance = small.squared(small.inverse_factor(factor))
        mean = small.solve_upper(factor, self.shift[self.free :])
        return mean, [row[a] ** 0.5 for a, row in enumerate(variance)]

    def free_parameters(self, offset: small.Vector, z: small.Vector) -> small.Vector:
        """The free parameters from standard normals, the tabulated ones being ``offset``."""
        tied, free = self.factor[self.free :], self.factor[: self.free]
        shift = [small.dot([row[a] for row in tied], offset) for a in range(self.free)]
        right = [s + x - p for s, x, p in zip(self.shift, z, shift, strict=False)]
        return small.solve_upper(free, right)

    def log_density(self, moved: small.Vector) -> Any:
        """Of the free parameters given the tabulated ones, up to a constant."""
        turned = small.turned_times(self.factor, moved)[: self.free]
        z = [t - s for t, s in zip(turned, self.shift, strict=False)]
        return small.log_diagonal(self.factor[: self.free]) - small.dot(z, z) / 2


def log_corrections(
    sites: GaussianFactor, ratios: ImportanceRatios, prior: ConditionalPrior
) -> Float[Array, " impact"]:
    """Log of each trace's true evidence over its site's, given X b and D.

    The mean of likelihood over site under the normal conditional of u: those of the tables, times that of
    the points, reweighted, over the other parameters. A last parameter that has a grid is left out: its
    evidence is another factor.
    """
    size, tables = ratios.u.shape[-1], len(ratios.tables)
    conditional = _OrderedConditional.from_sites(sites, prior, size, tables)
    moved = jnp.moveaxis((ratios.u - sites.centre[:, :size])[..., jnp.array(_order(size, tables))], -1, 0)
    log_weight = conditional.at(None).log_density(moved) - ratios.log_density
    weighted, weight = (jax.nn.logsumexp(w, axis=0) for w in (log_weight + ratios.log_ratio, log_weight))
    tabulated = zip(*conditional.of_tabulated(), strict=True)
    means = [table.log_mean(*moments) for table, moments in zip(ratios.tables, tabulated, strict=True)]
    return weighted - weight + sum(means)


def log_evidence_corrections(
    sites: GaussianFactor, ratios: ImportanceRatios, priors: ConditionalPrior
) -> Float[np.ndarray, "draw impact"]:
    """`log_corrections` of what each of any number of draws of the population expects."""
    padded = padded_impacts(sites), ratios.padded(), padded_impacts(priors, 1)
    return _log_corrections(*padded)[:, : len(sites.centre)]


@by_row(DRAWS, constant=2)
def _log_corrections(
    sites: GaussianFactor, ratios: ImportanceRatios, prior: ConditionalPrior
) -> Float[Array, " impact"]:
    """What is compiled of `log_evidence_corrections`."""
    return log_corrections(sites, ratios, prior)


def _order(size: int, tables: int) -> list[int]:
    """An impact's first ``size`` parameters, those with a table last."""
    tabulated = list(reversed(range(_NOISE, _NOISE + tables)))
    return [a for a in range(size) if a not in tabulated] + tabulated
