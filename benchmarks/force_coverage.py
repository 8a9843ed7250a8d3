"""How often intervals hold the truth where a force was recorded beside the deceleration: simulated, fitted.

    .venv/bin/python benchmarks/force_coverage.py
    .venv/bin/python benchmarks/force_coverage.py 20

Studies of four people hit with four masses, every second one along gravity. All declared masses are
wrong by one factor, known to 5 %; the accelerometer's gain is known to 0.5 % and the load cell's to 1 %, one
gain of the load cell a study. Of three studies one has a force plate below the tissue, two a load cell with
50 g in front of it. Noted of each are the 90 % intervals of the factor, of both gains, of K, C and the mass
of each impact and of the mass exponents, how far the masses are off, and whether the first line says so.

A number is of the studies to do in all; those that were done are not done again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import gmean
from studies import Fitted, Interval, counted, ends, fitted, sides

from bayestissue.inference.checking.mass_checks import judge_force
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.studies.simulation import Simulation, simulate

MASSES_KG, VELOCITY = (0.5, 0.7, 0.9, 1.2), 1.4
MASS_SD, GAIN_SD, FORCE_GAIN_SD, VELOCITY_SD = 0.05, 0.005, 0.01, 0.005
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m", "mass": "mass_kg"}
# A share of 90 % of their intervals is known to about 2 %.
STUDIES = 200


def study(number: int) -> Simulation:
    """One study; its random numbers, the masses' factor among them, follow from its number."""
    factor = float(np.exp(MASS_SD * np.random.default_rng([number, 11]).standard_normal()))
    plate = number % 3 == 0
    force = {
        "noise_relative_to_peak": 0.01,
        "relative_gain_sd": FORCE_GAIN_SD,
        "offset_sd_N": 0.3,
        "place": "base" if plate else "impactor",
    } | ({} if plate else {"tip_mass_kg": 0.05})
    spread = {f"sd_{of}_{name}": sd for of, sd in (("subject", 0.2), ("impact", 0.05)) for name in "KC"}
    return Simulation.model_validate(
        {
            "name": "force",
            "seed": number,
            "gravity": "drop" if number % 2 else "none",
            "design": {
                "subjects": 4,
                "conditions": [
                    {"trial": f"{mass} kg", "mass_kg": mass, "velocity_m_s": VELOCITY} for mass in MASSES_KG
                ],
            },
            "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, **spread},
            "recording": {
                "sampling_rate_hz": 5000.0,
                "noise_relative_to_peak": 0.005,
                "relative_gain_sd": GAIN_SD,
                "velocity_sd_m_s": VELOCITY_SD,
                "relative_mass_sd": 0.002,
                "mass_factor": factor,
                "force": force,
            },
        }
    )


def intervals(fit: Fitted, truth: pd.DataFrame, simulation: Simulation) -> Iterator[Interval]:
    """Of each quantity the ends and the truth."""
    of, posterior = str(simulation.recording.force.place), fit.posterior
    common = {
        "mass_factor": simulation.recording.mass_factor,
        "gain_factor": truth["force_gain"].iloc[0] / gmean(truth["gain"]),
        "mass_exponent_K": 0.0,
        "mass_exponent_C": 0.0,
    }
    for name, true in common.items():
        yield Interval(of, name, ends(posterior[name]), true)
    for name, column in COLUMNS.items():
        yield Interval(of, name, ends(posterior[name]), truth[column].to_numpy())


def row_of(number: int) -> dict[str, Any]:
    """What is kept of a study."""
    made = simulate(simulation := study(number))
    declared = Uncertainty(
        relative_mass_sd=MASS_SD, velocity_sd_m_s=VELOCITY_SD, relative_gain_sd=GAIN_SD, offset_sd=0.0
    )
    fit = fitted(made.dataset(simulation.name).with_settings(uncertainty=declared), number)
    force = fit.prepared.force
    assert force is not None
    account = judge_force(force, "force", fit.posterior, fit.prepared.signal.mass)
    off = abs(simulation.recording.mass_factor - 1)
    row = sides(intervals(fit, made.truth, simulation))
    return row | {"passed": fit.passed, "off": off, "named": bool(account["first"])}


def main() -> None:
    counted("coverage_channels-force", row_of, STUDIES)


if __name__ == "__main__":
    main()
