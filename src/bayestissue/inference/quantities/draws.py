"""The quantities of every impact in many draws, compiled once for posterior and prior."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.elements.outcomes import OUTCOMES
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.execution.compiling import by_row
from bayestissue.inference.quantities.impacts import Impacts, impact_quantities, named_quantities
from bayestissue.padding import padded_impacts

# Draws of one call.
DRAWS = 256


@by_row(DRAWS, constant=3)
def constrained_impacts(
    model: TraceModel,
    data: TraceData,
    recorded: bool,
    u: Float[Array, "impact parameter"],
    mass_error: Float[Array, " impact"],
    key: Array,
) -> dict[str, Float[Array, "impact ..."]]:
    """Every impact's quantities, given what was recorded or as the priors alone have them."""
    return impact_quantities(Impacts.drawn(model, data, list(u.T), mass_error, key, jnp.asarray(recorded)))


@by_row(DRAWS, constant=2)
def recorded_outcomes(
    model: TraceModel,
    data: TraceData,
    u: Float[Array, "impact parameter"],
    mass_error: Float[Array, " impact"],
    key: Array,
) -> dict[str, Float[Array, " impact"]]:
    """The outcomes alone, given what was recorded: compiled sooner than `constrained_impacts` is."""
    impacts = Impacts.drawn(model, data, list(u.T), mass_error, key, jnp.asarray(True))
    return named_quantities(impacts, OUTCOMES)


def prior_impacts(
    prepared: Prepared,
    u: Float[np.ndarray, "draw impact parameter"],
    mass_error: Float[np.ndarray, "draw impact"],
    key: Array,
) -> dict[str, Float[np.ndarray, "draw impact ..."]]:
    """Every impact's quantities as the priors have them: see `constrained_impacts`."""
    keys = np.asarray(jax.random.split(key, len(u)))

    def one(part: TraceData, rows: np.ndarray) -> dict[str, np.ndarray]:
        of_rows = padded_impacts((u[:, rows], mass_error[:, rows]), 1)
        padded = constrained_impacts(prepared.model, part.padded, False, *of_rows, keys)
        return {name: np.moveaxis(values[:, : len(rows)], 1, 0) for name, values in padded.items()}

    return {name: np.moveaxis(values, 0, 1) for name, values in in_blocks(prepared.data, one).items()}
