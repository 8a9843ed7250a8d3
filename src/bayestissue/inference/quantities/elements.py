"""What the draws of an impact on any element stand for, in terms that all elements share."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.elements import element, element_names
from bayestissue.elements.comparables import comparables_of
from bayestissue.hierarchy.traces import (
    TraceData,
    TraceModel,
    element_parameters,
    physical,
)
from bayestissue.inference.quantities.static_force import at_common_depth, whole_at_common_depth, whole_impact
from bayestissue.likelihood.arma.displacement import MeasuredDisplacement
from bayestissue.likelihood.element.deceleration import MeasuredDeceleration
from bayestissue.likelihood.element.impact import MeasuredImpact
from bayestissue.likelihood.element.response import CONTACT, VELOCITY, ElementRecord, beside_parameters

COMPARABLE = {
    "K_tangent": ("N/m", "slope of the force with penetration at contact"),
    "K_secant": ("N/m", "force over penetration at the greatest penetration"),
    "C_equivalent": ("N s/m", "damping of the spring and damper that lose as much from contact to peak"),
    "energy_lost": ("1", "share of the impactor's energy that it has lost when it leaves"),
}
# Of elements whose stiffness depends on depth, and of any with a discrepancy.
COMMON_DEPTH = "K_common_depth"
_AT_ONE_DEPTH = "static force over depth at the one depth, common_depth_m, that every impact reaches"
_DISCREPANCY = "rms of the force beside the element's, relative to the trace's peak"


class Measured(NamedTuple):
    """What the recorded traces tell besides the impacts' parameters.

    Attributes:
        chain_error: a draw of the chain's errors.
        impact: beside a discrepancy, the traces' distribution with contact where the errors put it.
        discrepancy: a draw of it [m/s^2].
    """

    chain_error: Float[Array, "impact error"]
    impact: MeasuredImpact | None = None
    discrepancy: Float[Array, "impact sample"] | None = None


def measured_of(
    distribution: MeasuredDisplacement | MeasuredDeceleration | MeasuredImpact, key: Array
) -> Measured:
    """A draw of the errors, and of the discrepancy, given the traces and the impacts' parameters."""
    if not isinstance(distribution, MeasuredImpact) or distribution.log_discrepancy is None:
        return Measured(distribution.draw_errors(key))
    stated, distribution = distribution, distribution.with_contact_found(key)
    found = distribution.response()
    errors = distribution.draw_errors(key, found)
    delta = distribution.draw_discrepancy(jax.random.fold_in(key, 3), errors, found)
    at_contact = distribution.as_drawn(errors[:, CONTACT])
    errors = errors.at[:, CONTACT].add(stated.record.first_time - distribution.record.first_time)
    return Measured(errors, at_contact, delta)


def element_quantities(
    model: TraceModel,
    data: TraceData,
    u: list[Array],
    mass_error: Float[Array, " impact"],
    measured: Measured,
) -> dict[str, Array]:
    """The element's further parameters, and stiffness, damping and loss that compare across elements.

    omega_n = sqrt(K_secant / M) and zeta = C_equivalent / (2 sqrt(K_secant M)). Force is in proportion to K
    and C together, so that an error of the mass moves all stiffnesses and dampings alike. With a discrepancy
    K_secant and K_common_depth are those of element and discrepancy together, and the rest the element's own.
    Of autoregressive noise there are its correlation and, as sigma_d, its own standard deviation, not its
    shocks'. Nothing for a record that is of spring and damper side by side alone.
    """
    record = data.record
    if not isinstance(record, ElementRecord):
        return {}
    which, values = element(model.element), element_parameters(model, u)
    p = {parameter.name: value for parameter, value in zip(which.parameters, values, strict=True)}
    own = p | beside_parameters(record)
    found = comparables_of(which, own, record.mass, record.velocity + measured.chain_error[:, VELOCITY])
    heavier = jnp.exp(mass_error)
    further, common = {}, None
    if measured.impact is not None and measured.discrepancy is not None:
        whole = whole_impact(measured.impact, measured.discrepancy, measured.chain_error[:, VELOCITY])
        found = found._replace(K_secant=whole.secant)
        further = {"discrepancy": jnp.exp(u[-1])}
        if record.common_depth is not None:
            common = whole_at_common_depth(measured.impact, whole, record.common_depth)
    elif record.common_depth is not None:
        common = at_common_depth(which, own, record.common_depth)
    if model.autoregressive:
        log_sigma = physical(model, data, u).log_sigma
        further = {"noise_correlation": jnp.tanh(u[-1]), "sigma_d": jnp.exp(log_sigma) * jnp.cosh(u[-1])}
    return {
        **{parameter.name: p[parameter.name] for parameter in which.extra},
        **{name: getattr(found, name) * heavier for name in ("K_tangent", "K_secant", "C_equivalent")},
        **({} if common is None else {COMMON_DEPTH: common * heavier}),
        "energy_lost": found.energy_lost,
        "omega_n": jnp.sqrt(found.K_secant / record.mass),
        "zeta": found.C_equivalent / (2 * jnp.sqrt(found.K_secant * record.mass)),
        **further,
    }


def element_attributes() -> dict[str, dict[str, str]]:
    """Unit and meaning of the variables that elements have besides K and C."""
    correlation, of_log = (
        "of the noise's correlation from sample to sample",
        "mean over impacts of the log of",
    )
    table = COMPARABLE | {
        "noise_correlation": ("1", "correlation of the noise from sample to sample"),
        "atanh_noise_correlation_mean": ("1", f"mean over impacts of artanh {correlation}"),
        "sd_atanh_noise_correlation": (
            "1",
            "standard deviation between impacts of artanh of the noise's correlation",
        ),
        "discrepancy": ("1", _DISCREPANCY),
        "discrepancy_mean": ("1", f"{of_log} the {_DISCREPANCY}"),
        "sd_discrepancy": ("1", "standard deviation of that log between impacts"),
        COMMON_DEPTH: ("N/m", _AT_ONE_DEPTH),
    }
    for name, which in ((COMMON_DEPTH, _AT_ONE_DEPTH), ("K_secant", "that at each impact's greatest depth")):
        meaning = f"slope of the log of the stiffness on log mass, all else equal: {which}"
        table[f"mass_exponent_{name}"] = "1", meaning
    for parameter in (each for name in element_names() for each in element(name).extra):
        own, log = parameter.name, f"log_{parameter.name}"
        table[own] = parameter.unit, parameter.meaning
        table[f"{log}_mean"] = "1", f"{of_log} {own}"
        table[f"sd_{log}"] = "1", f"standard deviation between impacts of the log of {own}"
    return {name: {"unit": unit, "long_name": meaning} for name, (unit, meaning) in table.items()}


def per_impact() -> tuple[str, ...]:
    """Names of the variables of an impact that elements have besides K and C."""
    extras = (parameter.name for name in element_names() for parameter in element(name).extra)
    return (*COMPARABLE, COMMON_DEPTH, *dict.fromkeys(extras), "discrepancy", "noise_correlation")
