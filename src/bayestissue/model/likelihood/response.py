"""An element's answer to an impact at a record's samples, and how errors of the chain change it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerSample
from bayestissue.mechanics.elements import Element, linear, solver
from bayestissue.mechanics.elements.element import GRAVITY, Collision
from bayestissue.model.likelihood.record import Contact, DecelerationRecord, ForceRows
from bayestissue.model.likelihood.recorder import (
    EARLIER,
    PIECES,
    Flow,
    LowPass,
    low_passed,
    samples_passed,
)

# What a sensor reads of impacts in such states, over the impactor's mass [m/s^2].
Reading = Callable[[Collision, Array], Array]


class Response(NamedTuple):
    """An impact as recorded without errors, and how errors change it; all 0 past a trace's end.

    Where contact may be in any of several cells it is instead on a grid of the sampling interval that begins
    half an interval after contact, or where contact is at a sample with the first one. Its end is no trace's.
    Of uneven times it is then at all samples, those before the first among them, for contact in the middle of
    the first cell, of the second and so on. Behind a low-pass that grid is as many times finer as the filter
    tells moments of contact within an interval apart, and begins as long before contact as the filter looks
    ahead.

    Attributes:
        d: deceleration, or another sensor's reading over the mass [m/s^2].
        by_velocity: its derivative by the velocity at contact [1/s].
        jerk: its derivative in time [m/s^3].
        force: the same at the samples of a force, where one was recorded: where contact may be in any of
            several cells, [impact, cell, sample], for contact in the middle of each.
    """

    d: Float[Array, "impact *cell sample"]
    by_velocity: Float[Array, "impact *cell sample"]
    jerk: Float[Array, "impact *cell sample"]
    force: Response | None = None

    def recorded(self, gain: JaxPerImpact) -> Response:
        """The deceleration so many times the true one; a force has a gain of its own."""
        d, by_velocity, jerk = (gain.reshape(-1, *[1] * (part.ndim - 1)) * part for part in self[:3])
        return Response(d, by_velocity, jerk, self.force)


def collision_of(
    element: Element, parameters: Float[Array, "parameter impact"], record: DecelerationRecord
) -> Collision:
    """The recorded impacts on an element with these parameters, in their order."""
    names = (parameter.name for parameter in element.parameters)
    p = dict(zip(names, parameters, strict=True)) | record.surroundings
    return Collision(element, p, record.mass, record.velocity)


def motion(collision: Collision, record: DecelerationRecord) -> tuple[JaxPerSample, ...]:
    """The element's own motion at the record's samples, also past a row's end; contact as the record has it.

    Returns:
        x, the penetration [m], its velocity [m/s], and the deceleration, that is force over mass [m/s^2].
    """
    first, late = _after_contact(record) if record.lead else (record.first_time, jnp.zeros(()))
    sensor = _Sensor(collision, record)
    if record.uneven is not None:
        return sensor.at_times(record.time())[:3]
    x, v, d, _ = sensor.on_grid(first, record.dt, record.d.shape[1])
    if not record.lead:
        return x, v, d
    # In flight until contact.
    index = jnp.arange(record.d.shape[1]) - late[:, None]
    x, v, d = (jnp.take_along_axis(part, jnp.maximum(index, 0), axis=1) for part in (x, v, d))
    since = jnp.minimum(first[:, None] + index * record.dt[:, None], 0.0)
    flies, speed, fall = index < 0, collision.velocity[:, None], record.gravity[:, None]
    here = speed * since + fall * since**2 / 2
    v = jnp.where(flies, speed + fall * since, v)
    return jnp.where(flies, here, x), v, jnp.where(flies, 0.0, d)


@jax.custom_jvp
def response(collision: Collision, record: DecelerationRecord) -> Response:
    """The element's answer at the samples.

    Its slopes, by the element's parameters and by the time from contact to the first sample, go forwards
    through the solver, one tangent for each and all impacts in each, so that reverse mode too costs no more
    than that.

    Args:
        collision: the impacts, of the record's masses, velocities and surroundings.
        record: times of the samples.
    """
    return _response(collision, record)


@response.defjvp
def _response_jvp(primals: Any, tangents: Any) -> tuple[Response, Response]:
    (collision, record), names = primals, [one.name for one in primals[0].element.parameters]

    def at(moved: Array) -> Response:
        p = collision.parameters | dict(zip(names, moved, strict=False))
        return _response(replace(collision, parameters=p), record.with_first_time(moved[-1]))

    moved, along = (
        jnp.stack([*(met.parameters[name] for name in names), times.first_time])
        for met, times in (primals, tangents)
    )
    unit = jnp.broadcast_to(jnp.eye(len(moved))[..., None], (len(moved), *moved.shape))
    answer, slopes = jax.vmap(lambda one: jax.jvp(at, (moved,), (one,)), out_axes=(None, 0))(unit)
    change: Response = jax.tree.map(lambda slope: jnp.einsum("pi...,pi->i...", slope, along), slopes)
    return answer, change


def _response(
    collision: Collision, record: DecelerationRecord, reading: Reading = Collision.deceleration
) -> Response:
    inside = True if record.contact.reach else record.inside()
    force = None if record.force is None else _of_force(collision, record, record.force)
    answered = _by_velocity(collision, lambda met: _Sensor(met, record, reading).at_samples())
    d, by_velocity, jerk = (jnp.where(inside, part, 0.0) for part in answered)
    return Response(d, by_velocity, jerk, force)


class _Sensor(NamedTuple):
    """What a sensor reads of impacts, over the impactor's mass.

    Attributes:
        collision: the impacts.
        record: when its samples are, and its recorder.
        reading: what it reads.
    """

    collision: Collision
    record: DecelerationRecord
    reading: Reading = Collision.deceleration

    def at_samples(self) -> tuple[Array, Array]:
        """A reading and its slope at the samples."""
        record = self.record
        if record.low_pass is not None:
            return self._behind(record.low_pass)
        if record.uneven is not None:
            time = record.uneven.since_contact() if record.contact.reach else record.time()
            return self.at_times(time)[2:]
        first = record.phase[0] * record.dt if record.contact.reach else record.first_time
        return self.on_grid(first, record.dt, record.d.shape[1] + record.contact.reach)[2:]

    def on_grid(self, first: Array, dt: Array, count: int) -> tuple[Array, Array, Array, Array]:
        """Penetration, velocity, reading and its slope at first + k dt after contact, k = 0 ... count - 1."""
        return self._of_states(self._states(first, dt, count))

    def _states(self, first: Array, dt: Array, count: int) -> Float[Array, "state impact sample"]:
        grid = linear.even_grid if self.collision.element.linear else solver.even_grid
        return grid(self.collision, first, dt, count)

    def _of_states(self, y: Float[Array, "state impact time"]) -> tuple[Array, Array, Array, Array]:
        """Penetration, velocity, reading and its slope in these states; a deceleration's is the jerk."""
        columns = self.collision.columns()

        d, jerk = jax.jvp(partial(self.reading, columns), (y,), (columns.rates(y),))
        return y[0], y[1], d, jerk

    def at_times(self, time: Float[Array, "impact time"]) -> tuple[Array, Array, Array, Array]:
        """The same at any times since contact; no force before it.

        By the cubic through states and rates of an even grid from contact on, of about half the mean sampling
        interval, h: its error is (omega_n h)^4 / 384 of the motion.
        """
        record = self.record
        width = record.d.shape[1] + record.contact.reach
        count = 2 * width
        rows = time.reshape(len(time), -1, width)[..., record.contact.reach :]
        last = jnp.where(record.inside()[:, None], rows, 0.0).max((1, 2))
        dt = jnp.maximum(last, record.dt) / (count - 1)
        begin = self.collision.at_contact()[..., None]
        y = jnp.concatenate([begin, self._states(dt, dt, count - 1)], axis=-1)
        steps = jnp.clip(time / dt[:, None], 0.0, count - 1.0)
        y = solver.between_steps(y, self.collision.columns().rates(y), steps[None], dt[:, None])
        x, v, d, jerk = self._of_states(y)
        flies = time < 0
        return x, v, jnp.where(flies, 0.0, d), jnp.where(flies, 0.0, jerk)

    def _behind(self, low_pass: LowPass) -> tuple[Array, Array]:
        """A reading and its slope behind a recorder's low-pass, on the grid of `Response`."""
        record = self.record

        def flow(first: Array, dt: Array, count: int) -> Flow:
            return Flow(*self.on_grid(first, dt, count)[2:], dt)

        finer, reach = low_pass.phase.shape[0], record.contact.reach
        step, ahead, count = record.dt / finer, low_pass.lead * finer, record.d.shape[1] * finer
        first, late = _after_contact(record)
        more, begin = 0, ahead - finer * late
        if reach:
            # As long before contact as behind the end.
            first, count = step / 2, count + finer * reach - ahead
        elif low_pass.corner is not None:
            # Of all samples since contact, which the first of the record need not be.
            more = EARLIER
            earlier = jnp.clip(jnp.floor(first / step), 0, more)
            first, begin = first - earlier * step, begin + earlier.astype(int)
        later = flow(first, step, count + ahead + more).while_pushing()
        if low_pass.corner is None:
            early = flow(jnp.zeros_like(first), first / PIECES, PIECES + 1)
            since = first[:, None] + (jnp.arange(ahead) - ahead) * step[:, None] if ahead else None
            passed = low_passed(low_pass, early, later, since)
        else:
            passed = samples_passed(low_pass, low_pass.corner, later, ahead)
        d, slope = (part[:, : ahead + more + count] for part in passed)
        if reach:
            return d, slope
        if ahead or more:
            index = jnp.arange(count) + begin[:, None]
            d, slope = (jnp.take_along_axis(part, jnp.maximum(index, 0), axis=1) for part in (d, slope))
        return d[:, ::finer], slope[:, ::finer]


