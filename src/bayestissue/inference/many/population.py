"""Where many impacts' summaries put the population: the spreads' posterior mode, and b's mean there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Float
from numpyro.infer.util import potential_energy

from bayestissue.hierarchy.gaussian.cell_solution import locations_of, solve
from bayestissue.hierarchy.gaussian.cells import Arrangement, Cells, Expansion, expected_by_place, in_cells
from bayestissue.hierarchy.gaussian.conditional import Sites
from bayestissue.hierarchy.population import Covariances
from bayestissue.hierarchy.traces import TraceModel, constrained, population, sample_hyperparameters
from bayestissue.inference.factors.laplace import ConditionalPrior
from bayestissue.inference.many.correction import PopulationDraws
from bayestissue.inference.many.grid_sum import GridSum
from bayestissue.inference.posterior.mode import covariance_about, find_mode
from bayestissue.inference.samplers.independence import Spreads


def cells_model(model: TraceModel, cells: Cells, surface: GridSum | None = None) -> None:
    """The numpyro model of the standard deviations, everything else integrated out; `spreads_model`."""
    spread = population(model, sample_hyperparameters(model))
    numpyro.factor("summaries", solve(cells, spread)[0].log_evidence)
    if surface is not None:
        z = numpyro.sample("standard_last", dist.Normal())
        mean = cells.mean[-1] + z * spread.locations[-1]
        numpyro.factor("profile", surface.at(mean, jnp.log(spread.nuisance[-1])))


@dataclass(frozen=True)
class MarginalMode:
    """Where the summaries put the population.

    Attributes:
        model: the model.
        layout: of the impacts.
        cells: the summaries by place, measured from ``b``.
        surface: what a last parameter's profile says of the population, if it has one.
        mode: of the spreads, unconstrained, in the order of ``names``.
        b: mean of the locations there.
    """

    model: TraceModel
    layout: Arrangement
    cells: Cells
    surface: GridSum | None
    mode: Float[np.ndarray, " spread"]
    b: Float[np.ndarray, " location"]

    @classmethod
    def of(cls, model: TraceModel, layout: Arrangement, summaries: Sites) -> MarginalMode:
        """Where these summaries put it, before anything is known."""
        mean = np.array(model.locations.mean)
        cells = in_cells(layout, summaries, mean, mean)
        start = cls(model, layout, cells, None, np.zeros(0), mean)
        return start.given(summaries)

    @property
    def names(self) -> tuple[str, ...]:
        """What is found: the spreads, and the last parameter's mean where that has a profile."""
        return tuple(sorted([*self.model.spreads, *(["standard_last"] if self.surface is not None else [])]))

    @property
    def prior_mean(self) -> Float[np.ndarray, " location"]:
        """Prior mean of the locations."""
        return np.array(self.model.locations.mean)

    def given(self, summaries: Sites) -> MarginalMode:
        """The same for other summaries, measured from the b at hand."""
        cells = in_cells(self.layout, summaries, self.prior_mean, self.b)
        found = replace(self, cells=cells)
        placed = replace(found, mode=found._find(self.mode))
        b = np.asarray(_mean_of(cells, placed.spread))
        # Far from b the squares that cancel are large: measured from it they are not.
        cells = in_cells(self.layout, summaries, self.prior_mean, b)
        return replace(placed, cells=cells, b=b)

    def corrected(self, expansion: Expansion, summaries: Sites, *, again: bool) -> MarginalMode:
        """With the expansion in the evidence; ``again`` moves the reference, for another one.

        An expansion that leaves no posterior at all is left out: what is then found at the end tells of it.
        """
        found = replace(self, cells=self.cells._replace(expansion=expansion))
        found = replace(found, mode=found._find(self.mode))
        if not np.isfinite(found._at(found.mode)[1]).all():
            return self
        if not again:
            return found
        b = np.asarray(_mean_of(found.cells, found.spread))
        return replace(found, b=b, cells=in_cells(self.layout, summaries, self.prior_mean, b))

    def draws(self, number: int) -> PopulationDraws:
        """Draws of the population, to second order about the mode."""
        rng = np.random.default_rng(number)
        root = np.linalg.cholesky(self.spreads().covariance)
        flat = self.mode + rng.standard_normal((number, len(self.mode))) @ root.T
        raw = dict(zip(self.names, jnp.asarray(flat.T), strict=True))
        z = jnp.asarray(rng.standard_normal((number, len(self.prior_mean))))
        if self.surface is not None:
            z = z.at[:, -1].set(raw.pop("standard_last"))
        return PopulationDraws(raw, _locations(self.model, self.cells, raw, z))

    @property
    def spread(self) -> Covariances:
        """The spreads at their mode."""
        return population(self.model, self._constrained(self.mode))

    def about(self) -> np.ndarray:
        """X b, [impact, parameter]."""
        columns = expected_by_place(self.layout, jnp.asarray(self.b))
        return np.stack([np.asarray(column)[self.layout.place] for column in columns], axis=1)

    def anchor(self) -> ConditionalPrior:
        """What the population says of every impact."""
        kk, kc, cc = (float(entry) for entry in self.spread.own)
        covariance = np.diag([0.0, 0.0, *(float(sd) ** 2 for sd in self.spread.nuisance)])
        covariance[:2, :2] = [[kk, kc], [kc, cc]]
        return ConditionalPrior(self.about(), np.linalg.inv(covariance))

    def guess_of_last(self) -> np.ndarray:
        """A first guess of the mean and log sd of a parameter that has a profile."""
        return np.array([self.b[-1], np.log(float(self.spread.nuisance[-1]))])

    def of_last(self, surface: GridSum) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mode and standard deviations of these two under a surface."""
        found = replace(self, surface=surface)
        mode = found._find(np.zeros(0))
        sites = dict(zip(found.names, mode, strict=True))
        last = self.model.spreads[-1]
        scale = self.model.locations.sd[-1]
        sd = float(constrained(self.model, sites)[last])
        spreads = replace(found, mode=mode).spreads()
        error = np.sqrt(np.diagonal(spreads.covariance))
        at = {name: place for place, name in enumerate(found.names)}
        # A standard deviation's unconstrained coordinate is its log.
        return (
            np.array([self.prior_mean[-1] + scale * sites["standard_last"], np.log(sd)]),
            np.array([scale * error[at["standard_last"]], error[at[last]]]),
        )

    def spreads(self) -> Spreads:
        """To second order about the mode."""
        covariance = covariance_about(lambda flat: self._at(flat)[1], self.mode)
        return Spreads(dict(zip(self.names, np.asarray(self.mode), strict=True)), covariance)

    def _constrained(self, flat: np.ndarray) -> dict[str, Array]:
        return constrained(self.model, dict(zip(self.names, jnp.asarray(flat), strict=True)))

    def _find(self, start: np.ndarray) -> np.ndarray:
        return find_mode(self.model, self.names, self._at, start if len(start) == len(self.names) else None)

    def _at(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _value_and_slope(self.model, self.names, jnp.asarray(flat), self.cells, self.surface)
        return float(value), np.asarray(slope)


@partial(jax.jit, static_argnames="names")
def _value_and_slope(
    model: TraceModel, names: tuple[str, ...], flat: Array, cells: Cells, surface: GridSum | None
) -> tuple[Array, Array]:
    """Minus the spreads' log density, unconstrained and in the order of ``names``, and its gradient."""
    own: Callable[..., None] = partial(cells_model, model)

    def potential(flat: Array) -> Array:
        return potential_energy(own, (cells, surface), {}, dict(zip(names, flat, strict=True)))

    return jax.value_and_grad(potential)(flat)


@jax.jit
def _locations(model: TraceModel, cells: Cells, raw: dict[str, Array], z: Array) -> Array:
    def one(draw: tuple[dict[str, Array], Array]) -> Array:
        solution, _ = solve(cells, population(model, constrained(model, draw[0])))
        return locations_of(cells, solution, draw[1])

    return jax.lax.map(one, (raw, z))


@jax.jit
def _mean_of(cells: Cells, spread: Covariances) -> Array:
    return locations_of(cells, solve(cells, spread)[0])
