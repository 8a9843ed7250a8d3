"""What is recorded of an impact: its deceleration, the measuring chain's errors, contact and noise.

A part that a record lacks is an array without entries: no samples before the first where contact is known, no
modes where no discrepancy is beside the element, or none that a filter leaves of the noise.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.base.impact_arrays import IndexPerImpact, JaxPerImpact, JaxPerSample, PerImpact, padded_zeros
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.model.likelihood.linear_errors import part_of
from bayestissue.model.likelihood.recorder import Colour, LowPass
from bayestissue.model.likelihood.small import LOG_2PI

# Among the errors of the measuring chain; the gain, if it is another than the velocity's, is there.
VELOCITY, GAIN, OFFSET, CONTACT = 0, 1, -2, -1
# By so much of an interval contact may seem to be beyond it. With a tenth, places of twenty impacts on a
# sample drew their mean to the middle, and 90 % intervals of C held 80 % at ten samples and 1 % of noise.
_CLEAR = 0.5
# By their names in the posterior, which link of the measuring chain errs; those of a force only beside one.
_LINKS = {
    "velocity_error": "velocity",
    "gain_error": "gain",
    "force_offset_error": "force's zero",
    "force_clock_error": "force's clock",
    "offset_error": "offset",
    "contact_time_error": "contact moment",
}
# Where an error of the gain is one of the velocity.
_MERGED = ("velocity_error", "offset_error", "contact_time_error")


def chosen_impacts[T](tree: T, rows: Int[np.ndarray, " row"]) -> T:
    """Some impacts of a tree of arrays; a recorder's filter and noise are those of all."""
    shared = (Colour, LowPass)

    def chosen(part: Any) -> Any:
        return part if isinstance(part, shared) else np.asarray(part)[rows]

    of_rows: T = jax.tree.map(chosen, tree, is_leaf=lambda part: isinstance(part, shared))
    return of_rows


class Contact(NamedTuple):
    """When contact was: so long before the first sample as is known, or in any of the intervals before it.

    Attributes:
        uniform: where the contact time's error is uniform instead of normal.
        before: the samples before the first, in order of time, one for each sampling interval that contact
            may be in; 0 where there are none [m/s^2]. Contact is known where it has no entries.
        n_before: how many of these samples were recorded and count.
        n_quiet: how many of these, the earliest, are of the quiet part whose mean is the zero that was taken
            away. Relative to that mean they tell nothing of its error, of which they are independent.
        quiet_log_density: of these samples as a quiet part of the recorder's noise, which the likelihood is
            relative to where noise is white; else 0.
        fraction: where contact lies in an interval of ``before``, from its end and as a fraction of it: its
            middle, where ``uniform``; 0 or 1 at a sample, the first of which then is in contact; or where a
            parameter has it.
    """

    uniform: Bool[Array, " impact"]
    before: Float[Array, "impact reach"]
    n_before: Int[Array, " impact"]
    n_quiet: Int[Array, " impact"]
    quiet_log_density: JaxPerImpact
    fraction: JaxPerImpact

    @classmethod
    def known(cls, uniform: Bool[Array | np.ndarray, " impact"]) -> Contact:
        """At ``first_time`` but for its error."""
        nowhere = cls.anywhere(np.zeros((len(uniform), 0)), np.zeros(len(uniform), int))
        return nowhere._replace(uniform=uniform)  # type: ignore[arg-type]

    @classmethod
    def anywhere(
        cls,
        before: Float[np.ndarray, "impact reach"],
        n_before: IndexPerImpact,
        quiet_sd: PerImpact | None = None,
        fraction: float | None = None,
        n_quiet: IndexPerImpact | int = 0,
    ) -> Contact:
        """In any of the intervals of ``before``; with the noise's standard deviation in a quiet part.

        At one moment in each of them, where its ``fraction`` is known.
        """
        counts = np.arange(before.shape[1]) >= before.shape[1] - np.asarray(n_before)[:, None]
        early, density = np.where(counts, before, 0.0), np.zeros(len(before))
        if quiet_sd is not None:
            density = -(n_before * (LOG_2PI + 2 * np.log(quiet_sd)) + (early**2).sum(1) / quiet_sd**2) / 2
        of_all = (fraction is None, n_quiet, 0.5 if fraction is None else fraction)
        uniform, of_quiet, within = (np.full(len(before), value) for value in of_all)
        parts: Any = (uniform, early, n_before, of_quiet, density, within)
        return cls(*parts)

    @property
    def reach(self) -> int:
        """In how many sampling intervals before the first sample contact may be."""
        return self.before.shape[1]

    @property
    def counts(self) -> Bool[Array, "impact reach"]:
        """Which of ``before`` were recorded and count."""
        return jnp.arange(self.reach) >= self.reach - self.n_before[:, None]


