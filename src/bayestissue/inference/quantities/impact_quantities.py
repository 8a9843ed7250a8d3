"""The quantities of every impact in one draw, of posterior or prior: the one place where they are made.

A new quantity is an entry of `QUANTITIES`, and of ``results/variables.toml`` with its unit and meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Self, cast

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float
from scipy.constants import g as standard_gravity

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerSample
from bayestissue.base.outcome_table import HEADFORM_OUTCOMES, MEASURED
from bayestissue.inference.quantities.whole import (
    Whole,
    at_common_depth,
    whole_at_common_depth,
    whole_impact,
)
from bayestissue.mechanics.elements import Element, Outcomes, element, element_names
from bayestissue.mechanics.elements.element import GRAVITY, Collision
from bayestissue.mechanics.elements.outcomes import outcomes_of
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.trace_models import (
    GAIN,
    Physical,
    TraceData,
    TraceModel,
    element_parameters,
    physical,
    trace_likelihood,
)
from bayestissue.model.likelihood.impact import MeasuredImpact
from bayestissue.model.likelihood.record import CONTACT, DecelerationRecord

# Of elements whose stiffness depends on depth, and of any with a discrepancy.
COMMON_DEPTH = "K_common_depth"


@dataclass(frozen=True)
class Impacts:
    """Every impact in one draw.

    Forces are in proportion to K, C and mass together, so that an error of the mass moves them alike and
    changes no motion.

    Attributes:
        model: what is assumed.
        data: the recordings.
        u: each impact's parameters, K and C at the recorded mass.
        mass_error: of the log mass.
        chain_error: the measuring chain's errors, but of a gain that all impacts share.
        velocity_error: that of the recorded velocity [m/s]; None where none is recorded.
        measured: beside a discrepancy, the traces' likelihood with contact where the errors put it.
        discrepancy: the force beside the element's, over mass [m/s^2].
    """

    model: TraceModel
    data: TraceData
    u: list[Array]
    mass_error: JaxPerImpact
    chain_error: Float[Array, "impact error"]
    velocity_error: JaxPerImpact | None
    measured: MeasuredImpact | None = None
    discrepancy: JaxPerSample | None = None

    @classmethod
    def drawn(
        cls,
        model: TraceModel,
        data: TraceData,
        u: list[Array],
        mass_error: JaxPerImpact,
        key: Array,
        recorded: Bool[Array, ""],
    ) -> Self:
        """With a draw of the chain's errors, and of the discrepancy.

        Args:
            model: what is assumed.
            data: the recordings.
            u: each impact's parameters.
            mass_error: of the log mass.
            key: of the draw.
            recorded: whether it is given what was recorded, else as nothing but the priors has it.
        """
        likelihood: Any = trace_likelihood(model, data, u)
        given_record, measured, discrepancy = likelihood.draw_errors, None, None
        if model.discrepancy:
            likelihood = likelihood.with_contact_found(key)
            given_record = partial(likelihood.draw_errors, predicted=likelihood.response())
        errors = jax.lax.cond(recorded, given_record, likelihood.prior_errors, key)
        if model.discrepancy:
            discrepancy = likelihood.discrepancy(errors)
            errors = errors[:, -len(data.record.errors) :]
            measured = likelihood.as_drawn(errors[:, CONTACT])
        if model.discrepancy or model.contact:
            errors = errors.at[:, CONTACT].add(data.record.first_time - likelihood.record.first_time)
        velocity_error = data.record.velocity_error(errors, jax.random.fold_in(key, 5))
        return cls(model, data, u, mass_error, errors, velocity_error, measured, discrepancy)

    @cached_property
    def physical(self) -> Physical:
        """Natural frequency, damping ratio and noise, as the likelihood takes them."""
        return physical(self.model, self.data, self.u)

    @cached_property
    def element(self) -> Element:
        """What is hit."""
        return element(self.model.element)

    @cached_property
    def recorded_parameters(self) -> dict[str, JaxPerImpact]:
        """The element's parameters by name, at the recorded mass."""
        values = element_parameters(self.model, self.u)
        return {one.name: value for one, value in zip(self.element.parameters, values, strict=True)}

    @cached_property
    def parameters(self) -> dict[str, JaxPerImpact]:
        """The element's parameters by name."""
        true = {"K": jnp.exp(self.u[0] + self.mass_error), "C": jnp.exp(self.u[1] + self.mass_error)}
        masses = (one.name for one in self.element.extra if one.of_mass)
        true |= {name: self.recorded_parameters[name] * jnp.exp(self.mass_error) for name in masses}
        return self.recorded_parameters | true

    @cached_property
    def mass(self) -> JaxPerImpact:
        """M [kg]."""
        return jnp.exp(self.data.log_mass + self.mass_error)

    @property
    def side_by_side(self) -> bool:
        """Whether K and C are those of a spring and damper whose trace is told by these alone."""
        alone = self.model.element == SIDE_BY_SIDE and not self.model.discrepancy
        return alone and self.data.record.side_by_side

    @cached_property
    def whole(self) -> Whole | None:
        """The motion under element and discrepancy together; of recorded mass."""
        if self.measured is None or self.discrepancy is None or self.velocity_error is None:
            return None
        return whole_impact(self.measured, self.discrepancy, self.velocity_error)

    @cached_property
    def collision(self) -> Collision | None:
        """The impacts at their true mass and velocity; None where no velocity is recorded."""
        record = self.data.record
        if self.velocity_error is None or record.velocity is None:
            return None
        p, velocity = self.parameters | record.surroundings, record.velocity + self.velocity_error
        return Collision(self.element, p, self.mass, velocity)

    @cached_property
    def outcomes(self) -> Outcomes | None:
        """What each impact comes to; None where no velocity is recorded.

        Beside a discrepancy the measured motion tells peaks and secant stiffness, and the rest is the
        element's own.
        """
        if self.collision is None:
            return None
        of_element = outcomes_of(self.collision, headform=self.model.headform)
        if self.whole is None:
            return of_element
        heavier = jnp.exp(self.mass_error)
        return of_element | {
            "K_secant": self.whole.secant * heavier,
            "peak_depth": self.whole.peak,
            "time_to_peak": self.whole.time,
            "peak_force": self.whole.greatest * heavier,
            "peak_deceleration": self.whole.greatest * heavier / (self.mass * standard_gravity),
        }

    @cached_property
    def common_depth(self) -> JaxPerImpact | None:
        """Static force over depth at the one depth that every impact reaches [N/m]."""
        if self.side_by_side or not self.model.depends_on_depth:
            return None
        record, heavier = cast(DecelerationRecord, self.data.record), jnp.exp(self.mass_error)
        if self.measured is not None and self.whole is not None:
            return whole_at_common_depth(self.measured, self.whole, record.common_depth) * heavier
        arguments = self.recorded_parameters | record.surroundings
        return at_common_depth(self.element, arguments, record.common_depth) * heavier

    @cached_property
    def noise(self) -> dict[str, JaxPerImpact]:
        """The parameters of each trace's noise by name."""
        return trace_likelihood(self.model, self.data, self.u).noise_quantities()

    def omega_n(self) -> JaxPerImpact:
        """(K / M)^1/2 [rad/s], K being K_secant and M all that moves."""
        if self.side_by_side or self.collision is None or self.outcomes is None:
            return self.physical.omega_n
        return jnp.sqrt(self.outcomes["K_secant"] / self.collision.inertia)

    def zeta(self) -> JaxPerImpact:
        """C / (2 (K M)^1/2), K being K_secant, C C_equivalent and M all that moves."""
        if self.side_by_side or self.collision is None or self.outcomes is None:
            return self.physical.zeta
        K, C = self.outcomes["K_secant"], self.outcomes["C_equivalent"]
        return C / (2 * jnp.sqrt(K * self.collision.inertia))