def _by_velocity(
    collision: Collision, answer: Callable[[Collision], tuple[Array, Array]]
) -> tuple[Array, Array, Array]:
    """A reading, its derivative by the velocity at contact, and its slope, of what gives first and last."""
    velocity = collision.velocity
    if collision.element.linear and GRAVITY not in collision.parameters:
        # In proportion to the velocity at contact.
        d, jerk = answer(collision)
        return d, d / velocity.reshape(-1, *[1] * (d.ndim - 1)), jerk

    def at(velocity: Array) -> tuple[Array, Array]:
        return answer(replace(collision, velocity=velocity))

    (d, jerk), (by_velocity, _) = jax.jvp(at, (velocity,), (jnp.ones_like(velocity),))
    return d, by_velocity, jerk


def _of_force(collision: Collision, record: DecelerationRecord, force: ForceRows) -> Response:
    """The answer at the samples of the force.

    Where it has to be in one go for contact in several cells, it is made on one even grid of the force's
    interval that begins after contact in the last cell. From cell to cell the samples lie later on it by a
    time that all of them share: the cubic through deceleration and jerk of the grid's points is there, with
    an error of (omega_n h)^4 / 384 of the motion.
    """
    reading = Collision.tissue_force_over_mass if force.below else Collision.deceleration
    if not record.contact.reach:
        return _response(collision, at_force(record, force), reading)
    since = (force.first_time - record.first_time + record.cells).T
    begin = since.min(1) % force.dt
    later = (since - begin[:, None]) / force.dt[:, None]
    whole = jnp.maximum(jnp.floor(later), 0.0)
    index = whole.astype(int)[..., None] + jnp.arange(force.y.shape[1])
    known = Contact.known(jnp.zeros(len(begin), bool))
    grid = at_force(record, force)._replace(first_time=begin, contact=known)

    def shifted(met: Collision) -> tuple[Array, Array]:
        d, jerk = _Sensor(met, grid, reading).at_samples()
        into, interval = (later - whole)[..., None], force.dt[:, None, None]

        def at(values: Array, index: Array) -> Array:
            flat = jnp.minimum(index, values.shape[1] - 1).reshape(len(values), -1)
            return jnp.take_along_axis(values, flat, axis=1).reshape(index.shape)

        ends = (at(d, index), at(d, index + 1)), (at(jerk, index), at(jerk, index + 1))
        return solver.cubic(*ends, into, interval), solver.cubic_slope(*ends, into, interval)

    inside = jnp.expand_dims(force.inside(), 1)
    parts: Any = (jnp.where(inside, part, 0.0) for part in _by_velocity(collision, shifted))
    return Response(*parts)


def at_force(record: DecelerationRecord, force: ForceRows) -> DecelerationRecord:
    """The record as if its samples and its recorder were those of the force, contact being known."""
    low_pass = force.low_pass and force.low_pass._replace(phase=force.low_pass.phase[:1])
    times: Any = {"first_time": force.first_time, "dt": force.dt, "n_samples": force.n_samples}
    return record._replace(d=force.y, force=None, low_pass=low_pass, **times)


def columns(response: Response, record: DecelerationRecord) -> list[Array]:
    """What a unit of each error adds, as `DecelerationRecord.error_sd` has them, where ``response.d`` is."""
    gain = [] if record.side_by_side else [response.d]
    if record.force is not None:
        gain += [jnp.zeros_like(response.d)] * 2
    offset = jnp.where(True if record.contact.reach else record.inside(), jnp.ones_like(response.d), 0.0)
    return [response.by_velocity, *gain, offset, -response.jerk]


def _after_contact(record: DecelerationRecord) -> tuple[Array, Array]:
    """From contact to the first sample after it [s], and how many of the trace's samples are before."""
    late = jnp.maximum(jnp.ceil(-record.first_time / record.dt), 0.0)
    return record.first_time + late * record.dt, late.astype(int)
