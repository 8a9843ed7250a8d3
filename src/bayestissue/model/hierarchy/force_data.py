"""A force that was recorded beside the decelerations, as a fit takes it; or why it can't."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bayestissue.base.declarations import sentences
from bayestissue.base.errors import Coded
from bayestissue.base.impact_arrays import IndexPerImpact, PerImpact
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.recorder_noise import low_pass_of, recorded_noise
from bayestissue.model.likelihood.record import ForceRows, chosen_impacts
from bayestissue.model.likelihood.recorder import LowPass
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.signal import Displacements
from bayestissue.recordings.signal.displacement import FEWEST_SAMPLES
from bayestissue.recordings.signal.filters import ahead_s, decay, delay
from bayestissue.recordings.signal.force import Force, force_beside
from bayestissue.recordings.signal.padded_traces import (
    PaddedTraces,
    at,
    segment_moments,
    stack,
    standard_error,
)

# The zero is the mean of what ends so many samples before the first one in contact.
_CLEAR = 3
# Of a sampling interval: times that differ by less are alike.
_NEARLY = 1e-3
# Of a filter's answer to the jump at contact, what may be left of it.
_SETTLED = 0.01
# Of a sampling interval, the standard deviation of what is left of a lag that `Force.lags` does not show.
_CLOCK = 0.25
_SAID = sentences(__package__)


@dataclass(frozen=True, kw_only=True)
class PreparedForce:
    """The rows of a force, and what is declared of it and of the one factor of all masses that it shows.

    What is recorded of F over mass times deceleration is exp(a), a = log f + g: f is what all recorded masses
    are to be multiplied by, and g the error of the force's gain less that of the accelerometer's, one of each
    sensor.

    Attributes:
        comparison: the force against mass times deceleration.
        rows: of the likelihood.
        offset_sd: of its zero over the recorded mass [m/s^2].
        clock_sd: of what its clock is late [s].
        log_noise: log of the standard deviation of its noise, over the recorded mass [m/s^2].
        log_ratio: a first guess of each impact's a.
        mass_sd: standard deviation of log f, as declared.
        gain_sd: of g.
    """

    comparison: Force
    rows: ForceRows
    offset_sd: PerImpact
    clock_sd: PerImpact
    log_noise: PerImpact
    log_ratio: PerImpact
    mass_sd: float
    gain_sd: float

    @property
    def share(self) -> float:
        """Of the variance of a, that of the mass; 0 where none is declared."""
        total = self.mass_sd**2 + self.gain_sd**2
        return self.mass_sd**2 / total if total > 0 else 0.0

    def log_mass_factor(
        self, a: Float[np.ndarray, "*draw"], standard: Float[np.ndarray, "*draw"]
    ) -> Float[np.ndarray, "*draw"]:
        """Draws of log f given a, from standard normals: N(share a, share (1 - share) of the variance)."""
        sd = np.sqrt(self.share * (1 - self.share) * (self.mass_sd**2 + self.gain_sd**2))
        return self.share * a + sd * standard

    @property
    def time(self) -> Float[np.ndarray, "impact row"]:
        """Of the rows since contact [s], NaN past their end."""
        rows = self.rows
        return self._known(rows.first_time[:, None] + np.arange(rows.y.shape[1]) * rows.dt[:, None])

    def recorded(self, mass: PerImpact) -> Float[np.ndarray, "impact row"]:
        """The force [N] of impacts of this recorded mass [kg], NaN past a row's end."""
        return self._known(mass[:, None] * self.rows.y)

    def _known(self, values: Any) -> Float[np.ndarray, "impact row"]:
        return np.where(np.asarray(self.rows.inside()), values, np.nan)

    def impacts(self, rows: Int[np.ndarray, " row"]) -> PreparedForce:
        """Of some impacts."""
        names = ("offset_sd", "clock_sd", "log_noise", "log_ratio")
        chosen = {name: getattr(self, name)[rows] for name in names}
        return replace(self, rows=chosen_impacts(self.rows, rows), **chosen)


class RowsWithin(NamedTuple):
    """The samples of a force that lie in the windows, and what was quiet before.

    Attributes:
        used: which samples of the recordings lie in the windows.
        sample: the numbers of these, [impact, row]; past a row's end any.
        number: how many each impact has.
        zero: mean of the quiet part.
        noise: its standard deviation.
        n_quiet: how many samples that has.
    """

    used: Bool[np.ndarray, "impact sample"]
    sample: Int[np.ndarray, "impact row"]
    number: IndexPerImpact
    zero: PerImpact
    noise: PerImpact
    n_quiet: IndexPerImpact

    def within(self, values: np.ndarray) -> np.ndarray:
        """Of all samples those in the windows, [impact, row]."""
        return np.take_along_axis(values, self.sample, axis=1)


def rows_within(
    recorded: PaddedTraces, signal: Displacements, earlier_s: PerImpact, later_s: PerImpact
) -> RowsWithin:
    """The rows of a force, and the quiet part that ends three intervals before the first in contact.

    Args:
        recorded: the force.
        signal: the windows.
        earlier_s: by how much earlier each impact's force may begin [s].
        later_s: by how much later the windows begin [s].
    """
    first = signal.contact_time_s + signal.contact.since_s
    last = first + at(signal.time_s, signal.n_samples - 1)
    time = recorded.start[:, None] + recorded.time_s
    nearly = _NEARLY * recorded.dt[:, None]
    begin = (first + later_s)[:, None] - nearly
    used = recorded.inside & (time >= begin) & (time <= last[:, None] + nearly)
    clear = first - earlier_s - _CLEAR * np.maximum(recorded.dt, signal.dt)
    n_quiet = (recorded.inside & (time < clear[:, None])).sum(axis=1)
    number = used.sum(axis=1)
    index = np.minimum(used.argmax(axis=1)[:, None] + np.arange(number.max()), used.shape[1] - 1)
    return RowsWithin(used, index, number, *segment_moments(recorded.value, n_quiet), n_quiet)


