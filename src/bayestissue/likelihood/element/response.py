"""What is recorded of an impact on any mechanical element, and the element's own answer at the samples."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.elements import Element, linear, solver
from bayestissue.elements.element import GRAVITY, deceleration_of, rates_of_motion
from bayestissue.likelihood.element.recorder import PIECES, Colour, Flow, LowPass, low_passed, samples_passed

# Columns of the measuring chain's errors.
VELOCITY, GAIN, OFFSET, CONTACT = range(4)


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
        basis: modes of a discrepancy, and ``share``, their part in it: see `discrepancy.modes`; None where
            the element's law is taken as the tissue's.
        quiet: where the offset was found as the mean of a quiet part, and its standard deviation is that
            under white noise; None where this does not matter.
        before: the samples before the first, in order of time, by the cell of contact's moment they are in; 0
            where there are none [m/s^2]. None where contact is known but for its error, uniform or not. Where
            it is not it may be in any of these cells: see `bayestissue.likelihood.element.contact_cells`.
        n_before: how many of these samples were recorded and count.
        quiet_sd: standard deviation of the recorder's noise, as a quiet part has it [m/s^2].
        common_depth: one depth that every impact reaches [m]; no part of the likelihood. None where stiffness
            does not depend on depth.
        low_pass: a filter that the traces went through; None where there is none.
        colour: the noise, where a part of it went through that filter too; else None.
        rate: of coloured noise, which of its sampling rates each impact has.
        gravity: g, along the motion [m/s^2]: decelerations are force over mass then. None without.
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
    basis: Float[Array, "mode impact sample"] | None = None
    share: Float[Array, "impact mode"] | None = None
    quiet: Bool[Array, " impact"] | None = None
    before: Float[Array, "reach impact width"] | None = None
    n_before: Int[Array, " impact"] | None = None
    quiet_sd: Float[Array, " impact"] | None = None
    common_depth: Float[Array, " impact"] | None = None
    low_pass: LowPass | None = None
    colour: Colour | None = None
    rate: Int[Array, " impact"] | None = None
    gravity: Float[Array, " impact"] | None = None

    @classmethod
    def from_arrays(cls, *arrays: np.ndarray, **named: Any) -> ElementRecord:
        """From numpy arrays in the order of the attributes, or named; values past a row's end are cleared.

        Without the modes there is no discrepancy.
        """
        named_values = {name: jax.tree.map(jnp.asarray, part) for name, part in named.items()}
        values: Any = [jnp.asarray(array) for array in arrays]
        record = cls(*values, **named_values)
        return record._replace(d=jnp.where(record.inside(), record.d, 0.0))

    @property
    def traces(self) -> Float[Array, "impact sample"]:
        """The recorded decelerations."""
        return self.d

    @property
    def errors(self) -> dict[str, str]:
        """What each column of ``error_sd`` is called in the posterior, and which link of the chain errs."""
        return {
            "velocity_error": "velocity",
            "gain_error": "gain",
            "offset_error": "offset",
            "contact_time_error": "contact moment",
        }

    def with_traces(
        self, traces: Float[np.ndarray, "impact sample"], n_samples: Int[np.ndarray, " impact"]
    ) -> ElementRecord:
        """The record of other traces, or of fewer of their samples."""
        record = self._replace(n_samples=jnp.asarray(n_samples))
        return record._replace(d=jnp.where(record.inside(), jnp.asarray(traces), 0.0))

    def with_normal_errors(self) -> ElementRecord:
        """The same, every error of the measuring chain taken as normal with its standard deviation.

        Over all cells of contact the likelihood is smooth as it is.
        """
        return self if self.before is not None else self._replace(uniform=jnp.zeros_like(self.uniform))

    def at_contact(self, first_time: Float[Array, " impact"]) -> ElementRecord:
        """The same traces with contact so long before the first sample [s], its error about that."""
        return self._replace(first_time=first_time, before=None, n_before=None, quiet_sd=None)

    def inside(self) -> Bool[Array, "impact sample"]:
        """True where there is a sample."""
        return jnp.arange(self.d.shape[1]) < self.n_samples[:, None]

    def time(self) -> Float[Array, "impact sample"]:
        """Time since contact, also past a row's end [s]."""
        return self.first_time[:, None] + jnp.arange(self.d.shape[1]) * self.dt[:, None]


class Response(NamedTuple):
    """An impact as recorded without errors, and how errors change it; all 0 past a trace's end.

    Where contact may be in any of several cells it is instead on a grid of the sampling interval that begins
    half an interval after contact; its end is no trace's. Behind a low-pass that grid is as many times finer
    as the filter tells moments of contact within an interval apart, and begins as long before contact as the
    filter looks ahead.

    Attributes:
        d: deceleration [m/s^2].
        by_velocity: its derivative by the velocity at contact [1/s].
        jerk: its derivative in time [m/s^3].
    """

    d: Float[Array, "impact sample"]
    by_velocity: Float[Array, "impact sample"]
    jerk: Float[Array, "impact sample"]


class Motion(NamedTuple):
    """The element's own motion at the samples, also past a row's end.

    Attributes:
        x: penetration [m].
        v: its velocity [m/s].
        d: deceleration, that is force over mass [m/s^2].
    """

    x: Float[Array, "impact sample"]
    v: Float[Array, "impact sample"]
    d: Float[Array, "impact sample"]


