"""The numbers that answers are made with, each with what it was chosen by."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AnswerSettings:
    """How much is compared, tried, simulated and shown.

    Attributes:
        in_pairs: of so many levels each is compared with each; of more, 66 ratios and above, each with the
            mean of all.
        compared: of more levels or combinations, nobody goes through a table of ratios.
        same_mass: difference of the log of masses below which two conditions have one mass. Impactors are
            weighed to better than 1 %, and masses that are chosen differ by more.
        rounding: of the greater side; two sides that differ by less are the same, as no parameter of a fit is
            known so well.
        changed: of what is compared; where parameters change by about 1, a smaller change is rounding.
        columns_tried: of the columns of a question, the first so many are tried as terms that a formula
            lacks: products of up to three of six are 41.
        together: impacts of a curve.
        at_once: impacts that are simulated at once, by code that is compiled for this number alone.
        simulated: impacts in all, draws evenly left out.
        of_a_condition: draws at the least that a condition keeps of these: 5 % quantiles of so many have a
            standard error of a tenth of the standard deviation.
        predicted: draws of new impacts that are there at once, some hundred megabytes with all quantities.
        pictured: draws behind a picture, at the least and at the most: the ends of its band then have a
            standard error of a fifth to a tenth of the standard deviation.
        places: of a loop of force over depth, on the way in and on the way out.
        loops_together: loops that are simulated at once, as of ``at_once``.
        motions: of a picture, the measured masses and velocities; a fourth panel would be too small to read.
        pictured_levels: of a picture, as there are colours that all eyes tell apart.
        same_motion: difference of the log of masses or velocities below which two are drawn as one.
        beyond: by which a picture goes on below the least and above the greatest velocity measured, the
            latter that of one and a half times the height.
        pictured_velocities: of a curve, two of them beyond those measured; it is nearly straight.
        reached: share of the draws that have a depth at a time, from which a loop has their median there.
        likeness: of a name that was not measured to one that was, as `difflib` has it, from which it looks
            like a slip.
        largest: number of kg, m/s or m in a table of conditions; no impactor is so heavy, fast or wide.
        deeper: by so much of the depth that was measured an impact goes deeper before it is said: depths of
            impacts that are alike scatter by some per cent.
        slowest: velocity in m/s from which a claim is followed upwards; a drop from 5 mm has 0.3.
        fastest: to which it is followed; that of a drop from 46 m.
        velocities: at which it is judged, each about twice the last.
        tried: draws in which it is judged at all of these; in the others its end is sought near to theirs.
        of_velocity: relative change of a velocity that is solved for, at which it is taken: the error is then
            that of a secant's next step.
        tried_before: draws of the prior in which it is solved for: all that is asked of them is whether they
            are like the posterior's.
        listed: levels or columns in a message, as many as a line can show.
        around_slip: characters of a question before and after a slip, together a line.
    """

    in_pairs: int = 12
    compared: int = 400
    same_mass: float = 0.01
    rounding: float = 1e-9
    changed: float = 1e-6
    columns_tried: int = 6
    together: int = 4096
    at_once: int = 512
    simulated: int = 20_000
    of_a_condition: int = 500
    predicted: int = 2_000_000
    pictured: tuple[int, int] = (120, 400)
    places: int = 33
    loops_together: int = 1024
    motions: int = 3
    pictured_levels: int = 6
    same_motion: float = 0.02
    beyond: tuple[float, float] = (0.8, 1.25)
    pictured_velocities: int = 6
    reached: float = 0.95
    likeness: float = 0.7
    largest: float = 1e4
    deeper: float = 0.05
    slowest: float = 0.01
    fastest: float = 30.0
    velocities: int = 13
    tried: int = 39
    of_velocity: float = 1e-6
    tried_before: int = 256
    listed: int = 8
    around_slip: int = 60


SETTINGS = AnswerSettings()
