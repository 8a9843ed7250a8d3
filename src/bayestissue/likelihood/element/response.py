"""An element's answer to an impact at a record's samples, and how errors of the chain change it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.elements import Element, linear, solver
from bayestissue.elements.element import (
    GRAVITY,
    Parameters,
    at_contact,
    deceleration_of,
    rates_of_motion,
    tissue_force_over_mass,
)
from bayestissue.likelihood.element.record import Contact, DecelerationRecord, ForceRows
from bayestissue.likelihood.element.recorder import EARLIER, PIECES, Flow, LowPass, low_passed, samples_passed

# What a sensor reads of parameters, mass and state, over the mass [m/s^2].
Reading = Callable[[Element, Parameters, Array, Array], Array]


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
    record: DecelerationRecord,
    velocity: Float[Array, " impact"],
) -> Motion:
    """The impact at ``velocity`` [m/s], contact as the record has it; other arguments as of `response`."""
    first, late = _after_contact(record) if record.lead else (record.first_time, jnp.zeros(()))
    if record.uneven is not None:
        return Motion(*_at_times(element, parameters, velocity, record, record.time())[:3])
    x, v, d, _ = _on_grid(element, parameters, velocity, record, first, record.dt, record.d.shape[1])
    if not record.lead:
        return Motion(x, v, d)
    # In flight until contact.
    index = jnp.arange(record.d.shape[1]) - late[:, None]
    x, v, d = (jnp.take_along_axis(part, jnp.maximum(index, 0), axis=1) for part in (x, v, d))
    since = jnp.minimum(first[:, None] + index * record.dt[:, None], 0.0)
    flies, speed, fall = index < 0, velocity[:, None], record.gravity[:, None]
    here = speed * since + fall * since**2 / 2
    return Motion(
        jnp.where(flies, here, x), jnp.where(flies, speed + fall * since, v), jnp.where(flies, 0.0, d)
    )


@partial(jax.custom_jvp, nondiff_argnums=(0, 3))
def response(
    element: Element,
    parameters: Float[Array, "parameter impact"],
    record: DecelerationRecord,
    reading: Reading = deceleration_of,
) -> Response:
    """The element's answer at the samples.

    Its slopes, by the parameters and by the time from contact to the first sample, go forwards through the
    solver, one tangent for each and all impacts in each, so that reverse mode too costs no more than that.

    Args:
        element: what is hit.
        parameters: its parameters in their order.
        record: masses, velocities and times.
        reading: what is recorded.
    """
    return _response(element, parameters, record, reading)


@response.defjvp
def _response_jvp(
    element: Element, reading: Reading, primals: Any, tangents: Any
) -> tuple[Response, Response]:
    (parameters, record), by = primals, tangents

    def at(moved: Array) -> Response:
        return _response(element, moved[:-1], record.with_first_time(moved[-1]), reading)

    moved, along = (
        jnp.concatenate([values, times.first_time[None]]) for values, times in ((parameters, record), by)
    )
    unit = jnp.broadcast_to(jnp.eye(len(moved))[..., None], (len(moved), *moved.shape))
    answer, slopes = jax.vmap(lambda one: jax.jvp(at, (moved,), (one,)), out_axes=(None, 0))(unit)
    change: Response = jax.tree.map(lambda slope: jnp.einsum("pi...,pi->i...", slope, along), slopes)
    return answer, change


def _response(element: Element, parameters: Array, record: DecelerationRecord, reading: Reading) -> Response:
    inside = True if record.contact.reach else record.inside()
    force = None if record.force is None else _of_force(element, parameters, record, record.force)
    answered = _by_velocity(
        element, record, partial(_answer, element, parameters, record=record, reading=reading)
    )
    d, by_velocity, jerk = (jnp.where(inside, part, 0.0) for part in answered)
    return Response(d, by_velocity, jerk, force)


def _answer(
    element: Element, parameters: Array, velocity: Array, record: DecelerationRecord, reading: Reading
) -> tuple[Array, Array]:
    """A reading and its slope at the samples."""
    if record.low_pass is not None:
        return _recorded(element, parameters, velocity, record, record.low_pass, reading)
    if record.uneven is not None:
        time = record.uneven.since_contact() if record.contact.reach else record.time()
        return _at_times(element, parameters, velocity, record, time, reading)[2:]
    first = record.phase[0] * record.dt if record.contact.reach else record.first_time
    count = record.d.shape[1] + record.contact.reach
    return _on_grid(element, parameters, velocity, record, first, record.dt, count, reading)[2:]


def _by_velocity(
    element: Element, record: DecelerationRecord, answer: Callable[[Array], tuple[Array, Array]]
) -> tuple[Array, Array, Array]:
    """A reading, its derivative by the velocity at contact, and its slope, of what gives first and last."""
    if element.linear and GRAVITY not in record.surroundings:
        # In proportion to the velocity at contact.
        d, jerk = answer(record.velocity)
        return d, d / record.velocity.reshape(-1, *[1] * (d.ndim - 1)), jerk
    (d, jerk), (by_velocity, _) = jax.jvp(answer, (record.velocity,), (jnp.ones_like(record.velocity),))
    return d, by_velocity, jerk


def _of_force(element: Element, parameters: Array, record: DecelerationRecord, force: ForceRows) -> Response:
    """The answer at the samples of the force.

    Where it has to be in one go for contact in several cells, it is made on one even grid of the force's
    interval that begins after contact in the last cell. From cell to cell the samples lie later on it by a
    time that all of them share: the cubic through deceleration and jerk of the grid's points is there, with
    an error of (omega_n h)^4 / 384 of the motion.
    """
    reading = tissue_force_over_mass if force.below else deceleration_of
    if not record.contact.reach:
        return _response(element, parameters, at_force(record, force), reading)
    since = (force.first_time - record.first_time + record.cells).T
    begin = since.min(1) % force.dt
    later = (since - begin[:, None]) / force.dt[:, None]
    whole = jnp.maximum(jnp.floor(later), 0.0)
    index = whole.astype(int)[..., None] + jnp.arange(force.y.shape[1])
    known = Contact.known(jnp.zeros(len(begin), bool))
    grid = at_force(record, force)._replace(first_time=begin, contact=known)

    def shifted(velocity: Array) -> tuple[Array, Array]:
        d, jerk = _answer(element, parameters, velocity, grid, reading)
        into, interval = (later - whole)[..., None], force.dt[:, None, None]

        def at(values: Array, index: Array) -> Array:
            flat = jnp.minimum(index, values.shape[1] - 1).reshape(len(values), -1)
            return jnp.take_along_axis(values, flat, axis=1).reshape(index.shape)

        ends = (at(d, index), at(d, index + 1)), (at(jerk, index), at(jerk, index + 1))
        return solver.cubic(*ends, into, interval), solver.cubic_slope(*ends, into, interval)

    inside = jnp.expand_dims(force.inside(), 1)
    parts: Any = (jnp.where(inside, part, 0.0) for part in _by_velocity(element, record, shifted))
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


def _on_grid(
    element: Element,
    parameters: Array,
    velocity: Array,
    record: DecelerationRecord,
    first: Array,
    dt: Array,
    count: int,
    reading: Reading = deceleration_of,
) -> tuple[Array, Array, Array, Array]:
    """Penetration, velocity, reading and its slope at first + k dt after contact, k = 0 ... count - 1."""
    y = _states(element, parameters, velocity, record, first, dt, count)
    return _of_states(element, parameters, record, y, reading)


def _states(
    element: Element,
    parameters: Array,
    velocity: Array,
    record: DecelerationRecord,
    first: Array,
    dt: Array,
    count: int,
) -> Float[Array, "state impact sample"]:
    """The element's state on such a grid."""
    grid = linear.even_grid if element.linear else solver.even_grid
    return grid(element, _named(element, parameters, record), record.mass, velocity, first, dt, count)


