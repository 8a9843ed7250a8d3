"""Whether what a model leaves of each recorded deceleration is its noise.

A trace is y = f(u) + A e + noise: the impact's parameters u, the errors of its own measuring chain and,
where there is one, a discrepancy, all of which e has in units of their standard deviations, A over the
noise's. Given u, (1 + A A')^-1/2 (y - f(u)) is as white as the noise where the model is right, whatever the
errors are; errors that are larger than declared stay in it. u was fitted, and takes the columns df/du off.
The autocorrelations of what is left are held against those of white noise less such columns
(`bayestissue.inference.points.whiteness.projected_portmanteau`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.hierarchy.traces import (
    TraceData,
    TraceModel,
    impact_likelihood,
    of_the_element,
)
from bayestissue.inference.execution.compiling import compiled_quickly, padded
from bayestissue.inference.points.whiteness import projected_portmanteau
from bayestissue.likelihood.element.impact import MeasuredImpact


def noise_p(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "impact parameter"]
) -> Float[np.ndarray, " impact"]:
    """p-value of each trace's residuals being the noise of the model; NaN of very short traces.

    Args:
        model: of recorded decelerations.
        data: the traces.
        u: a point of each impact's posterior.
    """
    return projected_portmanteau(*_left(model, data, u))


def noise_p_of_both(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "impact parameter"]
) -> Float[np.ndarray, " impact"]:
    """The same of each deceleration and the force beside it as one series, the force first.

    Where the deceleration's own residuals are noise, it is the force that has another law, or other K and C:
    what was fitted and the errors take the same directions off both. Arguments as of `noise_p`.
    """
    left, fitted, inside = _left_of_both(model, data, u)
    order = np.argsort(~inside, axis=1, kind="stable")
    packed = np.take_along_axis(left, order, 1), np.take_along_axis(fitted, order[:, None], 2)
    return projected_portmanteau(*packed, inside.sum(1))


@padded(0)
@compiled_quickly
def _left_of_both(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"]
) -> tuple[Float[Array, "impact shock"], Float[Array, "impact parameter shock"], Bool[Array, "impact shock"]]:
    """As of `_left`, and where there is a sample."""
    error_sd, none = data.record.error_sd, jnp.zeros_like(data.record.error_sd)
    data, event = _with_contact(model, data, u)

    def shocks(u: Array, errors: Array) -> tuple[Array, Array]:
        event = impact_likelihood(model, data, list(u.T))
        of_force = event.force_innovations(event.force_residuals(errors))[0]
        return of_force, event.innovations(event.residuals(errors))[0]

    sigmas = event.force_sigma, event.sigma

    def over_noise(u: Array, errors: Array) -> Array:
        pairs = zip(shocks(u, errors), sigmas, strict=True)
        return jnp.concatenate([part / sigma[:, None] for part, sigma in pairs], axis=1)

    directions = [*of_the_element(model), u.shape[1] - 1]
    fitted, shared = _directions(over_noise, u, none, error_sd, directions)
    white = _whitened(jnp.stack(shared, axis=-1), [over_noise(u, none), *fitted])
    of_force = event.force_innovations(event.force_residuals(none))[1]
    observed = event.record.observed()[:, :: event.record.colour.stride]
    return white[:, 0], white[:, 1:], jnp.concatenate([of_force, observed], axis=1)


def _with_contact(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"]
) -> tuple[TraceData, MeasuredImpact]:
    """The traces with contact known, where they have it, and their likelihood."""
    event = impact_likelihood(model, data, list(u.T))
    data = replace(data, record=event.with_contact_found(jax.random.PRNGKey(0)).record)
    return data, impact_likelihood(model, data, list(u.T))


def _directions(
    shocks: Callable[[Array, Array], Array], u: Array, none: Array, error_sd: Array, shape: list[int]
) -> tuple[list[Array], list[Array]]:
    """What a unit of each parameter of ``shape`` adds to the shocks, and one sd of each error."""
    fitted = [jax.jvp(lambda u: shocks(u, none), (u,), (_only(u, a),))[1] for a in shape]
    shared = [
        jax.jvp(lambda errors: shocks(u, errors), (none,), (_only(none, a) * error_sd,))[1]
        for a in range(error_sd.shape[-1])
    ]
    return fitted, shared


def _whitened(A: Float[Array, "impact shock error"], rows: list[Array]) -> Float[Array, "impact row shock"]:
    """(1 + A A')^-1/2 of each of the rows."""
    return jax.vmap(_without)(A, jnp.stack(rows, axis=1))


@padded(0)
@compiled_quickly
def _left(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"]
) -> tuple[Float[Array, "impact shock"], Float[Array, "impact parameter shock"], Int[Array, " impact"]]:
    """What is white if the model is right, what a unit of each parameter adds to it, and how much it is."""
    error_sd, none = data.record.error_sd, jnp.zeros_like(data.record.error_sd)
    data, event = _with_contact(model, data, u)

    def shocks(u: Array, errors: Array) -> Array:
        event = impact_likelihood(model, data, list(u.T))
        return event.innovations(event.residuals(errors))[0]

    fitted, shared = _directions(shocks, u, none, error_sd, of_the_element(model))
    basis, share = event.record.discrepancy
    sd = (event.sigma * event.noise_parameters.ratio())[:, None] * jnp.sqrt(share)
    shared += [event.innovations(basis[:, j] * sd[:, j, None])[0] for j in range(basis.shape[1])]
    left, size = event.innovations(event.residuals(none))
    white = _whitened(jnp.stack(shared, axis=-1) / event.sigma[:, None, None], [left, *fitted])
    return white[:, 0], white[:, 1:], size


def _without(A: Float[Array, "shock error"], rows: Float[Array, "row shock"]) -> Float[Array, "row shock"]:
    """(1 + A A')^-1/2 of each row: along the eigenvectors of A'A, of values l, (1 + l)^-1/2 is left."""
    values, axes = jnp.linalg.eigh(A.T @ A)
    values = jnp.maximum(values, 0.0)
    root = jnp.sqrt(1 + values)
    # (1 - 1 / root) / l without its 0 / 0.
    return rows - ((rows @ A) @ axes / (root * (1 + root))) @ axes.T @ A.T


def _only(array: Array, column: int) -> Array:
    """Zeros, and ones in one column."""
    return jnp.zeros_like(array).at[:, column].set(1.0)
