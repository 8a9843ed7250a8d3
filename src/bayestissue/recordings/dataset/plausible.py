"""What an impact on tissue, and what is stated of it, can be at all: beyond it a unit or a sign is wrong."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlausibleSettings:
    """The bounds by which recordings and statements are refused.

    Attributes:
        most_sd: of a quantity: with half of it as its standard deviation, none of it at all lies within two
            of them.
        most_gravity: more than gravity is anywhere on Earth, m/s²: a greater number has another unit.
        largest_covariate: a model squares what it is given.
        apart: the masses, velocities or heights of one study do not leave a gap of this factor.
        fall_off: of a velocity after a fall: friction takes less.
        begins: a recording has begun to go somewhere where it is this share of its farthest way from where it
            began.
        pulse: of the greatest deceleration: what is above it belongs to the pulse.
        fall_within: of the velocity at contact, that a recording may end before it is lost; of the greatest
            displacement, from which on the mean speed is counted.
        slowest: times the corner of a low-pass: its answer, of the second order, to the shortest blow of all
            rises for 0.17 over its corner.
        gone: of the greatest value: a recording that ends below it shows the whole force.
        amid: of the greatest value: more than contact's jump is, of a tissue that is not next to all damper.
        longest_step_s: an impact on tissue lasts some hundredths of a second: longer steps hold no eight
            samples of it.
        shortest_s: no recording of one is shorter.
        deepest_m: no tissue is deeper.
        mean_speed: from ``fall_within`` of the greatest displacement to the greatest, over that at contact.
        about_g: a sensor that is held, or falls, reads g so closely,
        held_s: and for longer than any impact lasts.
    """

    most_sd: float = 0.5
    most_gravity: float = 9.9
    largest_covariate: float = 1e30
    apart: float = 50.0
    fall_off: float = 0.05
    begins: float = 0.1
    pulse: float = 0.1
    fall_within: float = 0.05
    slowest: float = 0.15
    gone: float = 0.1
    amid: float = 0.6
    longest_step_s: float = 0.02
    shortest_s: float = 1e-4
    deepest_m: float = 1.0
    mean_speed: tuple[float, float] = (0.03, 3.0)
    about_g: float = 0.1
    held_s: float = 0.1


PLAUSIBLE = PlausibleSettings()
