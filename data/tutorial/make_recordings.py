"""The recordings of the tutorial, made anew: `python data/tutorial/make_recordings.py FOLDER`.

Simulated: a mass swings from a height of 12 cm against the calf of six people, both sides of each, once with
0.5 kg and once with 1 kg. The operated side is a fourth stiffer than the sound one; the mass changes neither
K nor C.
"""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path

import numpy as np

SEED = 12
PEOPLE, SIDES, MASSES = ("p1", "p2", "p3", "p4", "p5", "p6"), ("sound", "operated"), (0.5, 1.0)
STIFFER = {"sound": 1.0, "operated": 1.25}
K, C = 2400.0, 22.0  # N/m, N s/m of the sound side of a typical person
SD_PERSON, SD_IMPACT = 0.2, 0.04
GRAVITY, HEIGHT = 9.80665, 0.12
RATE, BEFORE, SAMPLES = 5000.0, 0.012, 400
RELATIVE_MASS_SD, VELOCITY_SD, RELATIVE_GAIN_SD = 0.002, 0.01, 0.005
OFFSET_SD, NOISE_SD = 0.1, 0.3  # m/s²

HEAD = """LabVIEW Measurement
Writer_Version	2
Reader_Version	2
Separator	Tab
Decimal_Separator	.
Multi_Headings	No
X_Columns	One
Time_Pref	Relative
Operator	Simulated
Date	2026/11/02
***End_of_Header***

Channels	1
Samples	{samples}
Y_Unit_Label	g
X_Dimension	Time
X0	0.0
Delta_X	{step:.9g}
***End_of_Header***
X_Value	Impact	Comment
"""


def deceleration(time, stiffness, damping, mass, velocity):
    """Force over mass, m/s², of a spring and damper that is met at time 0 and never pulls."""
    decay = damping / (2 * mass)
    frequency = np.sqrt(stiffness / mass - decay**2)
    since = np.maximum(time, 0)
    swing = velocity * np.exp(-decay * since)
    depth = swing * np.sin(frequency * since) / frequency
    speed = swing * (np.cos(frequency * since) - decay / frequency * np.sin(frequency * since))
    force = np.maximum(stiffness * depth + damping * speed, 0)
    released = np.logical_or.accumulate((since > 0) & (force == 0))
    return np.where((time < 0) | released, 0, force / mass)


def main(folder: Path) -> None:
    """Write one .lvm file for each person, side and mass into ``folder``."""
    rng = np.random.default_rng(SEED)
    folder.mkdir(parents=True, exist_ok=True)
    own = {person: np.exp(SD_PERSON * rng.standard_normal(2)) for person in PEOPLE}
    for person, side, mass in product(PEOPLE, SIDES, MASSES):
        of_impact = np.exp(SD_IMPACT * rng.standard_normal(2))
        stiffness, damping = np.array([K * STIFFER[side], C]) * own[person] * of_impact
        velocity = np.sqrt(2 * GRAVITY * HEIGHT) + VELOCITY_SD * rng.standard_normal()
        true_mass = mass * (1 + RELATIVE_MASS_SD * rng.standard_normal())
        time = np.arange(SAMPLES) / RATE
        contact = BEFORE + rng.uniform() / RATE
        value = deceleration(time - contact, stiffness, damping, true_mass, velocity)
        value = value * (1 + RELATIVE_GAIN_SD * rng.standard_normal()) + OFFSET_SD * rng.standard_normal()
        value = (value + NOISE_SD * rng.standard_normal(SAMPLES)) / GRAVITY
        rows = "".join(f"{t:.4f}\t{v:.4f}\n" for t, v in zip(time, value, strict=True))
        text = HEAD.format(samples=SAMPLES, step=1 / RATE) + rows
        (folder / f"{person}_{side}_{mass}kg.lvm").write_text(text, encoding="utf-8", newline="")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
