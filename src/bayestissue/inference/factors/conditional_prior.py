"""The conditional prior N(X b, S) of each impact's parameters, given draws of the population."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import expected
from bayestissue.hierarchy.gaussian.conditional import Data, integrate_out
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.execution.compiling import compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.conditional import ConditionalPrior

# Draws of one call: as few as are asked for then, so that one compilation serves any number.
DRAWS = 64


class ConditionalPriors(NamedTuple):
    """The population of each draw, the summaries given: u of every impact is N(about, precision^-1).

    Attributes:
        sites: the standard deviations and the correlation.
        b: the locations.
        about: X b.
        precision: D.
    """

    sites: dict[str, Float[np.ndarray, " draw"]]
    b: Float[np.ndarray, "draw location"]
    about: Float[np.ndarray, "draw impact parameter"]
    precision: Float[np.ndarray, "draw parameter parameter"]

    @property
    def anchors(self) -> ConditionalPrior:
        """Those of all draws."""
        return ConditionalPrior(self.about, self.precision[:, None])

    def anchor(self, draw: int) -> ConditionalPrior:
        """That of one draw."""
        return ConditionalPrior(self.about[draw], self.precision[draw])


def conditional_priors(
    model: TraceModel,
    data: Data,
    raw: Mapping[str, Any],
    z_b: Float[np.ndarray, "draw location"],
) -> ConditionalPriors:
    """What each draw of the population expects of every impact.

    Args:
        model: the model.
        data: what the marginal density asks of the dataset.
        raw: the spreads, unconstrained, [draw].
        z_b: standard locations: with 0 b has its conditional mean.
    """
    rows = ({name: raw[name] for name in model.spreads}, z_b)
    return in_calls(partial(conditional_priors_of, model, data), rows, DRAWS)


@compiled_sooner()
def conditional_priors_of(
    model: TraceModel, data: Data, raw: dict[str, Array], z_b: Array, number: int
) -> ConditionalPriors:
    """What is compiled of `conditional_priors`: the first so many of `DRAWS` draws."""

    def one(place: Any) -> ConditionalPriors:
        sites = constrained(model, {name: values[place] for name, values in raw.items()})
        given = integrate_out(data, population(model, sites))
        b = given.draw_effects(z_b[place])
        about = expected(data.design, b).T
        return ConditionalPriors(sites, b, about, given.prior.precision)  # type: ignore[arg-type]

    return first_rows(one, DRAWS, number)
