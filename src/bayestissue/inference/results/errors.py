"""Laplace covariance of an impact's parameters given its trace alone, split by source of error.

N = P^-1 with the expected information P of u, the errors of the measuring chain integrated out. Error a, of
standard deviation s_a, has the part N_a = -N (dP / d log s_a^2) N = dN / d log s_a^2, and the noise has what
is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import (
    CONTACT,
    TraceData,
    TraceModel,
    impact_likelihood,
    with_normal_errors,
)
from bayestissue.inference.execution.compiling import compiled_quickly, padded
from bayestissue.inference.factors.sites import laplace_sites, weak_prior
from bayestissue.inference.results.predictions import replicates
from bayestissue.likelihood.element.force import force_of
from bayestissue.likelihood.element.record import DecelerationRecord
from bayestissue.likelihood.element.response import response

NOISE, ELEMENT = "noise", "element"
# Of log s_a^2: the derivative's own error is this squared over 24.
STEP = 0.1
# What the mean of a trace does not depend on: told apart from K and C, and as small as to be nothing.
_OF_NOISE = ("noise", "atanh_theta1", "discrepancy", "noise_force")
_NOTHING = -60.0

Matrices = Float[np.ndarray, "impact parameter parameter"]


@dataclass(frozen=True)
class TraceErrors:
    """Covariance of what traces alone tell of u.

    Attributes:
        total: N.
        parts: by source, what it adds to N; they add up to N.
    """

    total: Matrices
    parts: dict[str, Matrices]


def trace_errors(
    prepared: Prepared,
    u: Float[np.ndarray, "impact parameter"],
    ridge: Float[np.ndarray, "parameter parameter"],
) -> TraceErrors:
    """N and its parts, from the curvature of each log likelihood as errors get larger and smaller.

    It is the expected information: each trace counts as what its model has for it without any error.

    Args:
        prepared: the model and its data. A uniform error counts as a normal one of its standard deviation.
        u: where the likelihoods are expanded.
        ridge: a small precision, for parameters of which a trace says nothing.
    """
    data = as_expected(prepared, u)
    ends: dict[str, tuple[Matrices, Matrices]] = {}
    error_sd = np.asarray(data.record.error_sd)
    for column, name in enumerate(data.record.errors.values()):
        if error_sd[:, column].any():
            upper, lower = (_information(prepared, _scaled(data, column, side), u) for side in (1, -1))
            ends[name] = upper, lower
    if "discrepancy" in prepared.model.nuisance:
        is_discrepancy = np.arange(u.shape[1]) == 2 + prepared.model.nuisance.index("discrepancy")
        upper, lower = (
            _information(prepared, data, u + side * STEP / 4 * is_discrepancy) for side in (1, -1)
        )
        ends[ELEMENT] = upper, lower
    return by_source(_information(prepared, data, u) + ridge, ends)


def by_source(information: Matrices, ends: Mapping[str, tuple[Matrices, Matrices]]) -> TraceErrors:
    """N and its parts from P, and from P where one error's log variance is half of `STEP` larger and smaller.

    Args:
        information: P.
        ends: by source, P with the larger and with the smaller error.
    """
    covariance = np.linalg.inv(information)
    parts = {
        name: -covariance @ ((upper - lower) / STEP) @ covariance for name, (upper, lower) in ends.items()
    }
    others = sum(parts.values(), np.zeros_like(covariance))
    return TraceErrors(covariance, {NOISE: covariance - others, **parts})


def as_expected(prepared: Prepared, u: Float[np.ndarray, "impact parameter"]) -> TraceData:
    """The data with each trace as its model has it at ``u``, without noise and errors; all errors normal."""
    if isinstance(prepared.data.record, DecelerationRecord):
        record = prepared.data.record
        first_time, d, force = _of_element(prepared.model, prepared.data, u)
        d = d[:, : record.d.shape[1]]
        if record.clipped is not None:
            d = np.where(np.asarray(record.clipped) != 0, np.asarray(record.d), d)
        if prepared.model.contact:
            # Its place in the interval is a parameter, which moves it from the middle again.
            earlier = u[:, 2 + prepared.model.nuisance.index(CONTACT)]
            first_time = first_time - earlier * np.asarray(record.interval)
        record = record.at_contact(first_time)._replace(d=d)
        if record.force is not None:
            y = force[:, : record.force.y.shape[1]]
            record = record._replace(force=record.force._replace(y=y))
        # Only a known contact has an error that can be made normal.
        return with_normal_errors(replace(prepared.data, record=record))
    data = with_normal_errors(prepared.data)
    quiet = np.where(_named(prepared, ("noise",)), _NOTHING, u)
    bare = data.record._replace(error_sd=jax.device_put(np.zeros(data.record.error_sd.shape)))
    replicated = replicates(
        prepared.model, replace(data, record=bare), quiet[None], jax.random.PRNGKey(0)[None]
    )
    trace = np.nan_to_num(np.asarray(replicated["displacement"][0]))
    return replace(data, record=data.record.with_traces(trace))


@padded(0)
@compiled_quickly
def _of_element(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"]
) -> tuple[Float[Array, " impact"], Float[Array, "impact sample"], Float[Array, "impact row"] | None]:
    """From contact, where the traces have it, to the first sample; the deceleration then, and F / M."""
    likelihood = impact_likelihood(model, data, list(u.T))
    known = likelihood.record.at_contact(likelihood.mean_first_time())
    answer = response(likelihood.element, likelihood.parameters, known)
    return known.first_time, answer.d, force_of(answer, known, likelihood.noise_parameters.log_force_ratio)


def _named(prepared: Prepared, names: tuple[str, ...]) -> Bool[np.ndarray, " parameter"]:
    return np.array([False, False, *(name in names for name in prepared.model.nuisance)])


def _information(prepared: Prepared, data: TraceData, u: np.ndarray) -> Matrices:
    """Minus the second derivatives of each log likelihood: a summary without a step taken.

    What tells of the noise alone is left out, and a 1 put in its place.
    """
    sites = laplace_sites(prepared.model, data, u, weak_prior(u), 0)
    apart = _named(prepared, _OF_NOISE)
    either = apart[:, None] | apart
    return np.where(either, np.diag(apart.astype(float)), np.asarray(sites.precision))


def _scaled(data: TraceData, column: int, side: int) -> TraceData:
    """With the log variance of one error larger or smaller by half a step."""
    factor = np.where(np.arange(data.record.error_sd.shape[1]) == column, np.exp(side * STEP / 4), 1.0)
    return replace(
        data, record=data.record._replace(error_sd=jax.device_put(np.asarray(data.record.error_sd) * factor))
    )