class UnevenTimes(NamedTuple):
    """When the samples were, since the first one [s].

    Attributes:
        later: of the samples themselves; past a row's end any times.
        before: of the samples before the first, as `Contact.before` has them, rising to below 0.
    """

    later: JaxPerSample
    before: Float[Array, "impact reach"]

    @property
    def cells(self) -> tuple[Float[Array, "impact reach"], Float[Array, "impact reach"]]:
        """Of the intervals between these samples, the last first: from the middle to time 0, and width."""
        ends = jnp.pad(self.before, ((0, 0), (0, 1)))[:, ::-1]
        return -(ends[:, :-1] + ends[:, 1:]) / 2, ends[:, :-1] - ends[:, 1:]

    def since_contact(self) -> Float[Array, "impact cell_and_sample"]:
        """Of all samples, the earlier among them, since contact in the middle of each such interval."""
        time = jnp.concatenate([self.before, self.later], axis=1)
        return (time[:, None] + self.cells[0][..., None]).reshape(len(time), -1)


class Discrepancy(NamedTuple):
    """The modes of a smooth force beside the element's: see `bayestissue.model.likelihood.noise`.

    Attributes:
        basis: modes, orthonormal over each impact's samples and 0 past its end.
        share: their part in the discrepancy's mean square.
    """

    basis: Float[Array, "impact mode sample"]
    share: Float[Array, "impact mode"]


class ForceRows(NamedTuple):
    """A force that was recorded beside the deceleration, over the recorded mass.

    Attributes:
        y: F / M, its zero taken off, 0 past a row's end [m/s^2]. Where contact may be in any of several
            cells, the rows are as much longer as contact may be before them.
        n_samples: length of each.
        first_time: from contact to its first sample [s].
        dt: its sampling interval [s].
        tip: m / M, of what lies in front of the sensor; None of one below the tissue, which reads the
            tissue's own force and not the one on the impactor.
        colour, rate: of its noise, as of `DecelerationRecord`.
        usable: where a sample counts, as those before its filter has settled do not; None where all do.
        low_pass: a filter that it went through, of known contact alone; None where there is none.
    """

    y: Float[Array, "impact row"]
    n_samples: Int[Array, " impact"]
    first_time: JaxPerImpact
    dt: JaxPerImpact
    tip: JaxPerImpact | None
    colour: Colour
    rate: Int[Array, " impact"]
    usable: Bool[Array, "impact row"] | None = None
    low_pass: LowPass | None = None

    @property
    def below(self) -> bool:
        """Whether it was recorded below the tissue."""
        return self.tip is None

    def share(self, log_ratio: JaxPerImpact) -> JaxPerImpact:
        """What it reads over what moves M: e^a - m / M, a being ``log_ratio``, and below the tissue e^a."""
        return jnp.exp(log_ratio) if self.tip is None else jnp.exp(log_ratio) - self.tip

    def inside(self) -> Bool[Array, "impact row"]:
        """True where there is a sample that counts."""
        inside = jnp.arange(self.y.shape[1]) < self.n_samples[:, None]
        return inside if self.usable is None else inside & self.usable

    def padded(self) -> ForceRows:
        """With as many samples, 0 past a row's end, as a `bucket` holds."""
        return self._replace(y=padded_zeros(self.y, 1), usable=padded_zeros(self.usable, 1))


