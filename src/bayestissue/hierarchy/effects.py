"""The hierarchy over impacts: exponents, covariates, subject and trial effects, impact scatter."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.infer.reparam import LocScaleReparam

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.priors import Priors

RESPONSES = ("K", "C")


class ResponseArrays(NamedTuple):
    """One response's part of the design, in a shape that competing formulas share.

    ``log_mass`` [row] and ``covariates`` [row, covariate] are zero where the formula lacks the term, and
    ``groups`` [2] is 1 or 0 for the subject and trial effects: a coefficient that multiplies zero keeps
    its prior and touches nothing, so one compiled sampler serves every formula.
    """

    log_mass: np.ndarray
    covariates: np.ndarray
    groups: np.ndarray


class DesignArrays(NamedTuple):
    """The design as arrays: both responses, and each row's subject and trial."""

    K: ResponseArrays
    C: ResponseArrays
    subject: np.ndarray
    trial: np.ndarray


def design_arrays(design: Design, covariates: int) -> DesignArrays:
    """``design`` as arrays, with room for ``covariates`` covariates besides the log of mass."""
    rows = len(design.subject)
    parts = []
    for response in RESPONSES:
        part = design.responses[response]
        padded = np.zeros((rows, covariates))
        padded[:, : len(part.names)] = part.covariates
        log_mass = np.zeros(rows) if part.log_mass is None else part.log_mass
        groups = np.array([float(group in part.groups) for group in GROUPS])
        parts.append(ResponseArrays(log_mass, padded, groups))
    return DesignArrays(parts[0], parts[1], design.subject, design.trial)


def expected_logs(
    design: DesignArrays, priors: Priors, *, subjects: int, trials: int
) -> Float[Array, "row response"]:
    """Sample the hierarchy and return what it expects of (log K, log C) in each row of ``design``.

    log K = intercept_K + mass_exponent_K log(M / M_ref) + covariates + subject + trial, and so for C.
    """
    columns = []
    for response, part in zip(RESPONSES, (design.K, design.C), strict=True):
        subject = _group_effect("subject", subjects, priors, response) * part.groups[0]
        trial = _group_effect("trial", trials, priors, response) * part.groups[1]
        columns.append(_common(part, priors, response) + subject[design.subject] + trial[design.trial])
    return jnp.stack(columns, axis=-1)


def impact_scale(priors: Priors, *, correlated: bool) -> Float[Array, "response response"]:
    """Sample the scatter of one person's impacts in one condition: the Cholesky factor of its covariance."""
    sd_K = numpyro.sample("sd_impact_K", priors.sd_impact.K.numpyro())
    sd_C = numpyro.sample("sd_impact_C", priors.sd_impact.C.numpyro())
    r = numpyro.sample("residual_correlation", priors.residual_correlation.numpyro()) if correlated else 0.0
    return cholesky_factor(sd_K, sd_C, r)


def cholesky_factor(
    sd_K: Float[Array, "*batch"], sd_C: Float[Array, "*batch"], correlation: Float[Array, "*batch"] | float
) -> Float[Array, "*batch 2 2"]:
    """The lower Cholesky factor of [[sd_K², r sd_K sd_C], [r sd_K sd_C, sd_C²]]."""
    zero = jnp.zeros_like(sd_K)
    first = jnp.stack([sd_K, zero], axis=-1)
    second = jnp.stack([sd_C * correlation, sd_C * jnp.sqrt(1 - jnp.square(correlation))], axis=-1)
    return jnp.stack([first, second], axis=-2)


def _common(part: ResponseArrays, priors: Priors, response: str) -> Float[Array, " row"]:
    intercept = numpyro.sample(f"intercept_{response}", getattr(priors.intercept, response).numpyro())
    exponent = numpyro.sample(f"mass_exponent_{response}", getattr(priors.mass_exponent, response).numpyro())
    expected = intercept + exponent * part.log_mass
    count = part.covariates.shape[-1]
    if count:
        prior = getattr(priors.covariate, response).numpyro().expand([count]).to_event(1)
        expected = expected + part.covariates @ numpyro.sample(f"covariate_effect_{response}", prior)
    return expected


def _group_effect(group: str, size: int, priors: Priors, response: str) -> Float[Array, " group"]:
    sd = numpyro.sample(f"sd_{group}_{response}", getattr(getattr(priors, f"sd_{group}"), response).numpyro())
    name = f"{group}_effect_{response}"
    # Sampled as a standard normal times sd: the data say little of each effect, and the plain form
    # has a funnel where sd is small.
    with numpyro.handlers.reparam(config={name: LocScaleReparam(0.0)}):
        return numpyro.sample(name, dist.Normal(0.0, sd).expand([size]).to_event(1))
