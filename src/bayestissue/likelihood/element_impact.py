"""Recorded decelerations of an impact on any mechanical element, with white noise and a measuring chain.

(1 + g) d(t - tau; V + dV) + b, to first order in the errors, d being F / M of the element: the columns of
the errors are d's derivative by V, d itself, 1 and minus its derivative in time. An element that is not
linear tells gain from velocity, since its deceleration is not in proportion to V.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Bool, Float, Int
from numpyro.distributions import constraints

from bayestissue.elements import Element, linear, solver
from bayestissue.elements.element import deceleration_of, rates_of_motion
from bayestissue.likelihood.linear_errors import (
    Products,
    draw_errors,
    gram,
    marginal_log_likelihood,
    prior_errors,
)


class ElementRecord(NamedTuple):
    """What the likelihood reads of a set of deceleration traces.

    Attributes:
        d: decelerations, 0 past a row's end [m/s^2].
        n_samples: length of each.
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
        velocity: recorded velocity at contact [m/s].
        error_sd: standard deviations of velocity [m/s], gain [1], offset [m/s^2] and contact time [s].
        uniform: where the contact time's error is uniform instead of normal.
        mass: recorded mass [kg].
        diameter: of the impactor [m].
    """

    d: Float[Array, "impact sample"]
    n_samples: Int[Array, " impact"]
    first_time: Float[Array, " impact"]
    dt: Float[Array, " impact"]
    velocity: Float[Array, " impact"]
    error_sd: Float[Array, "impact 4"]
    uniform: Bool[Array, " impact"]
    mass: Float[Array, " impact"]
    diameter: Float[Array, " impact"]

    @classmethod
    def of(cls, *arrays: np.ndarray) -> ElementRecord:
        """From numpy arrays in the order of the attributes; values past a row's end are cleared."""
        made = cls(*(jnp.asarray(array) for array in arrays))
        return made._replace(d=jnp.where(made.inside(), made.d, 0.0))

    def inside(self) -> Bool[Array, "impact sample"]:
        """True where there is a sample."""
        return jnp.arange(self.d.shape[1]) < self.n_samples[:, None]

    def time(self) -> Float[Array, "impact sample"]:
        """Time since contact, also past a row's end [s]."""
        return self.first_time[:, None] + jnp.arange(self.d.shape[1]) * self.dt[:, None]


class Response(NamedTuple):
    """An impact as recorded without errors, and how errors change it; all 0 past a trace's end.

    Attributes:
        d: deceleration [m/s^2].
        by_velocity: its derivative by the velocity at contact [1/s].
        jerk: its derivative in time [m/s^3].
    """

    d: Float[Array, "impact sample"]
    by_velocity: Float[Array, "impact sample"]
    jerk: Float[Array, "impact sample"]


def displacement(
    element: Element, parameters: Float[Array, "parameter impact"], record: ElementRecord
) -> Float[Array, "impact sample"]:
    """The element's penetration at the samples, also past a row's end [m]."""
    return _states(element, parameters, record.velocity, record)[0]


def response(
    element: Element, parameters: Float[Array, "parameter impact"], record: ElementRecord
) -> Response:
    """The element's answer at the samples.

    Args:
        element: what is hit.
        parameters: its parameters in their order, and after them, where contact is not known from the record
            alone, by how much earlier it was than the record says [s].
        record: masses, velocities and times.
    """
    p = {name: value[:, None] for name, value in _named(element, parameters, record).items()}
    mass, inside = record.mass[:, None], record.inside()

    def d_and_jerk(velocity: Array) -> tuple[Array, Array]:
        y = _states(element, parameters, velocity, record)
        flow = rates_of_motion(element, p, mass, y)
        return jax.jvp(lambda y: deceleration_of(element, p, mass, y), (y,), (flow,))

    if element.linear:
        d, jerk = d_and_jerk(record.velocity)
        by_velocity = d / record.velocity[:, None]
    else:
        (d, jerk), (by_velocity, _) = jax.jvp(
            d_and_jerk, (record.velocity,), (jnp.ones_like(record.velocity),)
        )
    return Response(*(jnp.where(inside, part, 0.0) for part in (d, by_velocity, jerk)))


def _named(element: Element, parameters: Array, record: ElementRecord) -> dict[str, Array]:
    names = [parameter.name for parameter in element.parameters]
    return {**dict(zip(names, parameters[: len(names)], strict=True)), "diameter_m": record.diameter}


def _states(element: Element, parameters: Array, velocity: Array, record: ElementRecord) -> Array:
    grid = linear.even_grid if element.linear else solver.even_grid
    p, later = _named(element, parameters, record), parameters[len(element.parameters) :]
    first_time = record.first_time + later[0] if len(later) else record.first_time
    return grid(element, p, record.mass, velocity, first_time, record.dt, record.d.shape[1])