class DecelerationRecord(NamedTuple):
    """What the likelihood reads of a set of deceleration traces.

    Attributes:
        d: decelerations, 0 past a row's end [m/s^2].
        n_samples: length of each.
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
        velocity: recorded velocity at contact [m/s].
        error_sd: standard deviations of velocity [m/s], gain [1], offset [m/s^2] and contact time [s]. One of
            velocity and gain together, without the second column, makes the record one of a spring and damper
            side by side with white noise and known contact: see `side_by_side`.
        velocity_share: of the variance of the velocity's error that which is its own; where it is that of
            velocity and gain together, the rest is the gain's.
        mass: recorded mass [kg].
        surroundings: what an element's functions take beside its parameters, by name: the impactor's diameter
            [m] and, where there is any, gravity along the motion [m/s^2]; decelerations are force over mass
            then.
        contact: when it was.
        discrepancy: its modes.
        colour: the part of the noise that went through the recorder's filter.
        rate: which of that noise's sampling rates each impact has.
        common_depth: one depth that every impact reaches [m]; no part of the likelihood.
        low_pass: a filter that the traces went through; None where there is none.
        uneven: when the samples were, where some trace's times are not even; None where all are.
        clipped: 1 where a sample stands at the sensor's upper limit, -1 at its lower one, else 0: d is that
            limit, and what was to be measured lies there or beyond. None where no trace has any.
        force: recorded beside it; ``error_sd`` then has those of its zero [m/s^2] and of its clock [s] behind
            the gain's. None where there is none.
        shared_by: how many impacts have one error of velocity and gain in common, whose standard deviations
            in ``error_sd`` then are the root of that number too wide; None where each has its own.
        interval: the sampling interval in which the place of contact is a parameter of the impact [s], 0 of
            one whose contact is not known to be in one; ``first_time`` is from its middle. None where contact
            is no parameter.
        earlier: where contact is a parameter and put there, by how many of these intervals before the middle.
    """

    d: JaxPerSample
    n_samples: Int[Array, " impact"]
    first_time: JaxPerImpact
    dt: JaxPerImpact
    velocity: JaxPerImpact
    error_sd: Float[Array, "impact error"]
    velocity_share: JaxPerImpact
    mass: JaxPerImpact
    surroundings: dict[str, JaxPerImpact]
    contact: Contact
    discrepancy: Discrepancy
    colour: Colour
    rate: Int[Array, " impact"]
    common_depth: JaxPerImpact
    low_pass: LowPass | None = None
    uneven: UnevenTimes | None = None
    clipped: JaxPerSample | None = None
    force: ForceRows | None = None
    shared_by: JaxPerImpact | None = None
    interval: JaxPerImpact | None = None
    earlier: JaxPerImpact | None = None

    @classmethod
    def from_arrays(
        cls,
        d: np.ndarray,
        n_samples: np.ndarray,
        first_time: np.ndarray,
        dt: np.ndarray,
        velocity: np.ndarray,
        error_sd: np.ndarray,
        mass: np.ndarray,
        surroundings: dict[str, Any],
        contact: Contact,
        **further: Any,
    ) -> DecelerationRecord:
        """Of white noise without a discrepancy, unless ``further`` has them; 0 past a row's end."""
        number, samples = d.shape
        inside = np.arange(samples) < np.asarray(n_samples)[:, None]
        modes: Any = (np.zeros((number, 0, samples)), np.zeros((number, 0)))
        parts: Any = {
            "d": np.where(inside, d, 0.0),
            "n_samples": n_samples,
            "first_time": first_time,
            "dt": dt,
            "velocity": velocity,
            "error_sd": error_sd,
            "velocity_share": np.ones(number),
            "mass": mass,
            "surroundings": surroundings,
            "contact": contact,
            "discrepancy": Discrepancy(*modes),
            "colour": Colour.white_noise(),
            "rate": np.zeros(number, int),
            "common_depth": np.zeros(number),
            **further,
        }
        on_device: DecelerationRecord = jax.device_put(jax.tree.map(np.asarray, cls(**parts)))
        return on_device

    @property
    def traces(self) -> JaxPerSample:
        """The recorded decelerations."""
        return self.d

    @property
    def side_by_side(self) -> bool:
        """Whether it is of a spring and damper side by side, white noise and known contact alone."""
        return self.error_sd.shape[-1] == len(_MERGED)

    @property
    def errors(self) -> dict[str, str]:
        """What each column of ``error_sd`` is called in the posterior, and which link of the chain errs."""
        if self.side_by_side:
            links = {name: _LINKS[name] for name in _MERGED}
            return links | {"velocity_error": "velocity and gain"}
        with_force = self.force is not None
        return {name: link for name, link in _LINKS.items() if with_force or not name.startswith("force")}

    def of_gain(self, log_gain: JaxPerImpact) -> Float[Array, "impact error"]:
        """What a gain in error adds to the errors of the chain, the velocity's where that is one with it."""
        column, unit = (VELOCITY, self.velocity) if self.side_by_side else (GAIN, 1.0)
        return jnp.zeros_like(self.error_sd).at[:, column].set(unit * jnp.expm1(log_gain))

    def velocity_error(self, errors: Float[Array, "impact error"], key: Array) -> JaxPerImpact:
        """A draw of the error of the recorded velocity given those of the chain [m/s]."""
        return part_of(errors[:, VELOCITY], self.error_sd[:, VELOCITY], self.velocity_share, key)

    @property
    def gravity(self) -> JaxPerImpact:
        """The part of gravity along the motion [m/s^2]."""
        return self.surroundings.get(GRAVITY, jnp.zeros_like(self.mass))

    @property
    def phase(self) -> Float[Array, "phase impact"]:
        """Moments of contact within a sampling interval that are told apart, as fractions of it."""
        if self.low_pass is None:
            return self.contact.fraction[None]
        return jnp.broadcast_to(self.low_pass.phase[:, None], (len(self.low_pass.phase), len(self.dt)))

    @property
    def cells(self) -> Float[Array, "cell impact"]:
        """From contact in the middle of each cell to the first sample [s]; the first cell is the last before.

        Behind a low-pass a row of them for each phase, by as much later as the filter looks ahead. Of a known
        contact its time alone.
        """
        if not self.contact.reach:
            return self.first_time[None]
        if self.uneven is not None:
            return self.uneven.cells[0].T
        interval = jnp.arange(self.contact.reach)[:, None] + self.phase[:, None] - self.lead
        return interval.reshape(-1, len(self.dt)) * self.dt

    @property
    def lead(self) -> int:
        """For how many sampling intervals before contact a filter that looks ahead has an answer."""
        return 0 if self.low_pass is None else self.low_pass.lead

    def with_traces(self, traces: Float[Array | np.ndarray, "impact sample"]) -> DecelerationRecord:
        """The record of other traces."""
        return self._replace(d=jnp.where(self.inside(), jnp.asarray(traces), 0.0))

    def impacts(self, rows: Int[np.ndarray, " row"]) -> DecelerationRecord:
        """The record of some impacts."""
        return chosen_impacts(self, rows)

    def padded(self) -> DecelerationRecord:
        """With as many samples, 0 past a row's end, as a `bucket` holds."""
        d, basis, clipped = padded_zeros((self.d, self.discrepancy.basis, self.clipped), -1)
        discrepancy = self.discrepancy._replace(basis=basis)
        uneven = self.uneven and self.uneven._replace(later=padded_zeros(self.uneven.later, 1))
        force = self.force and self.force.padded()
        return self._replace(d=d, discrepancy=discrepancy, uneven=uneven, clipped=clipped, force=force)

    def with_normal_errors(self) -> DecelerationRecord:
        """The same, every error of the measuring chain taken as normal with its standard deviation.

        Over all cells of contact the likelihood is smooth as it is.
        """
        if self.contact.reach:
            return self
        return self._replace(contact=self.contact._replace(uniform=jnp.zeros_like(self.contact.uniform)))

    def at_contact(self, first_time: JaxPerImpact) -> DecelerationRecord:
        """The same traces with contact so long before the first sample [s], its error about that."""
        return self.with_first_time(first_time)._replace(contact=Contact.known(self.contact.uniform))

    def with_contact_earlier(self, by: JaxPerImpact) -> DecelerationRecord:
        """The same traces with contact so many sampling intervals before the middle of its own."""
        assert self.interval is not None  # noqa: S101 - for the type checker
        return self.with_first_time(self.first_time + by * self.interval)._replace(earlier=by)

    def log_seen_in_interval(self) -> JaxPerImpact | float:
        """What the samples at both ends of contact's interval say of its place: it is between them.

        The earlier one shows no force and the later one does. The likelihood of the others goes on smoothly
        beyond, as this does, so that a place at a sample is as likely as any. Of several intervals none is
        bounded: beyond it is the next.
        """
        if self.earlier is None or self.interval is None or self.contact.reach:
            return 0.0
        beyond = jnp.maximum(jnp.abs(self.earlier) - (0.5 + _CLEAR), 0.0)
        return jnp.where(self.interval > 0, -jnp.square(beyond / _CLEAR) / 2, 0.0)

    def with_first_time(self, first_time: JaxPerImpact) -> DecelerationRecord:
        """The same traces, all of them, with contact so long before the first sample [s].

        Where contact may be in any of several intervals, its place in each of them moves by as much.
        """
        force, earlier = self.force, first_time - self.first_time
        if force is not None:
            force = force._replace(first_time=force.first_time + earlier)
        contact = self.contact._replace(fraction=self.contact.fraction + earlier / self.dt)
        return self._replace(first_time=first_time, force=force, contact=contact)

    def inside(self) -> Bool[Array, "impact sample"]:
        """True where there is a sample."""
        return jnp.arange(self.d.shape[1]) < self.n_samples[:, None]

    def observed(self) -> Bool[Array, "impact sample"]:
        """True where there is a sample that is not clipped."""
        return self.inside() if self.clipped is None else self.inside() & (self.clipped == 0)

    def within_limits(self, d: JaxPerSample) -> JaxPerSample:
        """What the sensor makes of such decelerations: where it clipped a trace its limit is the trace's."""
        if self.clipped is None:
            return d
        highest = jnp.where(self.clipped > 0, self.d, jnp.inf).min(axis=1, keepdims=True)
        lowest = jnp.where(self.clipped < 0, self.d, -jnp.inf).max(axis=1, keepdims=True)
        return jnp.clip(d, lowest, highest)

    def time(self) -> JaxPerSample:
        """Time since contact, also past a row's end [s]."""
        if self.uneven is not None:
            return self.first_time[:, None] + self.uneven.later
        return self.first_time[:, None] + jnp.arange(self.d.shape[1]) * self.dt[:, None]

    def step(self) -> Float[Array, "impact _"]:
        """From each sample to the next [s]; one for all where times are even."""
        return self.dt[:, None] if self.uneven is None else jnp.diff(self.uneven.later, axis=1)
