"""Whether what a model leaves of each recorded deceleration is its noise.

A trace is y = f(u) + A e + noise: the impact's parameters u, the errors of its own measuring chain and,
where there is one, a discrepancy, all of which e has in units of their standard deviations, A over the
noise's. Given u, (1 + A A')^-1/2 (y - f(u)) is as white as the noise where the model is right, whatever the
errors are; errors that are larger than declared stay in it. u was fitted, and takes the columns df/du off.
The autocorrelations of what is left are held against those of white noise less such columns
(`bayestissue.inference.points.whiteness.projected_portmanteau`).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from bayestissue.inference.execution.compiling import compiled_quickly, padded
from bayestissue.inference.points.whiteness import projected_portmanteau
from bayestissue.model.hierarchy.trace_models import (
    TraceData,
    TraceModel,
    impact_likelihood,
    of_the_element,
    with_contact_at,
)
from bayestissue.model.likelihood.channels import whitened


def noise_p(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "impact parameter"]
) -> Float[np.ndarray, " impact"]:
    """p-value of each trace's residuals being the noise of the model; NaN of very short traces.

    Args:
        model: of recorded decelerations.
        data: the traces.
        u: a point of each impact's posterior.
    """
    left, fitted, inside = _of_one(model, data, u)
    return projected_portmanteau(left, fitted, inside.sum(1))


def noise_p_of_both(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "impact parameter"]
) -> Float[np.ndarray, " impact"]:
    """The same of each deceleration and the force beside it as one series, the force first.

    Where the deceleration's own residuals are noise, it is the force that has another law, or other K and C:
    what was fitted and the errors take the same directions off both. Arguments as of `noise_p`.
    """
    left, fitted, inside = _of_both(model, data, u)
    order = np.argsort(~inside, axis=1, kind="stable")
    packed = np.take_along_axis(left, order, 1), np.take_along_axis(fitted, order[:, None], 2)
    return projected_portmanteau(*packed, inside.sum(1))


def _left(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"], *, both: bool
) -> tuple[Float[Array, "impact shock"], Float[Array, "impact parameter shock"], Bool[Array, "impact shock"]]:
    """What is white if the model is right, what a unit of each parameter adds to it, and where it is."""
    stated = impact_likelihood(model, data, list(u.T))
    located = stated.with_contact_found(jax.random.PRNGKey(0))
    data = with_contact_at(data, stated, located.record.first_time)
    fitted = of_the_element(model)
    if both:
        fitted = [*fitted, u.shape[1] - 1]

    which = slice(None, None, -1) if both else slice(1)
    white = whitened(lambda u: impact_likelihood(model, data, list(u.T)), u, which)
    rows = jnp.concatenate([white.left[:, None], white.slopes[:, jnp.array(fitted)]], axis=1)
    rows = jax.vmap(_without)(white.shared.swapaxes(1, 2), rows)
    return rows[:, 0], rows[:, 1:], white.inside


_of_one, _of_both = (padded(0)(compiled_quickly(partial(_left, both=both))) for both in (False, True))


def _without(A: Float[Array, "shock error"], rows: Float[Array, "row shock"]) -> Float[Array, "row shock"]:
    """(1 + A A')^-1/2 of each row: along the eigenvectors of A'A, of values l, (1 + l)^-1/2 is left."""
    values, axes = jnp.linalg.eigh(A.T @ A)
    values = jnp.maximum(values, 0.0)
    root = jnp.sqrt(1 + values)
    # (1 - 1 / root) / l without its 0 / 0.
    return rows - ((rows @ A) @ axes / (root * (1 + root))) @ axes.T @ A.T
