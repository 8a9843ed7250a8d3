"""The conditional prior N(X b, S) of each impact's parameters, given draws of the population."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.hierarchy.gaussian.conditional import Data
from bayestissue.hierarchy.gaussian.effects import effects_from_standard, integrate_effects
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.execution.compiling import by_row
from bayestissue.inference.factors.conditional import ConditionalPrior, evenly_spaced

# Draws of one call.
DRAWS = 64


class PopulationDraws(NamedTuple):
    """Draws of the population, given the sites.

    Attributes:
        raw: the hyperparameters, unconstrained.
        sites: the standard deviations and the correlation.
        b: fixed and group effects.
        precision: D, of an impact's parameters about X b.
    """

    raw: dict[str, Float[np.ndarray, " draw"]]
    sites: dict[str, Float[np.ndarray, " draw"]]
    b: Float[np.ndarray, "draw location"]
    precision: Float[np.ndarray, "draw parameter parameter"]

    def rows(self, chosen: Any) -> PopulationDraws:
        """Some of them."""
        return jax.tree.map(lambda values: values[chosen], self)

    def some(self, number: int) -> PopulationDraws:
        """So many of them, evenly spaced."""
        return self.rows(evenly_spaced(len(self.b), number))

    def priors(self, design: PopulationDesign) -> ConditionalPrior:
        """The conditional prior of an impact at every place of the design; see `of_cells`."""
        return ConditionalPrior(_expected(design, self.b), self.precision[:, None])


def of_cells(priors: ConditionalPrior, cell: np.ndarray) -> ConditionalPrior:
    """Of impacts at these places."""
    return priors._replace(mean=priors.mean[:, cell])


def population_draws(
    model: TraceModel, data: Data, raw: Mapping[str, Any], z_b: Float[np.ndarray, "draw location"]
) -> PopulationDraws:
    """Draws of the population from those of the hyperparameters.

    Args:
        model: the model.
        data: what the marginal density asks of the dataset.
        raw: the hyperparameters, unconstrained, [draw].
        z_b: standard effects: with 0 b has its conditional mean.
    """
    raw = {name: np.asarray(raw[name]) for name in model.hyperparameters}
    return PopulationDraws(raw, *population_draw(model, data, raw, z_b))


@by_row(DRAWS, given=2)
def population_draw(
    model: TraceModel, data: Data, raw: dict[str, Array], z_b: Float[Array, " location"]
) -> tuple[dict[str, Array], Float[Array, " location"], Float[Array, "parameter parameter"]]:
    """What is compiled of `population_draws`."""
    sites = constrained(model, raw)
    covariances = population(model, sites)
    effects, _ = integrate_effects(data.design, covariances, data.sums(covariances))
    b = effects_from_standard(data.design, effects, data.mean, z_b)
    return sites, b, covariances.of_impact().precision


@by_row(DRAWS, given=1)
def _expected(design: PopulationDesign, b: Float[Array, " location"]) -> Float[Array, "place parameter"]:
    return expected_by_cell(design, b).T