def _columns(found: Response, record: ElementRecord) -> tuple[Array, Array, Array, Array]:
    return found.by_velocity, found.d, jnp.where(record.inside(), 1.0, 0.0), -found.jerk


def _products(found: Response, value: Array, record: ElementRecord) -> Products:
    residual = jnp.where(record.inside(), value - found.d, 0.0)
    count = record.n_samples + 0.0
    return Products(gram((residual, *_columns(found, record)), jnp.ones(())), jnp.zeros_like(count), count)


def _log_density(found: Response, log_sigma: Array, value: Array, record: ElementRecord) -> Array:
    products = _products(found, value, record)
    return marginal_log_likelihood(products, log_sigma, record.error_sd, record.uniform)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def element_log_likelihood(
    element: Element,
    parameters: Float[Array, "parameter impact"],
    log_sigma: Float[Array, " impact"],
    record: ElementRecord,
) -> Float[Array, " impact"]:
    """Log density of the recorded traces, errors integrated out.

    Its slopes go forwards through the solver, one tangent a parameter and all impacts in each, so that
    reverse mode too costs no more than that.

    Args:
        element: what is hit.
        parameters: as of `response`.
        log_sigma: log of the noise's standard deviation [m/s^2].
        record: the traces.
    """
    return _log_density(response(element, parameters, record), log_sigma, record.d, record)


@element_log_likelihood.defjvp
def _element_jvp(element: Element, primals: Any, tangents: Any) -> tuple[Array, Array]:
    parameters, log_sigma, record = primals
    number = parameters.shape[0]
    basis = jnp.broadcast_to(jnp.eye(number)[..., None], (number, *parameters.shape))

    def along(tangent: Array) -> tuple[Response, Response]:
        return jax.jvp(lambda p: response(element, p, record), (parameters,), (tangent,))

    found, changes = jax.vmap(along, out_axes=(None, 0))(basis)
    value, pull_back = jax.vjp(lambda f, s: _log_density(f, s, record.d, record), found, log_sigma)
    by_response, by_log_sigma = pull_back(jnp.ones_like(value))
    slopes = sum((change * by).sum(-1) for change, by in zip(changes, by_response, strict=True))
    return value, (slopes * tangents[0]).sum(0) + by_log_sigma * tangents[1]


class MeasuredImpact(dist.Distribution):
    """Distribution of whole deceleration traces; one event an impact, its errors integrated out.

    Args:
        element: what is hit.
        parameters: as of `response`.
        log_sigma: log of the noise's standard deviation [m/s^2].
        record: see `ElementRecord`.
    """

    arg_constraints = {"log_sigma": constraints.real}  # noqa: RUF012
    support = constraints.real_vector
    pytree_data_fields = ("parameters", "log_sigma", "record")
    pytree_aux_fields = ("element",)

    def __init__(
        self,
        element: Element,
        parameters: Array,
        log_sigma: Array,
        record: ElementRecord,
        *,
        validate_args: bool | None = None,
    ) -> None:
        self.element, self.parameters, self.log_sigma, self.record = element, parameters, log_sigma, record
        super().__init__(log_sigma.shape, record.d.shape[1:], validate_args=validate_args)

    def response(self) -> Response:
        """See `response`."""
        return response(self.element, self.parameters, self.record)

    def products(self, value: Array | None = None) -> Products:
        """Products of the residual at ``value`` (the record's own unless given) and the errors' columns."""
        return _products(self.response(), self.record.d if value is None else value, self.record)

    def log_prob(self, value: Float[Array, "impact sample"]) -> Float[Array, " impact"]:
        """Log density of each impact's trace, its errors integrated out."""
        if value is self.record.d:
            return element_log_likelihood(self.element, self.parameters, self.log_sigma, self.record)
        return _log_density(self.response(), self.log_sigma, value, self.record)

    def draw_errors(self, key: Array) -> Float[Array, "impact 4"]:
        """The chain's errors given the recorded traces: velocity, gain, offset, contact time."""
        record = self.record
        return draw_errors(key, self.products(), self.log_sigma, record.error_sd, record.uniform)

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw traces: the impact, the chain's errors and white noise."""
        key_of_noise, key_of_errors = jax.random.split(key)
        shape = (*sample_shape, *self.batch_shape)
        found = self.response()
        errors = prior_errors(key_of_errors, shape, self.record.error_sd, self.record.uniform)
        columns = _columns(found, self.record)
        added = sum(errors[..., i, None] * column for i, column in enumerate(columns))
        noise = jax.random.normal(key_of_noise, (*shape, *self.event_shape))
        seen = found.d + added + jnp.exp(self.log_sigma)[:, None] * noise
        return jnp.where(self.record.inside(), seen, 0.0)
