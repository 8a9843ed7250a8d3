"""Laplace covariance of an impact's parameters given its trace alone, split by source of error.

N = P^-1 with the expected information P = J' W J of u, J being what a unit of each parameter adds to the
trace in units of its noise, W = (1 + A A')^-1, and A what one standard deviation of each error adds. An
estimate is off by N J' W (A e + noise): error a has the part v_a v_a' of N with v_a = N J' W A_a, which is
dN / d log s_a^2, and the noise has what is left.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.base.arrays import JaxPerParameter, PerParameter
from bayestissue.inference.execution.compiling import compiled_quickly, padded
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import (
    TraceData,
    TraceModel,
    impact_likelihood,
    trace_likelihood,
    with_contact_at,
)
from bayestissue.model.likelihood.channels import whitened

NOISE, ELEMENT = "noise", "element"
# What the mean of a trace does not depend on: told apart from K and C, and as small as to be nothing.
_OF_NOISE = ("noise", "atanh_theta1", "discrepancy", "noise_force")

# By source of error, what it adds to N: they add up to that.
Parts = dict[str, Float[np.ndarray, "impact parameter parameter"]]


def trace_errors(
    prepared: Prepared, u: PerParameter, ridge: Float[np.ndarray, "parameter parameter"]
) -> Parts:
    """The parts of N.

    Args:
        prepared: the model and its data. A uniform error counts as a normal one of its standard deviation.
        u: where the likelihoods are expanded.
        ridge: a small precision, for parameters of which a trace says nothing.
    """
    slopes, shared = _over_noise(prepared.model, prepared.data, u)
    links = list(prepared.data.record.errors.values())
    of_noise = [0.0, 0.0, *(float(name in _OF_NOISE) for name in prepared.model.nuisance)]
    ridge = ridge + np.diag(of_noise)
    modes = shared.shape[1] - len(links)
    sources = [*links, *[ELEMENT] * modes]
    return by_source(slopes, np.roll(shared, -modes, axis=1), sources, ridge)


@padded(0)
@compiled_quickly
def _over_noise(
    model: TraceModel, data: TraceData, u: JaxPerParameter
) -> tuple[Float[Array, "impact parameter shock"], Float[Array, "impact error shock"]]:
    """J and A, contact being where the traces have it."""
    if model.kind == "impact":
        stated = impact_likelihood(model, data, list(u.T))
        data = with_contact_at(data, stated, stated.mean_first_time())

    white = whitened(lambda u: trace_likelihood(model, data, list(u.T)), u)
    return white.slopes, white.shared


def by_source(
    slopes: Float[np.ndarray, "impact parameter shock"],
    shared: Float[np.ndarray, "impact error shock"],
    sources: Sequence[str],
    ridge: Float[np.ndarray, "parameter parameter"] | float = 0.0,
) -> Parts:
    """The parts of N from J and A, whose columns have these sources; without those that have no error."""
    # J' W J = r' r, r being what least squares by A, an error costing its square, leave of J: no difference
    # of large numbers where errors are far above the noise.
    impacts, parameters, count = *slopes.shape[:2], shared.shape[1]
    errors = np.concatenate([shared.mT, np.broadcast_to(np.eye(count), (impacts, count, count))], axis=1)
    target = np.concatenate([slopes.mT, np.zeros((impacts, count, parameters))], axis=1)
    basis, triangle = np.linalg.qr(errors)
    along = basis.mT @ target
    gain, left = np.linalg.solve(triangle, along).mT, target - basis @ along
    covariance = np.linalg.inv(left.mT @ left + ridge)
    moved = covariance @ gain
    parts: Parts = {}
    for number, source in enumerate(sources):
        if shared[:, number].any():
            part = moved[:, :, None, number] * moved[:, None, :, number]
            parts[source] = parts.get(source, 0.0) + part
    others = sum(parts.values(), np.zeros_like(covariance))
    return {NOISE: covariance - others, **parts}
