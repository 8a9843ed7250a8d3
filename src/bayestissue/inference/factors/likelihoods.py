"""Every trace's log likelihood at several points at once.

Most of a short fit is spent in the compiler, and most of that on the likelihood. Whoever needs no more than
its values asks here, so that it is compiled once for all of them; what is done with the values is arithmetic
on whole arrays, which needs no compiler.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.traces import TraceData, TraceModel, log_likelihood
from bayestissue.inference.execution.compiling import compiled_sooner, first_rows, in_calls

# Points of one call: as few as are asked for then, so that one compilation serves any number.
POINTS = 64


def log_likelihoods(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "point impact parameter"]
) -> Float[np.ndarray, "point impact"]:
    """Log density of each trace at each of its points, the chain's errors integrated out.

    Minus infinity where there is none.
    """
    found = in_calls(partial(densities_at, model, data), (u,), POINTS)
    return np.where(np.isfinite(found), found, -np.inf)


@compiled_sooner()
def densities_at(
    model: TraceModel, data: TraceData, u: Float[Array, "point impact parameter"], number: int
) -> Float[Array, "point impact"]:
    """What is compiled of `log_likelihoods`: the first so many of `POINTS` points."""
    return first_rows(lambda place: log_likelihood(model, data, list(u[place].T)), POINTS, number)
