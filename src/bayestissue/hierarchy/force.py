"""A force that was recorded beside the decelerations, as a fit takes it; or why it can't."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bayestissue.dataset.model import Dataset, Trace
from bayestissue.likelihood.element.record import ForceRows
from bayestissue.signal import Displacements
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.force import Force, force_beside
from bayestissue.signal.traces import segment_moments, stack, standard_error

# The zero is the mean of what ends so many samples before the first one in contact.
_CLEAR = 3
# Of a sampling interval, the standard deviation of what is left of a lag that `Force.lags` does not show.
_CLOCK = 0.25


@dataclass(frozen=True)
class PreparedForce:
    """The rows of a force, and what is declared of it.

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
    offset_sd: Float[np.ndarray, " impact"]
    clock_sd: Float[np.ndarray, " impact"]
    log_noise: Float[np.ndarray, " impact"]
    log_ratio: Float[np.ndarray, " impact"]
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

    def impacts(self, rows: Int[np.ndarray, " row"]) -> PreparedForce:
        """Of some impacts."""
        names = ("offset_sd", "clock_sd", "log_noise", "log_ratio")
        chosen = {name: getattr(self, name)[rows] for name in names}
        return replace(self, rows=ForceRows(*(leaf[rows] for leaf in self.rows)), **chosen)


class RowsWithin(NamedTuple):
    """The samples of a force that lie in the windows, and what was quiet before.

    Attributes:
        value: [impact, row], the zero not taken off; past a row's end any values.
        number: how many each impact has.
        first: on the recording's clock [s].
        dt: sampling interval [s].
        zero: mean of the quiet part.
        noise: its standard deviation.
        n_quiet: how many samples that has.
        uneven: where times are uneven.
    """

    value: Float[np.ndarray, "impact row"]
    number: Int[np.ndarray, " impact"]
    first: Float[np.ndarray, " impact"]
    dt: Float[np.ndarray, " impact"]
    zero: Float[np.ndarray, " impact"]
    noise: Float[np.ndarray, " impact"]
    n_quiet: Int[np.ndarray, " impact"]
    uneven: Bool[np.ndarray, " impact"]


def rows_within(traces: Sequence[Trace], signal: Displacements, earlier_s: Any = 0.0) -> RowsWithin:
    """The rows of a force, and the quiet part that ends three intervals before the first in contact.

    Args:
        traces: the force.
        signal: the windows.
        earlier_s: by how much earlier contact may have been [s], one for all or each impact's.
    """
    recorded = stack(traces)
    first = signal.contact_time_s + signal.first_sample_s
    ends = np.maximum(signal.n_samples - 1, 0)[:, None]
    last = first + np.take_along_axis(signal.sample_number, ends, axis=1)[:, 0] * signal.dt
    time = recorded.start[:, None] + recorded.time_s
    nearly = 1e-3 * recorded.dt[:, None]
    used = recorded.inside & (time >= first[:, None] - nearly) & (time <= last[:, None] + nearly)
    quiet = recorded.inside & (
        time < (first - earlier_s - _CLEAR * np.maximum(recorded.dt, signal.dt))[:, None]
    )
    count, n_quiet = used.sum(axis=1), quiet.sum(axis=1)
    begin = used.argmax(axis=1)
    index = np.minimum(begin[:, None] + np.arange(count.max()), recorded.value.shape[1] - 1)
    value = np.take_along_axis(recorded.value, index, axis=1)
    start = recorded.start + begin * recorded.dt
    moments = segment_moments(recorded.value, n_quiet)
    return RowsWithin(value, count, start, recorded.dt, *moments, n_quiet, recorded.uneven)


def prepared_force(dataset: Dataset, signal: Displacements) -> PreparedForce | str:
    """The force of a dataset that has one; or why these recordings keep a fit from using it.

    Args:
        dataset: decelerations, and a force.
        signal: what the signal chain made of the decelerations.
    """
    comparison = force_beside(dataset, signal)
    assert comparison is not None  # noqa: S101 - the callers ask
    channel = comparison.channel
    rows = rows_within(channel.traces, signal)
    count, n_quiet = rows.number, rows.n_quiet
    for wrong, words in (
        (rows.uneven.any() or signal.uneven.any(), "times are uneven"),
        (signal.clipped.any(), "recordings are clipped"),
        ((count < FEWEST_SAMPLES).any(), f"an impact has fewer than {FEWEST_SAMPLES} samples of it"),
        (
            (n_quiet < FEWEST_SAMPLES).any(),
            "a recording has no quiet part before contact, which tells its zero",
        ),
        (comparison.lags, f"it is {1e3 * abs(comparison.common_lag[0]):.2g} ms off: correct time_offset_s"),
    ):
        if wrong:
            return words
    mass = signal.mass
    value = rows.value - rows.zero[:, None]
    tip = channel.tip_mass_kg / mass
    # Contact as it was before the samples in contact were asked: these are to tell themselves.
    contact = signal.contact_time_s + signal.first_sample_s - signal.bracket_s
    parts: Any = (
        np.where(np.arange(count.max()) < count[:, None], value / mass[:, None], 0.0),
        count,
        rows.first - contact,
        rows.dt,
        tip,
    )
    chain, noise = dataset.uncertainty, np.maximum(rows.noise / mass, 1e-12)
    return PreparedForce(
        comparison,
        ForceRows(*parts),
        standard_error(noise, n_quiet),
        _CLOCK * rows.dt,
        np.log(noise),
        np.log(np.maximum(comparison.ratio * (1 - tip) + tip, 1e-3)),
        float(chain.relative_mass_sd),
        float(np.hypot(chain.relative_gain_sd, channel.relative_gain_sd)),
    )