def tells_added_mass(force: PreparedForce, name: str) -> bool:
    """Whether the element of this name has tissue that moves along, and the force was recorded below it.

    Of one mass M the force then is (1 + m / M) e^a times M d, and what is declared of e^a has to be its
    prior: a wide one, that declared errors only divide, would take up what is m's.
    """
    return force.rows.below and element(name).added_mass is not None


def prepared_force(
    dataset: Dataset, signal: Displacements, low_pass: LowPass | None, reach: int
) -> PreparedForce | str:
    """The force of a dataset that has one; or why these recordings keep a fit from using it.

    Args:
        dataset: decelerations, and a force.
        signal: what the signal chain made of the decelerations.
        low_pass: of the decelerations.
        reach: in how many of their sampling intervals before the first sample contact may be; 0 where it is
            known.
    """
    comparison = force_beside(dataset, signal)
    assert comparison is not None  # noqa: S101 - the callers ask
    channel, recorder = comparison.channel, comparison.channel.recorder
    recorded, first = stack(*dataset.further), signal.contact_time_s + signal.contact.since_s
    dt = recorded.dt
    # Contact is so long after the first sample of the decelerations at the latest, or so long before it.
    latest = (low_pass.lead if low_pass else 0) * signal.dt
    earliest = reach * signal.dt - latest
    hidden = np.zeros_like(dt)
    if reach:
        # A low-pass that looks ahead ends the decelerations' quiet part so long before contact, and one that
        # delays them so long after.
        quiet = signal.before.n_since_quiet * signal.dt - ahead_s(dataset.recorder, signal.dt)
        hidden = np.where(signal.quiet.there, quiet, earliest)
        hidden += delay(dataset.recorder) if dataset.recorder else 0.0
    rows = rows_within(recorded, signal, ahead_s(recorder, dt) + hidden, latest)
    usable = rows.used
    if recorder is not None:
        # What a filter makes of the jump at contact is not linear in when that was.
        settled = -np.log(_SETTLED) / decay(recorder, dt)
        usable = usable & (recorded.start[:, None] + recorded.time_s >= (first + settled)[:, None])
    at_limit = (rows.used & recorded.at_limit).any(axis=1).sum()
    reasons = {
        "at_limit": at_limit,
        "low_pass": recorder and reach,
        "uneven": recorded.uneven.any() or signal.uneven.any(),
        "clipped": signal.clipped.any(),
        "few_samples": (usable.sum(axis=1) < FEWEST_SAMPLES).any(),
        "no_quiet_part": (rows.n_quiet < FEWEST_SAMPLES).any(),
    }
    for reason, holds in reasons.items():
        if holds:
            return _SAID(f"unused.{reason}", at_limit=at_limit, impacts=len(dt), fewest=FEWEST_SAMPLES)
    if comparison.lags:
        return Coded.stated("channels-disagree.late", late=comparison.late)
    length, begins = int(rows.number.max()), recorded.start + rows.sample[:, 0] * dt
    if reach:
        length += 2 + int(np.ceil(((begins - first + earliest) / dt).max()))
    as_recorded = replace(dataset.with_settings(recorder=recorder), traces=dataset.further[0])
    colour, rate, longer = recorded_noise(as_recorded, replace(signal, dt=dt), length)
    mass = signal.mass
    counts = rows.within(usable) & (np.arange(rows.number.max()) < rows.number[:, None])
    value = rows.within(recorded.value - rows.zero[:, None]) / mass[:, None]
    to_length = ((0, 0), (0, length - counts.shape[1]))
    in_front = channel.tip_mass_kg / mass
    rows_of_force: Any = {
        "y": np.pad(np.where(counts, value, 0.0), to_length),
        "n_samples": rows.number,
        # Since contact as it was before the samples in contact were asked: these are to tell themselves.
        "first_time": begins - (first - signal.contact.bracket_s),
        "dt": dt,
        # A force below the tissue has no tip.
        "tip": in_front if channel.place == "impactor" else None,
        "usable": np.pad(counts, to_length) if (usable != rows.used).any() else None,
        "low_pass": recorder and low_pass_of(recorder, dt),
        "colour": colour,
        "rate": rate,
    }
    noise = np.maximum(rows.noise / mass, 1e-12)
    return PreparedForce(
        comparison=comparison,
        rows=ForceRows(**rows_of_force),
        offset_sd=longer * standard_error(noise, rows.n_quiet),
        clock_sd=_CLOCK * dt,
        log_noise=np.log(noise),
        log_ratio=np.log(np.maximum(comparison.ratio * (1 - in_front) + in_front, 1e-3)),
        mass_sd=float(dataset.uncertainty.relative_mass_sd),
        gain_sd=float(np.hypot(dataset.uncertainty.relative_gain_sd, channel.relative_gain_sd)),
    )
