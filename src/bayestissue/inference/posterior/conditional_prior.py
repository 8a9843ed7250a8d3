"""Where draws of the population put each impact's parameters, before its own trace is heard."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.conditional import Summaries
from bayestissue.hierarchy.traces import TraceData, TraceModel, constrained, located
from bayestissue.inference.execution.compiling import compiled_sooner, first_rows, in_calls
from bayestissue.inference.factors.laplace import Anchor

# Draws of one call: as few as are asked for then, so that one compilation serves any number.
DRAWS = 64


class Expectations(NamedTuple):
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
    def anchors(self) -> Anchor:
        """Those of all draws."""
        return Anchor(self.about, self.precision[:, None])

    def anchor(self, draw: int) -> Anchor:
        """That of one draw."""
        return Anchor(self.about[draw], self.precision[draw])


def expectations(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    raw: Mapping[str, Any],
    z_b: Float[np.ndarray, "draw location"],
) -> Expectations:
    """What each draw of the population expects of every impact.

    Args:
        model: the model.
        data: the dataset; its traces are not asked for.
        summaries: of the traces.
        raw: the spreads, unconstrained, [draw].
        z_b: standard locations: with 0 b has its conditional mean.
    """
    bare = data._replace(record=None)  # type: ignore[arg-type]
    rows = ({name: raw[name] for name in model.spreads}, z_b)
    return in_calls(partial(expectations_of, model, bare, summaries), rows, DRAWS)


@compiled_sooner("model")
def expectations_of(
    model: TraceModel, data: TraceData, summaries: Summaries, raw: dict[str, Array], z_b: Array, number: int
) -> Expectations:
    """What is compiled of `expectations`: the first so many of `DRAWS` draws."""

    def one(place: Any) -> Expectations:
        sites = constrained(model, {name: values[place] for name, values in raw.items()})
        b, about, conditional = located(model, data, summaries, sites, z_b[place])
        prior = jnp.stack([jnp.stack(row) for row in conditional.parts.prior])
        return Expectations(sites, b, jnp.stack(about, axis=-1), prior)  # type: ignore[arg-type]

    return first_rows(one, DRAWS, number)
