"""The numbers by which recordings are inspected, each with what it was chosen by."""

from __future__ import annotations

from dataclasses import dataclass


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
