"""Recorded decelerations of an impact on any mechanical element, with noise and a measuring chain.

(1 + gain) d(t - tau; V + dV) + b, to first order in the errors, d being F / M of the element: the columns of
the errors are d's derivative by V, d itself, 1 and minus its derivative in time. An element that is not
linear tells gain from velocity, since its deceleration is not in proportion to V, and so does gravity along
the motion, which does not come with V. What the samples share besides is noise: see
`bayestissue.model.likelihood.noise`. When contact was may be for the trace to tell: see
`bayestissue.model.likelihood.contact_cells`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.special import log_ndtr
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerSample
from bayestissue.mechanics.elements import Element
from bayestissue.mechanics.elements.element import Collision
from bayestissue.model.likelihood import contact_cells, noise, small
from bayestissue.model.likelihood.channels import MeasuredTraces, SensorTrace
from bayestissue.model.likelihood.linear_errors import (
    Errors,
    Products,
    draw_errors,
    marginal_log_likelihood,
    predicted_given,
)
from bayestissue.model.likelihood.noise import TraceNoise
from bayestissue.model.likelihood.record import CONTACT, DecelerationRecord
from bayestissue.model.likelihood.response import Response, collision_of, response

# A response this many times the trace is no impact; the products would keep seven digits.
_GREATEST = 1e4


class NoiseParameters(NamedTuple):
    """What the noise of each impact has for parameters.

    Attributes:
        log_sigma: log of the standard deviation [m/s^2].
        log_discrepancy: log of the discrepancy's rms [m/s^2]; None without one.
        log_force_sigma: of the noise of a force over mass [m/s^2]; None without one.
        log_force_ratio: log of that force over recorded mass times deceleration; None without one.
        log_gain: log of recorded over true deceleration; None where its error is among those of the chain.
    """

    log_sigma: JaxPerImpact
    log_discrepancy: JaxPerImpact | None = None
    log_force_sigma: JaxPerImpact | None = None
    log_force_ratio: JaxPerImpact | None = None
    log_gain: JaxPerImpact | None = None


class Cells(NamedTuple):
    """A trace for contact in each cell.

    Attributes:
        products: of residual and error columns, over all channels.
        errors: known beforehand, that of contact within each cell.
        log_density: of the trace, the errors integrated out.
    """

    products: Products
    errors: Errors
    log_density: Float[Array, "cell impact"]


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["parameters", "noise_parameters", "record"],
    meta_fields=["element"],
)
@dataclass(frozen=True)
class MeasuredImpact(MeasuredTraces):
    """The likelihood of deceleration traces, the errors of their measuring chain integrated out.

    Attributes:
        element: what is hit.
        parameters: its own, in their order.
        noise_parameters: of the noise.
        record: the traces and what is known of their recording.
    """

    element: Element
    parameters: Float[Array, "parameter impact"]
    noise_parameters: NoiseParameters
    record: DecelerationRecord

    @property
    def collision(self) -> Collision:
        """The impacts, at recorded mass and velocity."""
        return collision_of(self.element, self.parameters, self.record)

    @property
    def sigma(self) -> JaxPerImpact:
        """The noise's standard deviation [m/s^2]."""
        return jnp.exp(self.noise_parameters.log_sigma)

    def response(self) -> Response:
        """See `response`; as the sensor shows it, whose gain is in error."""
        true, gain = response(self.collision, self.record), self.noise_parameters.log_gain
        return true if gain is None else true.recorded(jnp.exp(gain))

    @property
    def errors(self) -> Errors:
        """The weights of the discrepancy's modes, and the measuring chain's errors; contact is known."""
        errors = self._errors_by_cell()
        return errors._replace(sd=errors.sd[0])

    def _errors_by_cell(self) -> Errors:
        share, rms = self.record.discrepancy.share, self.noise_parameters.log_discrepancy
        modes = jnp.zeros_like(share) if rms is None else jnp.exp(rms)[:, None] * jnp.sqrt(share)
        chain = contact_cells.error_sd(self.record)
        sd = jnp.concatenate([jnp.broadcast_to(modes, (len(chain), *modes.shape)), chain], axis=-1)
        return Errors(sd, self.record.contact.uniform)

    def channels(self, predicted: Response | None = None) -> list[SensorTrace[TraceNoise]]:
        """The deceleration and, where one was recorded, the force beside it, for contact in each cell.

        ``predicted`` is `response`, if it is at hand.
        """
        predicted = self.response() if predicted is None else predicted
        deceleration = contact_cells.channel_of(predicted, self.record, self.noise_parameters.log_sigma)
        return [deceleration, *self._of_force(predicted)]

    def _of_force(self, predicted: Response) -> list[SensorTrace[TraceNoise]]:
        force, parameters = self.record.force, self.noise_parameters
        ratio, log_sigma = parameters.log_force_ratio, parameters.log_force_sigma
        if force is None or predicted.force is None or ratio is None or log_sigma is None:
            return []
        return [contact_cells.force_channel(predicted.force, force, ratio, log_sigma)]

    def products(self, predicted: Response | None = None) -> Products:
        """Of residuals and error columns, over all channels; ``predicted`` as of `channels`."""
        predicted = self.response() if predicted is None else predicted
        products = contact_cells.products_in_cells(predicted, self.record, self.noise_parameters.log_sigma)
        for channel in self._of_force(predicted):
            products = products.beside(noise.products(channel))
        return products

    def cells(self, predicted: Response) -> Cells:
        """The traces for contact in each cell; of a known contact one."""
        record, products, errors = self.record, self.products(predicted), self._errors_by_cell()
        density = marginal_log_likelihood(products, errors)
        if record.clipped is not None:
            deceleration = self.channels(predicted)[0]
            density = density + _log_probability_of_clipped(deceleration, record, products, errors)
        if record.contact.reach:
            density = density + jnp.log(contact_cells.cell_width(record))
        return Cells(products, errors, density)

    def log_density(self) -> JaxPerImpact:
        """Log density of each recorded trace, its errors and its discrepancy integrated out."""
        record = self.record
        predicted = self.response()
        density = jax.nn.logsumexp(self.cells(predicted).log_density, axis=0)
        if record.contact.reach:
            density = density - record.contact.quiet_log_density
        # Parameters far from anything seen may send a response beyond all bounds, where the products' digits
        # are lost and a density would be anything.
        greatest = _GREATEST * jnp.abs(record.d).max(-1)
        density = jnp.where(jnp.abs(predicted.d).max(-1) <= greatest, density, -jnp.inf)
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
        return (1 - 1 / record.shared_by) * jnp.log(self.collision.impactor_share)

    def draw_errors(self, key: Array, predicted: Response | None = None) -> Float[Array, "impact error"]:
        """The errors given the recorded traces, contact time's counted from ``first_time`` (later).

        ``predicted`` as of `channels`.
        """
        record, cells = self.record, self.cells(self.response() if predicted is None else predicted)
        shape = cells.log_density.shape
        cell = jax.random.categorical(jax.random.fold_in(key, 2), cells.log_density, axis=0)

        def chosen(values: Array) -> Array:
            """Of the last axes but one."""
            values = jnp.broadcast_to(values, (*values.shape[:-2], *shape))
            index = jnp.broadcast_to(cell, (*values.shape[:-2], 1, len(cell)))
            return jnp.take_along_axis(values, index, -2)[..., 0, :]

        products = cells.products._replace(gram=chosen(small.stacked(cells.products.gram)))
        known = cells.errors._replace(sd=chosen(jnp.moveaxis(cells.errors.sd, -1, 0)).T)
        errors = draw_errors(key, products, known)
        return errors.at[:, CONTACT].add(record.first_time - chosen(record.cells))

    def mean_first_time(self) -> JaxPerImpact:
        """From contact to the first sample as the traces have it, by the mean over the cells [s]."""
        if not self.record.contact.reach:
            return self.record.first_time
        share = jax.nn.softmax(self.cells(self.response()).log_density, axis=0)
        return (share * self.record.cells).sum(0)

    def as_drawn(self, contact_error: JaxPerImpact) -> MeasuredImpact:
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

    def discrepancy(
        self, errors: Float[Array, "*batch impact error"]
    ) -> Float[Array, "*batch impact sample"]:
        """The discrepancy that is among such errors [m/s^2]."""
        basis = self.record.discrepancy.basis
        return jnp.einsum("...im,imr->...ir", errors[..., : basis.shape[1]], basis)

    def residuals(self, errors: Float[Array, "impact error"]) -> JaxPerSample:
        """What these errors and the impact leave of the recorded traces [m/s^2]; contact is known."""
        return jnp.where(self.record.inside(), self.channels()[0].left(errors), 0.0)

    def noise_quantities(self) -> dict[str, JaxPerImpact]:
        """What the noise of each trace is, by the names that posteriors have."""
        return {"sigma_d": self.sigma}

    def replicate(self, key: Array) -> dict[str, JaxPerSample]:
        """A replicate of every trace, the deceleration [m/s^2] with its discrepancy; NaN past its end.

        Of a force beside it one too [N]. Of a clipped trace the sensor's limit cuts it too. Where the
        recorded trace has to tell when contact was, contact is where it has it: the samples are counted from
        what it shows.
        """
        if self.record.contact.reach:
            return self.with_contact_found(key).replicate(key)
        (of_noise, of_errors), record, force = jax.random.split(key), self.record, self.record.force
        errors, channels = self.prior_errors(of_errors), self.channels()
        of_noise = of_noise if record.colour.is_white else jax.random.fold_in(key, 4)
        shocks = noise.drawn(record.colour, record.rate, of_noise, record.d.shape)
        d = record.within_limits(channels[0].replicate(record.d, errors, shocks))
        traces = {"deceleration": jnp.where(record.inside(), d, jnp.nan)}
        if force is not None:
            shocks = noise.drawn(force.colour, force.rate, jax.random.fold_in(key, 5), force.y.shape)
            of_mass = record.mass[:, None] * channels[1].replicate(force.y, errors, shocks)
            traces["force"] = jnp.where(force.inside(), of_mass, jnp.nan)
        return traces


