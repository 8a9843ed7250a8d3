"""Recorded decelerations of an impact on any mechanical element, with noise and a measuring chain.

(1 + gain) d(t - tau; V + dV) + b, to first order in the errors, d being F / M of the element: the columns of
the errors are d's derivative by V, d itself, 1 and minus its derivative in time. An element that is not
linear tells gain from velocity, since its deceleration is not in proportion to V, and so does gravity along
the motion, which does not come with V. What the samples share besides is noise: see
`bayestissue.likelihood.element.noise`. When contact was may be for the trace to tell: see
`bayestissue.likelihood.element.contact`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.elements import Element
from bayestissue.elements.element import impactor_share
from bayestissue.likelihood.element import clipped, contact, noise, spring_damper
from bayestissue.likelihood.element.force import force_rows, noise_of_force, noise_stride, with_force
from bayestissue.likelihood.element.record import CONTACT, DecelerationRecord
from bayestissue.likelihood.element.response import Response, columns, response
from bayestissue.likelihood.linear_errors import (
    Products,
    draw_errors,
    marginal_log_likelihood,
    prior_errors,
)
from bayestissue.oscillator import spring_damper_inverse

# A response this many times the trace is no impact; the products would keep seven digits.
_GREATEST = 1e4


class NoiseParameters(NamedTuple):
    """What the noise of each impact has for parameters.

    Attributes:
        log_sigma: log of the standard deviation [m/s^2].
        log_discrepancy: log of the discrepancy's rms [m/s^2]; None without one.
        log_force_sigma: of the noise of a force over mass [m/s^2]; None without one.
        log_force_ratio: log of that force over recorded mass times deceleration; None without one.
    """

    log_sigma: Float[Array, " impact"]
    log_discrepancy: Float[Array, " impact"] | None = None
    log_force_sigma: Float[Array, " impact"] | None = None
    log_force_ratio: Float[Array, " impact"] | None = None

    def ratio(self) -> Float[Array, " impact"]:
        """The discrepancy's rms over sigma."""
        if self.log_discrepancy is None:
            return jnp.zeros_like(self.log_sigma)
        return jnp.exp(self.log_discrepancy - self.log_sigma)


def _densities(
    predicted: Response, products: Products, parameters: NoiseParameters, record: DecelerationRecord
) -> Array:
    """Log density of each trace by contact in each cell, [cell, impact]."""
    error_sd = contact.error_sd(record)
    density = marginal_log_likelihood(products, parameters.log_sigma, error_sd, record.contact.uniform)
    if record.clipped is not None:
        density = density + clipped.log_probability(
            predicted, record, error_sd, parameters.log_sigma, parameters.log_discrepancy
        )
    return density + jnp.log(contact.cell_width(record)) if record.contact.reach else density


def _products(predicted: Response, parameters: NoiseParameters, record: DecelerationRecord) -> Products:
    """Of the residual and the errors' columns, in all channels."""
    products = contact.products(predicted, record, noise.noise_of(record, parameters.ratio()))
    if parameters.log_force_sigma is None or parameters.log_force_ratio is None:
        return products
    sigmas = parameters.log_sigma, parameters.log_force_sigma
    return with_force(products, predicted, record, parameters.log_force_ratio, *sigmas)


def _log_density(
    predicted: Response, parameters: NoiseParameters, record: DecelerationRecord
) -> Float[Array, " impact"]:
    products = _products(predicted, parameters, record)
    density = jax.nn.logsumexp(_densities(predicted, products, parameters, record), axis=0)
    if record.contact.reach:
        density = density - record.contact.quiet_log_density
    # Parameters far from anything seen may send a response beyond all bounds, where the products' digits are
    # lost and a density would be anything.
    greatest = _GREATEST * jnp.abs(record.d).max(-1)
    return jnp.where(jnp.abs(predicted.d).max(-1) <= greatest, density, -jnp.inf)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def element_log_likelihood(
    element: Element,
    parameters: Float[Array, "parameter impact"],
    noise_parameters: NoiseParameters,
    record: DecelerationRecord,
) -> Float[Array, " impact"]:
    """Log density of the recorded traces, errors and discrepancy integrated out.

    Its slopes go forwards through the solver, one tangent a parameter and all impacts in each, so that
    reverse mode too costs no more than that.

    Args:
        element: what is hit.
        parameters: as of `response`.
        noise_parameters: of the noise.
        record: the traces.
    """
    return _log_density(response(element, parameters, record), noise_parameters, record)