def motion(
    element: Element,
    parameters: Float[Array, "parameter impact"],
    record: ElementRecord,
    velocity: Float[Array, " impact"],
) -> Motion:
    """The impact at ``velocity`` [m/s], contact as the record has it; other arguments as of `response`."""
    record = record.at_contact(record.first_time)
    late = None
    if record.low_pass is not None and record.low_pass.lead:
        first, late = _after_contact(record)
        record = record._replace(first_time=first)
    p = {name: value[:, None] for name, value in _named(element, parameters, record).items()}
    y = _states(element, parameters, velocity, record)
    after_contact = Motion(y[0], y[1], deceleration_of(element, p, record.mass[:, None], y))
    if late is None:
        return after_contact
    # In flight until contact.
    index = jnp.arange(record.d.shape[1]) - late[:, None]
    x, v, d = (jnp.take_along_axis(part, jnp.maximum(index, 0), axis=1) for part in after_contact)
    since = jnp.minimum(record.first_time[:, None] + index * record.dt[:, None], 0.0)
    flies, speed = index < 0, velocity[:, None]
    fall = 0.0 if record.gravity is None else record.gravity[:, None]
    here = speed * since + fall * since**2 / 2
    return Motion(
        jnp.where(flies, here, x), jnp.where(flies, speed + fall * since, v), jnp.where(flies, 0.0, d)
    )


def response(
    element: Element, parameters: Float[Array, "parameter impact"], record: ElementRecord
) -> Response:
    """The element's answer at the samples.

    Args:
        element: what is hit.
        parameters: its parameters in their order.
        record: masses, velocities and times.
    """
    p = {name: value[:, None] for name, value in _named(element, parameters, record).items()}
    mass, inside = record.mass[:, None], record.inside() if record.before is None else True

    def d_and_jerk(velocity: Array) -> tuple[Array, Array]:
        if record.low_pass is not None:
            return _recorded(element, parameters, velocity, record, record.low_pass)
        y = _states(element, parameters, velocity, record)
        flow = rates_of_motion(element, p, mass, y)
        return jax.jvp(lambda y: deceleration_of(element, p, mass, y), (y,), (flow,))

    if in_proportion(element, record):
        d, jerk = d_and_jerk(record.velocity)
        by_velocity = d / record.velocity[:, None]
    else:
        (d, jerk), (by_velocity, _) = jax.jvp(
            d_and_jerk, (record.velocity,), (jnp.ones_like(record.velocity),)
        )
    return Response(*(jnp.where(inside, part, 0.0) for part in (d, by_velocity, jerk)))


def in_proportion(element: Element, record: ElementRecord) -> bool:
    """Whether the deceleration is in proportion to the velocity at contact."""
    return element.linear and record.gravity is None


def beside_parameters(record: ElementRecord) -> dict[str, Array]:
    """What an element's functions take beside its parameters, by name."""
    along = {} if record.gravity is None else {GRAVITY: record.gravity}
    return {"diameter_m": record.diameter, **along}


def _named(element: Element, parameters: Array, record: ElementRecord) -> dict[str, Array]:
    names = [parameter.name for parameter in element.parameters]
    return dict(zip(names, parameters, strict=True)) | beside_parameters(record)


def _states(element: Element, parameters: Array, velocity: Array, record: ElementRecord) -> Array:
    grid = linear.even_grid if element.linear else solver.even_grid
    p, first_time, count = _named(element, parameters, record), record.first_time, record.d.shape[1]
    if record.before is not None:
        cells, _, width = record.before.shape
        first_time, count = record.dt / 2, count + cells * width
    return grid(element, p, record.mass, velocity, first_time, record.dt, count)


def _after_contact(record: ElementRecord) -> tuple[Array, Array]:
    """From contact to the first sample after it [s], and how many of the trace's samples are before."""
    late = jnp.maximum(jnp.ceil(-record.first_time / record.dt), 0.0)
    return record.first_time + late * record.dt, late.astype(int)


def _recorded(
    element: Element, parameters: Array, velocity: Array, record: ElementRecord, low_pass: LowPass
) -> tuple[Array, Array]:
    """Deceleration and its slope behind a recorder's low-pass, on the grid of `Response`."""
    grid = linear.even_grid if element.linear else solver.even_grid
    named = _named(element, parameters, record)
    p, mass = {name: value[:, None] for name, value in named.items()}, record.mass[:, None]

    def flow(first: Array, dt: Array, count: int) -> Flow:
        y = grid(element, named, record.mass, velocity, first, dt, count)
        rates = rates_of_motion(element, p, mass, y)
        d, jerk = jax.jvp(lambda y: deceleration_of(element, p, mass, y), (y,), (rates,))
        return Flow(d, jerk, dt)

    finer = low_pass.phase.shape[0]
    step, ahead, count = record.dt / finer, low_pass.lead * finer, record.d.shape[1] * finer
    if record.before is None:
        first, late = _after_contact(record)
    else:
        # As long before contact as behind the end.
        first, count = step / 2, count + finer * record.before.shape[0] - ahead
    later = flow(first, step, count + ahead).while_pushing()
    if low_pass.corner is None:
        early = flow(jnp.zeros_like(first), first / PIECES, PIECES + 1)
        since = first[:, None] + (jnp.arange(ahead) - ahead) * step[:, None] if ahead else None
        passed = low_passed(low_pass, early, later, since)
    else:
        passed = samples_passed(low_pass, low_pass.corner, later, ahead)
    d, slope = (part[:, : ahead + count] for part in passed)
    if record.before is not None:
        return d, slope
    if ahead:
        index = jnp.arange(count) + ahead - finer * late[:, None]
        d, slope = (jnp.take_along_axis(part, jnp.maximum(index, 0), axis=1) for part in (d, slope))
    return d[:, ::finer], slope[:, ::finer]


def columns(response: Response, record: ElementRecord) -> tuple[Array, Array, Array, Array]:
    """What a unit of each error adds: of velocity, gain, offset and contact time, each [impact, sample]."""
    return response.by_velocity, response.d, jnp.where(record.inside(), 1.0, 0.0), -response.jerk
