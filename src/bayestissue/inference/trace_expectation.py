"""Where the population puts each impact's parameters, its spreads and all summaries given."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.conditional import Conditional, Summaries, condition
from bayestissue.hierarchy.population import Spread, expected
from bayestissue.hierarchy.traces import TraceData, TraceModel, population
from bayestissue.inference.compiling import compiled_quickly
from bayestissue.inference.trace_summaries import Anchor


class Expectation(NamedTuple):
    """See above.

    Attributes:
        spread: the population's spreads.
        conditional: of b and of each impact, given them.
        about: X b where b has its conditional mean.
    """

    spread: Spread
    conditional: Conditional
    about: list[Float[Array, " impact"]]

    def anchor(self) -> Anchor:
        """The same as a normal prior of each impact's parameters."""
        precision = np.array(jax.device_get(self.conditional.parts.prior))
        return Anchor(np.stack(jax.device_get(self.about), axis=1), precision)


# Compiled once for the several passes that ask for it: it is the larger part of most of them.
@compiled_quickly("model")
def expectation(
    model: TraceModel, data: TraceData, summaries: Summaries, sites: dict[str, Any]
) -> Expectation:
    """The normal conditionals of `bayestissue.hierarchy.conditional` at one value of the spreads."""
    spread = population(model, sites)
    conditional = condition(data.design, spread, data.location_mean, summaries)
    return Expectation(spread, conditional, expected(data.design, conditional.mean))