def _comparable(impacts: Impacts, name: str) -> Array | None:
    """Of spring and damper side by side alone these are K and C themselves."""
    return None if impacts.side_by_side or impacts.outcomes is None else impacts.outcomes[name]


def _outcome(impacts: Impacts, name: str) -> Array | None:
    """What the measured motion does not reach, beside a discrepancy, is not known."""
    if impacts.outcomes is None or (impacts.model.discrepancy and name not in MEASURED):
        return None
    if name == "energy_share_with_gravity" and GRAVITY not in impacts.data.record.surroundings:
        return None
    return impacts.outcomes.get(name)


_COMPARABLE = ("K_tangent", "K_secant", "C_equivalent", "energy_lost")
# By the names of variables; None where these impacts have no such quantity.
QUANTITIES: dict[str, Callable[[Impacts], Array | None]] = {
    "K": lambda impacts: impacts.parameters["K"],
    "C": lambda impacts: impacts.parameters["C"],
    "omega_n": Impacts.omega_n,
    "zeta": Impacts.zeta,
    "theta1": lambda impacts: impacts.noise.get("theta1"),
    "sigma_a": lambda impacts: impacts.noise.get("sigma_a"),
    "sigma_d": lambda impacts: impacts.noise.get("sigma_d"),
    "mass": lambda impacts: impacts.mass,
    **{name: partial(_comparable, name=name) for name in _COMPARABLE},
    COMMON_DEPTH: lambda impacts: impacts.common_depth,
    "discrepancy": lambda impacts: jnp.exp(impacts.u[-1]) if impacts.model.discrepancy else None,
    **{name: partial(_outcome, name=name) for name in HEADFORM_OUTCOMES},
}
# Those of all impacts, and the further parameters of elements.
NAMES = (*QUANTITIES, *dict.fromkeys(one.name for name in element_names() for one in element(name).extra))


def named_quantities(impacts: Impacts, names: Iterable[str] = QUANTITIES) -> dict[str, JaxPerImpact]:
    """Those of these quantities that the impacts have."""
    values = ((name, QUANTITIES[name](impacts)) for name in names)
    return {name: value for name, value in values if value is not None}


def impact_quantities(impacts: Impacts) -> dict[str, Float[Array, "impact ..."]]:
    """All quantities of every impact by name, with its parameters and the chain's errors."""
    further = {one.name: impacts.parameters[one.name] for one in impacts.element.extra}
    known: dict[str, Any] = named_quantities(impacts)
    # That of a gain which all impacts share is an error of each.
    log_gain, chain_error = impacts.model.named(impacts.u).get(GAIN), impacts.chain_error
    if log_gain is not None:
        chain_error = chain_error + impacts.data.record.of_gain(log_gain)
    return known | further | {"parameters": jnp.stack(impacts.u, axis=-1), "chain_error": chain_error}
