"""Recorded decelerations of an impact on any mechanical element, with noise and a measuring chain.

(1 + gain) d(t - tau; V + dV) + b, to first order in the errors, d being F / M of the element: the columns of
the errors are d's derivative by V, d itself, 1 and minus its derivative in time. An element that is not
linear tells gain from velocity, since its deceleration is not in proportion to V, and so does gravity along
the motion, which does not come with V. Where the element's law is
not trusted a smooth discrepancy is added: see `bayestissue.likelihood.element.discrepancy`. Noise is white
or, without a discrepancy, first-order autoregressive: see `bayestissue.likelihood.autoregressive`. Or a part
of it went through a recorder's low-pass: see `bayestissue.likelihood.element.coloured`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from jax import Array
from jaxtyping import Float, Int
from numpyro.distributions import constraints

from bayestissue.elements import Element
from bayestissue.likelihood import autoregressive
from bayestissue.likelihood.element import coloured, contact_cells, discrepancy
from bayestissue.likelihood.element.response import (
    CONTACT,
    OFFSET,
    ElementRecord,
    Response,
    columns,
    in_proportion,
    response,
)
from bayestissue.likelihood.linear_errors import (
    Products,
    draw_errors,
    gram,
    marginal_log_likelihood,
    prior_errors,
)

# A response this many times the trace is no impact; the products would keep seven digits.
_GREATEST = 1e4
# Among the chain's errors.


class _Noise(NamedTuple):
    """What a trace holds besides the impact and the chain's errors: see `element_log_likelihood`."""

    log_sigma: Array
    log_discrepancy: Array | None
    atanh_correlation: Array | None


def _products(
    element: Element, predicted: Response, noise: _Noise, value: Array, record: ElementRecord
) -> Products:
    of_columns = partial(_products_of_columns, noise, record)
    if record.colour is not None and record.before is not None:
        in_colour = partial(_products_in_colour, noise, record)
        linear = in_proportion(element, record)
        return contact_cells.products_of_all_rows(predicted, value, record, in_colour, linear=linear)
    if record.before is None:
        residual = jnp.where(record.inside(), value - predicted.d, 0.0)
        return of_columns((residual, *columns(predicted, record)))
    if _white(noise):
        return contact_cells.products(predicted, value, record, linear=in_proportion(element, record))
    return contact_cells.products_in_columns(predicted, value, record, of_columns)


def _white(noise: _Noise) -> bool:
    """Whether a trace holds nothing else that its samples share."""
    return noise.atanh_correlation is None and noise.log_discrepancy is None


def _products_in_colour(
    noise: _Noise, record: ElementRecord, inside: Array, parts: Sequence[Array]
) -> Products:
    """Of rows of the samples that coloured noise is asked at: those of the window, and some before it."""
    assert record.colour is not None  # noqa: S101 - for the type checker
    assert record.rate is not None  # noqa: S101 - for the type checker
    stride, modes = record.colour.stride, []
    if noise.log_discrepancy is not None and record.basis is not None:
        reach = 0 if record.before is None else math.prod(contact_cells.shape(record))
        modes = list(jnp.pad(record.basis, ((0, 0), (0, 0), (reach, 0)))[:, :, ::stride])
    products = coloured.products(record.colour, record.rate, inside, [*parts, *modes])
    if noise.log_discrepancy is None or record.share is None or not modes:
        return products
    number = len(parts)
    plain = products._replace(gram=tuple(row[:number] for row in products.gram[:number]))
    # Not all parts have cells.
    shape = jnp.broadcast_shapes(*(row[number].shape for row in products.gram[:number]))
    along = [
        jnp.stack([jnp.broadcast_to(entry, shape) for entry in row[number:]])
        for row in products.gram[:number]
    ]
    ratio = discrepancy.ratios(noise.log_sigma, noise.log_discrepancy, record.share)
    modes_gram = [row[number:] for row in products.gram[number:]]
    return discrepancy.with_discrepancy(plain, along, ratio, modes_gram)


