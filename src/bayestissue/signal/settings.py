"""The numbers by which a recording becomes a displacement, each with what it was chosen by."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ContactSettings:
    """By what contact is found in a recording, and the end of the force; fractions are of the peak.

    Attributes:
        scatter_samples: so many samples of a quiet part tell the noise by their scatter.
        quiet_samples: a quiet part is at least this long,
        quiet_ceiling: this far below the peak,
        quiet_drift: and this level.
        certain: how many noise standard deviations a sample must rise to be in contact, or a force to be
            clear of the noise,
        quiet: and how many a sample may rise and still be quiet.
        doubtful_s: a chosen contact is doubtful where it is farther than this from where the trace shows it.
        reach: a force that rises evenly passes ``certain`` standard deviations, with noise in its way, about
            twice as long after contact as the bracket says, and twice that level as long after as before;
        rises: one that rises as x^(3/2) passes the first in three fifths of the time to the second.
        blur: times the noise's share of the peak, squared: how many samples a mean has. Five of its standard
            deviations are then a sixth of the peak.
        rounding: recorded numbers are rounded; below this fraction of the peak a difference means nothing.
        most_jump: of the greatest force, that a first sample may have where contact is judged by it.
        threshold: of the peak, that the trace passes at contact where that is so chosen.
        about_g: of g, by which the step from held to falling may be off it,
        letting_go: and the part of the time from that step to the peak that is not free fall yet.
    """

    scatter_samples: int = 20
    quiet_samples: int = 5
    quiet_ceiling: float = 0.3
    quiet_drift: float = 0.01
    certain: float = 5.0
    quiet: float = 3.0
    doubtful_s: float = 1e-3
    reach: float = 4.0
    rises: float = 2.5
    blur: float = 30.0
    rounding: float = 1e-6
    most_jump: float = 0.9
    threshold: float = 0.05
    about_g: float = 0.3
    letting_go: float = 0.1


CONTACT = ContactSettings()


@dataclass(frozen=True)
class WindowSettings:
    """By what a motion counts as stopped, and how its samples are taken.

    Attributes:
        stopped: of the velocity at contact, below which a mass that nothing pushes any more has stopped.
        slow: a motion that some other force keeps going counts as stopped where it is slowest, below this
            fraction of that velocity.
        few_below: with fewer samples below the sensor's limit until zero velocity, those of the rebound are
            used too.
        smoothing_s: derivatives are those of a parabola fitted over about this long: a millimetre's tenth of
            noise at 1 kHz then leaves a few per cent of noise on the velocity of a heel strike.
        clear: of the greatest velocity, the noise that may be left on it where zero velocity is looked for.
        block: arrays of about this many samples stay in a processor's cache and bound the memory in use.
    """

    stopped: float = 0.05
    slow: float = 0.25
    few_below: int = 16
    smoothing_s: float = 0.005
    clear: float = 0.04
    block: int = 1_000_000


WINDOW = WindowSettings()


@dataclass(frozen=True)
class PhaseSettings:
    """By what contact is taken to be at a sample.

    Attributes:
        least_sd: of sampling intervals: clocks and integrals are no better than this.
        on_sample: the prior probability of contact at a sample: at the one where the clock begins, or half of
            it for each of the two. Without it recordings that were cut at contact held C in 39 % of 90 %
            intervals at 5 kHz, and with it in 94 %, cut or not.
        sure: the probability from which on an account is taken alone.
        clear: of log evidence, by which one of the two samples is clearly likelier than the other. Contact
            declared to be at a sample is at the first one, or where the clock begins, unless the other is so.
        contradicts: of log evidence, by which contact between samples is likelier where the recordings
            contradict a declared one at a sample,
        apart: and so far, in sampling intervals and beyond its errors, it then scatters.
        mean_sd, spread: scales of the normal and half-normal priors of the mean and the spread of f, contact
            being (1/2 + f) intervals before the first sample in contact; those of a fit stand in its model.
    """

    least_sd: float = 2e-3
    on_sample: float = 0.2
    sure: float = 0.95
    clear: float = 3.0
    contradicts: float = 7.0
    apart: float = 0.15
    mean_sd: float = 0.5
    spread: float = 0.3


PHASE = PhaseSettings()


@dataclass(frozen=True)
class BeyondLimitSettings:
    """How a spring and damper is fitted to what a sensor at its limit recorded.

    Attributes:
        starts: of the force's duration above ``pushes``: half a period of the oscillations that are tried
            first.
        pushes: of the limit: below it, after the plateau, the tissue may no longer push as it did.
        fewest: samples that are fitted.
        well: half of a squared error of 4 % of the limit: no other start is tried.
    """

    starts: tuple[float, ...] = (0.7, 1.0, 1.6)
    pushes: float = 0.2
    fewest: int = 4
    well: float = 8e-4


BEYOND_LIMIT = BeyondLimitSettings()


@dataclass(frozen=True)
class FilterSettings:
    """How a recorder's filter and the noise behind it are worked out.

    Attributes:
        left_out: what is left out of a filter's answer before contact, as a part of it.
        at_rest: time constants of its slowest pole until nothing is left that rounding would not hide.
        lengths: of the quiet parts, in samples: the greatest that fits is used.
        fewest: quiet samples of all impacts together that can tell which way the noise came.
        impacts: that are used for it.
        rounding: of the eigenvalues of a correlation, whose sum is the number of samples.
        all_white: from this share on noise counts as white: behind a corner of a fiftieth of the sampling
            rate its variance at low frequencies is then a tenth more than that of white noise.
    """

    left_out: float = 1e-3
    at_rest: float = 40.0
    lengths: tuple[int, ...] = (256, 128, 64, 32, 16)
    fewest: int = 64
    impacts: int = 200
    rounding: float = 1e-12
    all_white: float = 0.99


FILTER = FilterSettings()