def _log_probability_of_clipped(
    channel: SensorTrace[TraceNoise], record: DecelerationRecord, products: Products, errors: Errors
) -> Float[Array, "cell impact"]:
    """Log P of the samples at the sensor's limit, for contact in each cell: it was there or beyond.

    With y the samples that are not clipped and c those that are, p(y, c) = p(y) P(every c beyond its limit |
    y). p(y) has the errors of the measuring chain integrated out as without clipped samples. Given y and the
    noise's sigma a clipped sample is m_i + b_i' z plus noise, z being standard normals that stand for what y
    leaves open of the errors: see `bayestissue.model.likelihood.linear_errors.predicted_given`. So

        P = int N(z; 0, 1) prod_i Phi(s_i (m_i + b_i' z - L) / sigma) dz,

    s_i = 1 at an upper limit L and -1 at a lower one. The integrand is log concave in z and nearly constant,
    y having far more samples than there are errors: by Laplace's method from z = 0,

        log P = sum_i log Phi(a_i) + g' H^-1 g / 2 - log det H / 2,   a_i = s_i (m_i - L) / sigma,
        g = sum_i s_i h_i b_i / sigma,   H = 1 + sum_i h_i (h_i + a_i) b_i b_i' / sigma^2,
        h_i = phi(a_i) / Phi(a_i).

    That is exact far from the limit on either side. A discrepancy's modes are errors like the others. An
    error of the contact time that is uniform is not cut off at its bounds here: near the peak hardly anything
    depends on it. Noise that is not white would have samples beside a plateau say what is in it, and so would
    a recorder's filter: these are not for clipped samples.

    Args:
        channel: of the deceleration.
        record: the traces, some samples of which are clipped.
        products: of all samples that are not.
        errors: of the chain, and the discrepancy's.
    """
    assert record.clipped is not None  # noqa: S101 - for the type checker
    reach, log_sigma = record.contact.reach, channel.log_sigma
    further = jnp.transpose(channel.columns[..., reach:], (2, 3, 1, 0))
    mean, along = predicted_given(products, errors, further)
    # The residual is the limit less the impact.
    above = mean - jnp.transpose(channel.residual[..., reach:], (2, 1, 0))
    sign = jnp.where(record.inside(), record.clipped, 0.0).T[:, None]
    at_limit, scaled = sign != 0, sign * jnp.exp(-log_sigma)
    a = jnp.where(at_limit, scaled * above, 0.0)
    log_phi = jnp.where(at_limit, log_ndtr(a), 0.0)
    h = jnp.where(at_limit, jnp.exp(-(a**2 + small.LOG_2PI) / 2 - log_phi), 0.0)
    b = [scaled * part for part in along]
    slope = [(h * part).sum(0) for part in b]
    bend = h * (h + a)
    curvature = [
        [(bend * first * second).sum(0) + (1.0 if i == j else 0.0) for j, second in enumerate(b)]
        for i, first in enumerate(b)
    ]
    factor = small.cholesky(curvature)
    half = small.solve_lower(factor, slope)
    return log_phi.sum(0) + small.dot(half, half) / 2 - small.log_diagonal(factor)