def _products_of_columns(noise: _Noise, record: ElementRecord, parts: tuple[Array, ...]) -> Products:
    """Of residual and error columns at one moment of contact."""
    if record.colour is not None:
        stride = record.colour.stride
        inside = record.inside()[:, ::stride]
        return _products_in_colour(noise, record, inside, [part[:, ::stride] for part in parts])
    count = record.n_samples + 0.0
    if noise.atanh_correlation is not None:
        a = noise.atanh_correlation
        white = tuple(autoregressive.whitened(part, a, record.inside()) for part in parts)
        return Products(gram(white, jnp.ones(())), autoregressive.log_determinant(a), count)
    plain = Products(gram(parts, jnp.ones(())), jnp.zeros_like(count), count)
    if noise.log_discrepancy is None or record.basis is None or record.share is None:
        return plain
    ratio = discrepancy.ratios(noise.log_sigma, noise.log_discrepancy, record.share)
    return discrepancy.with_discrepancy(plain, [(record.basis * part).sum(-1) for part in parts], ratio)


def _log_density(
    element: Element, predicted: Response, noise: _Noise, value: Array, record: ElementRecord
) -> Array:
    products = _products(element, predicted, noise, value, record)
    density = marginal_log_likelihood(products, noise.log_sigma, _error_sd(noise, record), record.uniform)
    if record.before is not None:
        density = jax.nn.logsumexp(density, axis=0) + jnp.log(contact_cells.cell_width(record))
        if _white(noise) and record.colour is None:
            density = density - contact_cells.quiet_density(record)
    # Parameters far from anything seen may send a response beyond all bounds, where the products' digits are
    # lost and a density would be anything.
    greatest = _GREATEST * jnp.abs(record.d).max(-1)
    return jnp.where(jnp.abs(predicted.d).max(-1) <= greatest, density, -jnp.inf)


def _error_sd(noise: _Noise, record: ElementRecord) -> Array:
    error_sd = record.error_sd if record.before is None else contact_cells.error_sd(record, record.error_sd)
    if noise.atanh_correlation is None or record.quiet is None:
        return error_sd
    return autoregressive.offset_sd(error_sd, record.quiet, noise.atanh_correlation, OFFSET)


def _of_cell(cell: Array, shape: tuple[int, ...], values: Array) -> Array:
    """What broadcasts to [cell, impact], that shape, at one cell of each impact."""
    return jnp.take_along_axis(jnp.broadcast_to(values, shape), cell[None], axis=0)[0]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def element_log_likelihood(
    element: Element,
    parameters: Float[Array, "parameter impact"],
    log_sigma: Float[Array, " impact"],
    record: ElementRecord,
    log_discrepancy: Float[Array, " impact"] | None = None,
    atanh_correlation: Float[Array, " impact"] | None = None,
) -> Float[Array, " impact"]:
    """Log density of the recorded traces, errors and discrepancy integrated out.

    Its slopes go forwards through the solver, one tangent a parameter and all impacts in each, so that
    reverse mode too costs no more than that.

    Args:
        element: what is hit.
        parameters: as of `response`.
        log_sigma: log of the noise's standard deviation [m/s^2]; of autoregressive noise, of its shocks'.
        record: the traces.
        log_discrepancy: log of the discrepancy's rms [m/s^2]; none unless given.
        atanh_correlation: artanh of the noise's correlation from sample to sample; white unless given, and
            not beside a discrepancy.
    """
    predicted = response(element, parameters, record)
    noise = _Noise(log_sigma, log_discrepancy, atanh_correlation)
    return _log_density(element, predicted, noise, record.d, record)


@element_log_likelihood.defjvp
def _element_jvp(element: Element, primals: Any, tangents: Any) -> tuple[Array, Array]:
    parameters, log_sigma, record, log_discrepancy, atanh_correlation = primals
    number = parameters.shape[0]
    basis = jnp.broadcast_to(jnp.eye(number)[..., None], (number, *parameters.shape))

    def along(tangent: Array) -> tuple[Response, Response]:
        return jax.jvp(lambda p: response(element, p, record), (parameters,), (tangent,))

    predicted, changes = jax.vmap(along, out_axes=(None, 0))(basis)
    value, pull_back = jax.vjp(
        lambda f, noise: _log_density(element, f, noise, record.d, record),
        predicted,
        _Noise(log_sigma, log_discrepancy, atanh_correlation),
    )
    by_response, by_noise = pull_back(jnp.ones_like(value))
    slopes = sum((change * by).sum(-1) for change, by in zip(changes, by_response, strict=True))
    along_noise = zip(by_noise, (tangents[1], tangents[3], tangents[4]), strict=True)
    return value, (slopes * tangents[0]).sum(0) + sum(by * to for by, to in along_noise if by is not None)


