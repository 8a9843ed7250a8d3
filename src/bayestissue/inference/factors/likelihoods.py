"""Every trace's log likelihood at several points at once.

Most of a short fit is spent in the compiler, and most of that on the likelihood. Whoever needs no more than
its values asks here, so that it is compiled once for all of them; what is done with the values is arithmetic
on whole arrays, which needs no compiler.
"""

from __future__ import annotations

import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.inference.execution.compiling import by_row, padded
from bayestissue.model.hierarchy.trace_models import TraceData, TraceModel, log_likelihood

# Points of one call.
POINTS = 64


def log_likelihoods(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "point impact parameter"]
) -> Float[np.ndarray, "point impact"]:
    """Log density of each trace at each of its points, the chain's errors integrated out.

    Minus infinity where there is none.
    """
    density = densities_at(model, data, u)
    return np.where(np.isfinite(density), density, -np.inf)


@padded(1)
@by_row(POINTS, constant=2)
def densities_at(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"]
) -> Float[Array, " impact"]:
    """The same, whatever number there is."""
    return log_likelihood(model, data, list(u.T))