def _named(element: Element, parameters: Array, record: DecelerationRecord) -> dict[str, Array]:
    names = [parameter.name for parameter in element.parameters]
    return dict(zip(names, parameters, strict=True)) | record.surroundings


def _rates(
    element: Element, parameters: Array, record: DecelerationRecord, y: Float[Array, "state impact time"]
) -> Array:
    p = {name: value[:, None] for name, value in _named(element, parameters, record).items()}
    return rates_of_motion(element, p, record.mass[:, None], y)


def _of_states(
    element: Element,
    parameters: Array,
    record: DecelerationRecord,
    y: Float[Array, "state impact time"],
    reading: Reading,
) -> tuple[Array, Array, Array, Array]:
    """Penetration, velocity, reading and its slope in these states; of a deceleration that is the jerk."""
    p, mass = _named(element, parameters, record), record.mass[:, None]
    p = {name: value[:, None] for name, value in p.items()}
    rates = rates_of_motion(element, p, mass, y)
    d, jerk = jax.jvp(lambda y: reading(element, p, mass, y), (y,), (rates,))
    return y[0], y[1], d, jerk


def _at_times(
    element: Element,
    parameters: Array,
    velocity: Array,
    record: DecelerationRecord,
    time: Float[Array, "impact time"],
    reading: Reading = deceleration_of,
) -> tuple[Array, Array, Array, Array]:
    """The same at any times since contact; no force before it.

    By the cubic through states and rates of an even grid from contact on, of about half the mean sampling
    interval, h: its error is (omega_n h)^4 / 384 of the motion.
    """
    count = 2 * (record.d.shape[1] + record.contact.reach)
    rows = time.reshape(len(time), -1, record.contact.reach + record.d.shape[1])[..., record.contact.reach :]
    last = jnp.where(record.inside()[:, None], rows, 0.0).max((1, 2))
    dt = jnp.maximum(last, record.dt) / (count - 1)
    begin = at_contact(element, _named(element, parameters, record), record.mass, velocity)[..., None]
    y = jnp.concatenate([begin, _states(element, parameters, velocity, record, dt, dt, count - 1)], axis=-1)
    slope = _rates(element, parameters, record, y)
    steps = jnp.clip(time / dt[:, None], 0.0, count - 1.0)
    index = jnp.minimum(steps.astype(int), count - 2)
    here, there = ((part[..., :-1], part[..., 1:]) for part in (y, slope))

    def taken(values: Array) -> Array:
        return jnp.take_along_axis(values, index[None], axis=2)

    y = solver.cubic(
        (taken(here[0]), taken(here[1])), (taken(there[0]), taken(there[1])), steps - index, dt[:, None]
    )
    x, v, d, jerk = _of_states(element, parameters, record, y, reading)
    flies = time < 0
    return x, v, jnp.where(flies, 0.0, d), jnp.where(flies, 0.0, jerk)


def _after_contact(record: DecelerationRecord) -> tuple[Array, Array]:
    """From contact to the first sample after it [s], and how many of the trace's samples are before."""
    late = jnp.maximum(jnp.ceil(-record.first_time / record.dt), 0.0)
    return record.first_time + late * record.dt, late.astype(int)


def _recorded(
    element: Element,
    parameters: Array,
    velocity: Array,
    record: DecelerationRecord,
    low_pass: LowPass,
    reading: Reading,
) -> tuple[Array, Array]:
    """A reading and its slope behind a recorder's low-pass, on the grid of `Response`."""

    def flow(first: Array, dt: Array, count: int) -> Flow:
        d, jerk = _on_grid(element, parameters, velocity, record, first, dt, count, reading)[2:]
        return Flow(d, jerk, dt)

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