class MeasuredImpact(dist.Distribution):
    """Distribution of whole deceleration traces; one event an impact, its errors integrated out.

    Args:
        element: what is hit.
        parameters: as of `response`.
        log_sigma: log of the noise's standard deviation [m/s^2]; of autoregressive noise, of its shocks'.
        record: see `ElementRecord`.
        log_discrepancy: log of the discrepancy's rms [m/s^2]; none unless given.
        atanh_correlation: as of `element_log_likelihood`.
    """

    arg_constraints = {"log_sigma": constraints.real}  # noqa: RUF012
    support = constraints.real_vector
    pytree_data_fields = ("parameters", "log_sigma", "record", "log_discrepancy", "atanh_correlation")
    pytree_aux_fields = ("element",)

    def __init__(
        self,
        element: Element,
        parameters: Array,
        log_sigma: Array,
        record: ElementRecord,
        log_discrepancy: Array | None = None,
        atanh_correlation: Array | None = None,
        *,
        validate_args: bool | None = None,
    ) -> None:
        self.element, self.parameters, self.log_sigma, self.record = element, parameters, log_sigma, record
        self.log_discrepancy, self.atanh_correlation = log_discrepancy, atanh_correlation
        super().__init__(log_sigma.shape, record.d.shape[1:], validate_args=validate_args)

    def response(self) -> Response:
        """See `response`."""
        return response(self.element, self.parameters, self.record)

    def products(self, predicted: Response | None = None) -> Products:
        """Products of the residual and the errors' columns; ``found`` is `response`, if it is at hand."""
        predicted = self.response() if predicted is None else predicted
        return _products(self.element, predicted, self._noise(), self.record.d, self.record)

    def log_prob(self, value: Float[Array, "impact sample"]) -> Float[Array, " impact"]:
        """Log density of each impact's trace, its errors and its discrepancy integrated out."""
        if value is self.record.d:
            log_sigma, log_discrepancy, atanh_correlation = self._noise()
            return element_log_likelihood(
                self.element, self.parameters, log_sigma, self.record, log_discrepancy, atanh_correlation
            )
        return _log_density(self.element, self.response(), self._noise(), value, self.record)

    def draw_errors(self, key: Array, predicted: Response | None = None) -> Float[Array, "impact 4"]:
        """The chain's errors given the recorded traces: velocity, gain, offset, contact time (later).

        ``found`` is `response`, if it is at hand.
        """
        products, record = self.products(predicted), self.record
        error_sd = _error_sd(self._noise(), record)
        if record.before is None:
            return draw_errors(key, products, self.log_sigma, error_sd, record.uniform)
        density = marginal_log_likelihood(products, self.log_sigma, error_sd, record.uniform)
        cell = jax.random.categorical(jax.random.fold_in(key, 2), density, axis=0)
        chosen = partial(_of_cell, cell, density.shape)
        products = Products(*jax.tree.map(chosen, tuple(products)))
        errors = draw_errors(key, products, self.log_sigma, error_sd, record.uniform)
        return errors.at[:, CONTACT].add(record.first_time - chosen(contact_cells.middles(record)))

    def mean_first_time(self) -> Float[Array, " impact"]:
        """From contact to the first sample as the traces have it, by the mean over the cells [s]."""
        record = self.record
        if record.before is None:
            return record.first_time
        error_sd = _error_sd(self._noise(), record)
        density = marginal_log_likelihood(self.products(), self.log_sigma, error_sd, record.uniform)
        return (jax.nn.softmax(density, axis=0) * contact_cells.middles(record)).sum(0)

    def as_drawn(self, contact_error: Float[Array, " impact"]) -> MeasuredImpact:
        """The same with contact where such an error puts it, and known."""
        record, noise = self.record, self._noise()
        least = 0.0 if record.low_pass is None else -record.low_pass.lead * record.dt
        known = record.at_contact(jnp.maximum(record.first_time - contact_error, least))
        known = known._replace(error_sd=known.error_sd.at[:, CONTACT].set(0.0))
        return MeasuredImpact(self.element, self.parameters, noise.log_sigma, known, *noise[1:])

    def with_contact_found(self, key: Array) -> MeasuredImpact:
        """The same with contact known: where the trace has it, if the record leaves it to be found."""
        if self.record.before is None:
            return self
        return self.as_drawn(self.draw_errors(jax.random.fold_in(key, 3))[:, CONTACT])

    def draw_discrepancy(
        self, key: Array, errors: Float[Array, "impact 4"], predicted: Response | None = None
    ) -> Float[Array, "impact sample"]:
        """The discrepancy given the recorded traces and the chain's errors [m/s^2]; ``found`` as above."""
        record = self.record
        if self.log_discrepancy is None or record.basis is None or record.share is None:
            return jnp.zeros_like(record.d)
        predicted = self.response() if predicted is None else predicted
        left = self.residuals(errors, predicted)
        ratio = discrepancy.ratios(self.log_sigma, self.log_discrepancy, record.share)
        if record.colour is None or record.rate is None:
            return discrepancy.draw_given(key, left, record.basis, self.log_sigma, ratio)
        stride = record.colour.stride
        in_colour = [part[:, ::stride] for part in (left, *record.basis)]
        products_gram = coloured.products(
            record.colour, record.rate, record.inside()[:, ::stride], in_colour
        ).gram
        along, modes = jnp.stack(products_gram[0][1:]), [row[1:] for row in products_gram[1:]]
        return discrepancy.draw_along(key, along, record.basis, self.log_sigma, ratio, modes)

    def innovations(
        self, left: Float[Array, "impact sample"]
    ) -> tuple[Float[Array, "impact shock"], Int[Array, " impact"]]:
        """What is white of residuals [m/s^2], and how many of these there are of each impact.

        Of coloured noise at the samples that it is asked at.
        """
        record = self.record
        if self.atanh_correlation is not None:
            return autoregressive.whitened(left, self.atanh_correlation, record.inside()), record.n_samples
        if record.colour is None or record.rate is None:
            return left, record.n_samples
        stride = record.colour.stride
        inside = record.inside()[:, ::stride]
        left = coloured.innovations(record.colour, record.rate, left[:, ::stride])
        return jnp.where(inside, left, 0.0), inside.sum(-1)

    def residuals(
        self, errors: Float[Array, "impact 4"], predicted: Response | None = None
    ) -> Float[Array, "impact sample"]:
        """What these errors and the impact leave of the recorded traces [m/s^2]; contact is known."""
        predicted, record = self.response() if predicted is None else predicted, self.record
        return jnp.where(record.inside(), record.d - predicted.d - _added(errors, predicted, record), 0.0)

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw traces: the impact, its discrepancy, the chain's errors and noise.

        Where the recorded trace has to tell when contact was, contact is where it has it: the samples are
        counted from what it shows.
        """
        if self.record.before is not None:
            return self.with_contact_found(key).sample(key, sample_shape)
        key_of_noise, key_of_errors = jax.random.split(key)
        shape, record = (*sample_shape, *self.batch_shape), self.record
        predicted, delta = self.response(), jnp.zeros((*shape, *self.event_shape))
        if self.log_discrepancy is not None and record.basis is not None and record.share is not None:
            key_of_delta = jax.random.fold_in(key, 2)
            delta = discrepancy.draw_prior(
                key_of_delta, shape, record.basis, self.log_discrepancy, record.share
            )
        errors = prior_errors(key_of_errors, shape, _error_sd(self._noise(), record), record.uniform)
        noise = jax.random.normal(key_of_noise, (*shape, *self.event_shape))
        if record.colour is not None and record.rate is not None:
            noise = coloured.drawn(record.colour, record.rate, jax.random.fold_in(key, 4), noise)
        elif self.atanh_correlation is not None:
            noise = autoregressive.correlated(noise, self.atanh_correlation)
        added = _added(errors, predicted, record) + jnp.exp(self.log_sigma)[:, None] * noise
        return jnp.where(record.inside(), predicted.d + delta + added, 0.0)

    def replicate(self, key: Array) -> dict[str, Float[Array, "impact sample"]]:
        """A replicate of every trace, the deceleration [m/s^2] with its discrepancy; NaN past its end."""
        known = self.with_contact_found(key)
        return {"deceleration": jnp.where(known.record.inside(), known.sample(key), jnp.nan)}

    def _noise(self) -> _Noise:
        return _Noise(self.log_sigma, self.log_discrepancy, self.atanh_correlation)


def _added(
    errors: Float[Array, "*batch impact 4"], predicted: Response, record: ElementRecord
) -> Float[Array, "*batch impact sample"]:
    """What the chain's errors add to the traces."""
    numbered = enumerate(columns(predicted, record))
    return jnp.asarray(sum(errors[..., i, None] * column for i, column in numbered))
