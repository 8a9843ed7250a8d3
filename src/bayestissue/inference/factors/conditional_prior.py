"""The conditional prior N(X b, S) of each impact's parameters, given draws of the population."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.hierarchy.gaussian.conditional import Data, integrate_out
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.execution.compiling import compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.conditional import ConditionalPrior, evenly_spaced

# Draws of one call: as few as are asked for then, so that one compilation serves any number.
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
        about = in_calls(partial(expected_of, design), (self.b,), DRAWS)
        return ConditionalPrior(about, self.precision[:, None])


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
    rows = ({name: np.asarray(raw[name]) for name in model.hyperparameters}, z_b)
    return PopulationDraws(rows[0], *in_calls(partial(population_draws_of, model, data), rows, DRAWS))


@compiled_sooner()
def population_draws_of(
    model: TraceModel, data: Data, raw: dict[str, Array], z_b: Array, number: int
) -> tuple[dict[str, Array], Float[Array, "draw location"], Float[Array, "draw parameter parameter"]]:
    """What is compiled of `population_draws`: the first so many of `DRAWS` draws."""

    def one(place: Any) -> tuple[dict[str, Array], Array, Array]:
        sites = constrained(model, {name: values[place] for name, values in raw.items()})
        given = integrate_out(data, population(model, sites))
        return sites, given.draw_effects(z_b[place]), given.prior.precision

    return first_rows(one, DRAWS, number)


@compiled_sooner()
def expected_of(
    design: PopulationDesign, b: Float[Array, "draw location"], number: int
) -> Float[Array, "draw place parameter"]:
    """What is compiled of `PopulationDraws.priors`."""
    return first_rows(lambda draw: expected_by_cell(design, b[draw]).T, DRAWS, number)