@element_log_likelihood.defjvp
def _element_jvp(element: Element, primals: Any, tangents: Any) -> tuple[Array, Array]:
    parameters, noise_parameters, record = primals
    number = parameters.shape[0]
    basis = jnp.broadcast_to(jnp.eye(number)[..., None], (number, *parameters.shape))

    def along(tangent: Array) -> tuple[Response, Response]:
        return jax.jvp(lambda p: response(element, p, record), (parameters,), (tangent,))

    predicted, changes = jax.vmap(along, out_axes=(None, 0))(basis)
    value, pull_back = jax.vjp(lambda f, n: _log_density(f, n, record), predicted, noise_parameters)
    by_response, by_noise = pull_back(jnp.ones_like(value))
    pairs = zip(jax.tree.leaves(changes), jax.tree.leaves(by_response), strict=True)
    slopes = sum((change * by).sum(tuple(range(2, change.ndim))) for change, by in pairs)
    along_noise = sum(by * to for by, to in zip(by_noise, tangents[1], strict=True) if by is not None)
    return value, (slopes * tangents[0]).sum(0) + along_noise


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["parameters", "noise_parameters", "record"],
    meta_fields=["element"],
)
@dataclass(frozen=True)
class MeasuredImpact:
    """The likelihood of deceleration traces, the errors of their measuring chain integrated out.

    Attributes:
        element: what is hit.
        parameters: as of `response`.
        noise_parameters: of the noise.
        record: the traces and what is known of their recording.
    """

    element: Element
    parameters: Float[Array, "parameter impact"]
    noise_parameters: NoiseParameters
    record: DecelerationRecord

    @property
    def sigma(self) -> Float[Array, " impact"]:
        """The noise's standard deviation [m/s^2]."""
        return jnp.exp(self.noise_parameters.log_sigma)

    @property
    def force_sigma(self) -> Float[Array, " impact"]:
        """The standard deviation of the noise of a force over mass [m/s^2]."""
        assert self.noise_parameters.log_force_sigma is not None  # noqa: S101 - for the type checker
        return jnp.exp(self.noise_parameters.log_force_sigma)

    def response(self) -> Response:
        """See `response`."""
        return response(self.element, self.parameters, self.record)

    def products(self, predicted: Response | None = None) -> Products:
        """Products of the residual and the errors' columns; ``predicted`` is `response`, if it is at hand."""
        predicted = self.response() if predicted is None else predicted
        return _products(predicted, self.noise_parameters, self.record)

    def log_density(self) -> Float[Array, " impact"]:
        """Log density of each recorded trace, its errors and its discrepancy integrated out."""
        record = self.record
        if record.side_by_side and record.clipped is None:
            omega_n, zeta = spring_damper_inverse(*self.parameters, record.mass)
            density = spring_damper.log_likelihood(omega_n, zeta, self.noise_parameters.log_sigma, record)
            return density + record.log_seen_in_interval()
        density = element_log_likelihood(self.element, self.parameters, self.noise_parameters, record)
        return density + self._of_shared_errors() + record.log_seen_in_interval()

    def _of_shared_errors(self) -> Array | float:
        """What makes the product over n impacts have the density of an error that all share once.

        Where the noise is small, a height h over the expected h_0 has the density of a normal error of the
        velocity, exp(-(h / h_0 - 1)^2 / 2 s^2) / h_0. Of n impacts with s n^1/2 in place of s the exponents
        add up to that, but h_0 divides n times: each has h_0^(1 - 1 / n) too many, h_0 being in proportion to
        M / (M + m).
        """
        record = self.record
        if record.shared_by is None:
            return 0.0
        names = (parameter.name for parameter in self.element.parameters)
        share = impactor_share(self.element, dict(zip(names, self.parameters, strict=True)), record.mass)
        return (1 - 1 / record.shared_by) * jnp.log(share)

    def draw_errors(self, key: Array, predicted: Response | None = None) -> Float[Array, "impact error"]:
        """The chain's errors given the recorded traces, contact time's counted from ``first_time`` (later).

        ``predicted`` is `response`, if it is at hand.
        """
        predicted = self.response() if predicted is None else predicted
        products, record, parameters = self.products(predicted), self.record, self.noise_parameters
        density = _densities(predicted, products, parameters, record)
        cell = jax.random.categorical(jax.random.fold_in(key, 2), density, axis=0)

        def chosen(values: Array) -> Array:
            values = jnp.broadcast_to(values, (*values.shape[:-2], *density.shape))
            return jnp.take_along_axis(
                values, jnp.broadcast_to(cell, (*values.shape[:-2], 1, len(cell))), -2
            )[..., 0, :]

        products = products._replace(gram=chosen(products.gram))
        error_sd = chosen(jnp.moveaxis(contact.error_sd(record), -1, 0)).T
        errors = draw_errors(key, products, parameters.log_sigma, error_sd, record.contact.uniform)
        return errors.at[:, CONTACT].add(record.first_time - chosen(record.cells))

    def mean_first_time(self) -> Float[Array, " impact"]:
        """From contact to the first sample as the traces have it, by the mean over the cells [s]."""
        if not self.record.contact.reach:
            return self.record.first_time
        predicted = self.response()
        density = _densities(predicted, self.products(predicted), self.noise_parameters, self.record)
        return (jax.nn.softmax(density, axis=0) * self.record.cells).sum(0)

    def as_drawn(self, contact_error: Float[Array, " impact"]) -> MeasuredImpact:
        """The same with contact where such an error puts it, and known."""
        record = self.record
        known = record.at_contact(jnp.maximum(record.first_time - contact_error, -record.lead * record.dt))
        known = known._replace(error_sd=known.error_sd.at[:, CONTACT].set(0.0))
        return MeasuredImpact(self.element, self.parameters, self.noise_parameters, known)

    def with_contact_found(self, key: Array) -> MeasuredImpact:
        """The same with contact known: where the trace has it, if the record leaves it to be found."""
        if not self.record.contact.reach:
            return self
        return self.as_drawn(self.draw_errors(jax.random.fold_in(key, 3))[:, CONTACT])

    def draw_discrepancy(
        self, key: Array, errors: Float[Array, "impact error"], predicted: Response | None = None
    ) -> Float[Array, "impact sample"]:
        """The discrepancy given traces and the chain's errors [m/s^2]; contact is known."""
        record, ratio = self.record, self.noise_parameters.ratio()
        left, basis, stride = (
            self.residuals(errors, predicted),
            record.discrepancy.basis,
            record.colour.stride,
        )
        sd = ratio[:, None] * jnp.sqrt(record.discrepancy.share)
        if record.clipped is not None:
            left = jnp.where(record.observed(), left, 0.0)
            basis = jnp.where(record.observed()[:, None], basis, 0.0)
        # Its own noise is that without a discrepancy.
        alone = noise.noise_of(record, jnp.zeros_like(ratio))
        shocks = self.sigma[:, None] * jax.random.normal(key, sd.shape[::-1]).T
        weights = jax.vmap(noise.weights_given)(left[:, ::stride], basis[..., ::stride], alone, sd, shocks)
        return jnp.einsum("im,imr->ir", weights, record.discrepancy.basis)

    def prior_errors(
        self, key: Array, sample_shape: tuple[int, ...] = ()
    ) -> Float[Array, "*batch impact error"]:
        """The chain's errors before any trace is seen; contact is known."""
        record, error_sd = self.record, contact.error_sd(self.record)[0]
        return prior_errors(key, (*sample_shape, len(record.d)), error_sd, record.contact.uniform)

    def prior_discrepancy(
        self, key: Array, sample_shape: tuple[int, ...] = ()
    ) -> Float[Array, "*batch impact sample"]:
        """The discrepancy before any trace is seen [m/s^2]."""
        modes = self.record.discrepancy
        scale = (self.sigma * self.noise_parameters.ratio())[:, None] * jnp.sqrt(modes.share)
        weights = scale * jax.random.normal(key, (*sample_shape, *scale.shape))
        return jnp.einsum("...im,imr->...ir", weights, modes.basis)

    def innovations(
        self, left: Float[Array, "impact sample"]
    ) -> tuple[Float[Array, "impact shock"], Int[Array, " impact"]]:
        """What is white of residuals [m/s^2], and how many of these there are of each impact.

        Of coloured noise at the samples that it is asked at.
        """
        record = self.record
        inside = record.observed()[:, :: record.colour.stride]
        if not record.colour.is_white:
            left = noise.innovations(record.colour, record.rate, left[:, :: record.colour.stride])
        return jnp.where(inside, left, 0.0), inside.sum(-1)

    def residuals(
        self, errors: Float[Array, "impact error"], predicted: Response | None = None
    ) -> Float[Array, "impact sample"]:
        """What these errors and the impact leave of the recorded traces [m/s^2]; contact is known."""
        predicted, record = self.response() if predicted is None else predicted, self.record
        return jnp.where(record.inside(), record.d - predicted.d - _added(errors, predicted, record), 0.0)

    def force_residuals(self, errors: Float[Array, "impact error"]) -> Float[Array, "impact row"]:
        """What these errors and the impact leave of a force over mass [m/s^2], 0 past a row's end."""
        ratio, force = self.noise_parameters.log_force_ratio, self.record.force
        assert force is not None  # noqa: S101 - for the type checker
        assert ratio is not None  # noqa: S101 - for the type checker
        expected, columns = force_rows(self.response(), self.record, ratio)
        left = force.y - expected - jnp.einsum("ie,ier->ir", errors, columns)
        return jnp.where(force.inside(), left, 0.0)

    def force_innovations(
        self, left: Float[Array, "impact row"]
    ) -> tuple[Float[Array, "impact shock"], Bool[Array, "impact shock"]]:
        """What is white of such residuals [m/s^2], and where there is any."""
        force = self.record.force
        assert force is not None  # noqa: S101 - for the type checker
        if (own := noise_of_force(force)) is None:
            return left, force.inside()
        thinned = jnp.where(own.inside, left[:, :: noise_stride(force)], 0.0)
        return jax.vmap(noise.Noise.whitened)(own, thinned), own.inside

    def _replicated_force(self, key: Array) -> Float[Array, "impact row"]:
        """A force [N] of the impact and errors that `sample` has by this key; contact is known."""
        force = self.record.force
        assert force is not None  # noqa: S101 - for the type checker
        errors = self.prior_errors(_keys_of_sample(key)[1])
        key, sigma = jax.random.fold_in(key, 5), self.force_sigma[:, None]
        if force.colour is None or force.rate is None:
            shocks = jax.random.normal(key, force.y.shape)
        else:
            shocks = noise.drawn(force.colour, force.rate, key, force.y.shape)
        drawn = force.y - self.force_residuals(errors) + sigma * shocks
        return jnp.where(force.inside(), self.record.mass[:, None] * drawn, jnp.nan)

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw traces: the impact, its discrepancy, the chain's errors and noise.

        Where the recorded trace has to tell when contact was, contact is where it has it: the samples are
        counted from what it shows.
        """
        if self.record.contact.reach:
            return self.with_contact_found(key).sample(key, sample_shape)
        key_of_noise, key_of_errors = _keys_of_sample(key)
        record, predicted = self.record, self.response()
        shape = (*sample_shape, len(record.d))
        errors = self.prior_errors(key_of_errors, sample_shape)
        shocks = jax.random.normal(key_of_noise, (*shape, record.d.shape[1]))
        if not record.colour.is_white:
            shocks = noise.drawn(record.colour, record.rate, jax.random.fold_in(key, 4), shocks.shape)
        delta = self.prior_discrepancy(jax.random.fold_in(key, 2), sample_shape)
        added = _added(errors, predicted, record) + self.sigma[:, None] * shocks
        return jnp.where(record.inside(), predicted.d + delta + added, 0.0)

    def noise_quantities(self) -> dict[str, Float[Array, " impact"]]:
        """What the noise of each trace is, by the names that posteriors have."""
        return {"sigma_d": self.sigma}

    def replicate(self, key: Array) -> dict[str, Float[Array, "impact sample"]]:
        """A replicate of every trace, the deceleration [m/s^2] with its discrepancy; NaN past its end.

        Of a force beside it one too [N].

        Of a clipped trace the sensor's limit cuts it too.
        """
        known = self.with_contact_found(key)
        recorded = known.record.within_limits(known.sample(key))
        traces = {"deceleration": jnp.where(known.record.inside(), recorded, jnp.nan)}
        return traces if known.record.force is None else traces | {"force": known._replicated_force(key)}


def _keys_of_sample(key: Array) -> tuple[Array, Array]:
    """Of the noise, and of the chain's errors."""
    first, second = jax.random.split(key)
    return first, second


def _added(
    errors: Float[Array, "*batch impact error"], predicted: Response, record: DecelerationRecord
) -> Float[Array, "*batch impact sample"]:
    """What the chain's errors add to the traces."""
    return jnp.asarray(sum(errors[..., i, None] * q for i, q in enumerate(columns(predicted, record))))
