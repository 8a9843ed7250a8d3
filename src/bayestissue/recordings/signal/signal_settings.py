"""What a lab may choose on the way from a recording to an estimate, and the numbers of this package.

A choice is a key of the ``[signal]`` table of a model. Of each number stands what it was chosen by.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from bayestissue.base.errors import InputError
from bayestissue.base.resources import model_content
from bayestissue.base.settings import TomlTable, checked

type Window = Literal["peak", "rebound"] | Annotated[float, Field(gt=0, le=1)]


class SignalOptions(TomlTable):
    """Where contact is in a recording, and which part of it from there on is used.

    Attributes:
        contact: automatic: between the last quiet sample and the first that is not, and within that gap where
            the trace is most nearly that of a spring and damper met at the recorded velocity; time-zero: time
            0 of the recording; threshold: where d first exceeds 5 % of its peak.
        window: peak: from contact to zero velocity, as in the thesis; a number between 0 and 1: that fraction
            of the time to zero velocity; rebound: until the tissue no longer pushes.
    """

    contact: Literal["automatic", "time-zero", "threshold"] = "automatic"
    window: Window = "peak"


def read_signal_options(path: Path) -> SignalOptions:
    """The ``[signal]`` table of a model file; a choice that it leaves out keeps its default.

    Raises:
        InputError: the file can't be read, or the table holds a key or a value that is not allowed; each
            one is named, with what is allowed.
    """
    table = model_content(path).get("signal", {})
    if not isinstance(table, dict):
        raise InputError.stated("key-value.table", str(path), column="signal", value=table)
    return checked(table, SignalOptions, file=str(path), within=("signal",))


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


@dataclass(frozen=True)
class PulseSettings:
    """By what the pulse of a recording and its rests are found, and how many are inspected at a time.

    Attributes:
        median: samples of the running median that finds the pulse: it forgets spikes of up to three samples.
        low: of the peak, where the foot of the pulse is looked for:
        foot: where a pulse that rises as sin^(3/2) passes it, 0.3 of the way from there to the peak has gone
            by since contact;
        tail: a force that only fades takes longer to end than it took to rise.
        worth: the share of third differences that the noise estimate, a median of correlated values, is
            worth.
        above: of the peak: a first sample above it is an offset or late where nothing else can be asked.
        block: so many samples,
        most: and impacts, at a time: their laws' terms then take some hundred megabytes at most.
    """

    median: int = 7
    low: float = 0.2
    foot: float = 0.5
    tail: float = 0.6
    worth: float = 0.3
    above: float = 0.04
    block: int = 200_000
    most: int = 256


PULSE = PulseSettings()


@dataclass(frozen=True)
class SampleSettings:
    """What counts as wrong with samples; fractions are of the peak.

    Attributes:
        alarms: the noise of one sound recording in a thousand alone passes for each kind of finding.
        fewest: samples of a rest in which a slow wave is looked for,
        fewest_of_line: and in which a line is.
        slow: cosines that are a slow wave.
        wave: below it,
        shift: this shift of the zero,
        first: and this first sample, K and C change by less than some 5 %.
        fades: where chance gives less than this a rest after contact is taken for a force that fades.
        passes: a low-pass that passes this many times the frequency of a pulse, 1 over the time to peak,
            moves K and C by a few per cent at most.
        widest: samples of a spike,
        side: and those on either side of it that a line is laid through.
        short: a sound pulse of fewer samples, above ``high`` of its peak, may be missed by a cubic.
        high: a spike of three samples among fifteen until the peak then moves K by some 3 %.
        levels: with fewer steps of the recorder in the peak they are too coarse.
        hum_hz: frequencies that are tried as hum: from, to and in steps of.
        jump: the line before a jump misses so many times more than that behind it.
        fastest: of a decay by e to this power in a sampling interval nothing is left to tell its rate from.
    """

    alarms: float = 1e-3
    fewest: int = 12
    fewest_of_line: int = 6
    slow: int = 5
    wave: float = 0.007
    shift: float = 0.015
    first: float = 0.01
    fades: float = 0.01
    passes: float = 10.0
    widest: int = 3
    side: int = 4
    short: int = 24
    high: float = 0.1
    levels: int = 20
    hum_hz: tuple[float, float, float] = (20.0, 410.0, 5.0)
    jump: float = 2.0
    fastest: float = 1.0


SAMPLES = SampleSettings()


@dataclass(frozen=True)
class LawSettings:
    """By what a trace is no tissue's, or is another's than was declared.

    Attributes:
        alarms: of sound recordings, of each kind of finding.
        misfit: what the laws leave over of the elements' own noise-free traces, as a fraction of the peak.
        velocity: of the velocity: of errors that are nobody's mistake.
        gain: what another gravity, or a low-pass, gains over the best law, in the noise's variance:
            e^(-this / 2) of the likelihood.
        noise_alone: noise alone is left where chance leaves as much in one of a hundred.
        fewest: samples of which another gravity is asked.
        corners: of a low-pass that are tried,
        moments: and moments of contact, from 2.5 of the filter's delays before the first sample on.
    """

    alarms: float = 3e-3
    misfit: float = 0.0015
    velocity: float = 0.02
    gain: float = 30.0
    noise_alone: float = 0.01
    fewest: int = 16
    corners: int = 24
    moments: int = 41


LAW = LawSettings()


@dataclass(frozen=True)
class VelocitySettings:
    """By what recordings contradict the stated velocity.

    Attributes:
        alarms: of a dataset of right velocities: that anything is said.
        steps: fractions of the stated velocity that are tried, in either direction.
        rounds: of Gauss and Newton's way at each,
        small: with derivatives by so small a step,
        ridge: and so much of the diagonal added.
        least: less than this moves K by less than 5 %.
        apart: one impact less than this apart may be one of its own condition.
        unexplained: below this probability no velocity leaves noise alone.
        fewest: samples that tell of the velocity.
        parameters: that are fitted with it.
        majority: of a group's impacts, that some velocity has to explain.
        fewest_impacts: impacts of a person or pad at least, to say that what they share is its law.
        others: impacts of a condition,
        spreads: and of their standard deviations, to say that one lies apart from them.
        of_median: two standard errors of a median, in the spread of what it is of over the root of their
            number.
    """

    alarms: float = 1e-3
    steps: tuple[float, ...] = (0.008, 0.016, 0.03, 0.045, 0.065, 0.09, 0.13, 0.18, 0.25, 0.35, 0.5)
    rounds: int = 4
    small: float = 1e-5
    ridge: float = 1e-3
    least: float = 0.02
    apart: float = 0.08
    unexplained: float = 1e-3
    fewest: int = 12
    parameters: int = 4
    majority: float = 0.5
    fewest_impacts: int = 3
    others: int = 4
    spreads: float = 6.0
    of_median: float = 2.5


VELOCITY = VelocitySettings()


@dataclass(frozen=True)
class BeginningSettings:
    """By what a recording that begins above zero begins after contact, or with an offset.

    Attributes:
        gains: of a sound recording, the probability of another account to gain so much,
        leaves: and of no law to leave so little.
        misfit: what the laws leave of the elements' own traces, over the peak.
        better: so many times less left over explains a trace well enough.
        velocity: the error of the velocity at contact, as a fraction, where no more is declared.
        intervals: earlier contact by so many,
        share: and by this share of the time to peak: less moves C by some 5 %.
        longest: of the time to peak: what is looked back at the most,
        moments: at so many moments.
        offsets: over the peak: less than the least moves K by some 5 % at the most.
        ends: after the peak the fit ends where the force has come down to this share of it: it may let go
            before 0.
        blocks: of samples whose means are fitted.
        rounds: in which the state at the first sample and the law's coefficients are found in turn.
        steps: of Runge and Kutta's rule from contact to the first sample.
        small: the step of a derivative by velocity or offset: one that changes no set of positive
            coefficients.
        parameters: that an account has.
        likely: chi squared of one degree of freedom: less speaks against no account.
    """

    gains: float = 0.03
    leaves: float = 0.001
    misfit: float = 0.0007
    better: float = 4.0
    velocity: float = 0.003
    intervals: float = 1.5
    share: float = 0.015
    longest: float = 0.4
    moments: int = 9
    offsets: tuple[float, ...] = (-0.3, -0.15, -0.05, -0.015, 0.015, 0.05, 0.15, 0.3)
    ends: float = 0.3
    blocks: int = 64
    rounds: int = 3
    steps: int = 4
    small: float = 1e-4
    parameters: int = 4
    likely: float = 3.84


BEGINNING = BeginningSettings()
