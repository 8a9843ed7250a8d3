"""What the draws of an impact on any element stand for, in terms that all elements share."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.elements import element, element_names
from bayestissue.elements.comparables import comparables_of
from bayestissue.hierarchy.traces import TraceData, TraceModel, element_parameters
from bayestissue.likelihood.element_impact import ElementRecord

COMPARABLE = {
    "K_tangent": ("N/m", "slope of the force with penetration at contact"),
    "K_secant": ("N/m", "force over penetration at the greatest penetration"),
    "C_equivalent": ("N s/m", "damping of the spring and damper that lose as much from contact to peak"),
    "energy_lost": ("1", "share of the impactor's energy that it has lost when it leaves"),
}


def element_quantities(
    model: TraceModel,
    data: TraceData,
    u: list[Array],
    mass_error: Float[Array, " impact"],
    chain_error: Float[Array, "impact error"],
) -> dict[str, Array]:
    """The element's further parameters, and stiffness, damping and loss that compare across elements.

    omega_n = sqrt(K_secant / M) and zeta = C_equivalent / (2 sqrt(K_secant M)). Force is in proportion to K
    and C together, so that an error of the mass moves all stiffnesses and dampings alike. Nothing for a
    record that is of spring and damper side by side.
    """
    record = data.record
    if not isinstance(record, ElementRecord):
        return {}
    which, values = element(model.element), element_parameters(model, data, u)
    p = {parameter.name: value for parameter, value in zip(which.parameters, values, strict=False)}
    found = comparables_of(
        which, {**p, "diameter_m": record.diameter}, record.mass, record.velocity + chain_error[:, 0]
    )
    heavier = jnp.exp(mass_error)
    return {
        **{parameter.name: p[parameter.name] for parameter in which.extra},
        **{name: getattr(found, name) * heavier for name in ("K_tangent", "K_secant", "C_equivalent")},
        "energy_lost": found.energy_lost,
        "omega_n": jnp.sqrt(found.K_secant / record.mass),
        "zeta": found.C_equivalent / (2 * jnp.sqrt(found.K_secant * record.mass)),
    }


def element_attributes() -> dict[str, dict[str, str]]:
    """Unit and meaning of the variables that elements have besides K and C."""
    table = {
        "contact_mean": {
            "unit": "1",
            "long_name": "mean over impacts of how much earlier contact was than found, in samples",
        },
        "sd_contact": {"unit": "1", "long_name": "standard deviation of that between impacts"},
    }
    table |= {name: {"unit": unit, "long_name": meaning} for name, (unit, meaning) in COMPARABLE.items()}
    for name in element_names():
        for parameter in element(name).extra:
            own, log = parameter.name, f"log_{parameter.name}"
            table[own] = {"unit": parameter.unit, "long_name": parameter.meaning}
            table[f"{log}_mean"] = {"unit": "1", "long_name": f"mean over impacts of the log of {own}"}
            spread = f"standard deviation between impacts of the log of {own}"
            table[f"sd_{log}"] = {"unit": "1", "long_name": spread}
    return table


def per_impact() -> tuple[str, ...]:
    """Names of the variables of an impact that elements have besides K and C."""
    extras = (parameter.name for name in element_names() for parameter in element(name).extra)
    return (*COMPARABLE, *dict.fromkeys(extras))
