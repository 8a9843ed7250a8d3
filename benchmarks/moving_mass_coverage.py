"""How often intervals hold the truth where tissue moves along: simulated, fitted by moving_mass.

    .venv/bin/python benchmarks/moving_mass_coverage.py
    .venv/bin/python benchmarks/moving_mass_coverage.py 18

Studies, in turn of three kinds: a force plate below the tissue and two masses; the accelerometer
alone and two masses; the accelerometer alone, one mass, and a velocity that is known to 30 % only. m is drawn
between 0.03 and 0.3 kg. One error of velocity and of the plate's gain is common to all impacts of a study.
Noted are the 90 % intervals of K, C and m of each impact, and whether the fit says that m's mean is known.

A number is of the studies to do in all; those that were done are not done again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from studies import Fitted, Interval, counted, ends, fitted, of_draws, sides

import bayestissue as bt
from bayestissue.inference.checking.mass_checks import judge_added_mass
from bayestissue.inference.quantities.quantity_draws import prior_draws
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.studies.simulation import Campaign, Simulation, simulate

KINDS = ("force", "velocity", "neither")
MASSES_KG, VELOCITY = (0.5, 1.0), 1.5
GAIN_SD, FORCE_GAIN_SD, VELOCITY_SD, HARDLY = 0.005, 0.01, 0.01, 0.3
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m", "moving_mass_kg": "moving_mass_kg"}
# A share of 90 % of the intervals of one kind is known to 4 %.
STUDIES = 60


def study(number: int) -> Simulation:
    """One study; its random numbers follow from its number."""
    random, kind = np.random.default_rng([number, 17]), KINDS[number % len(KINDS)]
    force = {"noise_relative_to_peak": 0.005, "relative_gain_sd": FORCE_GAIN_SD, "place": "base"}
    masses = MASSES_KG if kind != "neither" else MASSES_KG[:1] * 2
    spread = {f"sd_{of}_{name}": sd for of, sd in (("subject", 0.2), ("impact", 0.05)) for name in "KC"}
    # What all impacts share of the velocity's error: the stated one is 1.5 m/s.
    shared = (HARDLY / 3 if kind == "neither" else VELOCITY_SD) * random.standard_normal()
    conditions = [
        {"trial": f"t{k}", "mass_kg": mass, "velocity_m_s": VELOCITY * (1 + shared)}
        for k, mass in enumerate(masses)
    ]
    return Simulation.model_validate(
        {
            "name": kind,
            "seed": number,
            "design": {"subjects": 3, "conditions": conditions},
            "tissue": {
                "K_N_per_m": 3000.0,
                "C_N_s_per_m": 25.0,
                "element": "moving_mass",
                "parameters": {"moving_mass_kg": float(0.03 * 10 ** random.uniform())},
                "sd_impact_parameters": 0.1,
                **spread,
            },
            "recording": {
                "sampling_rate_hz": 5000.0,
                "noise_relative_to_peak": 0.005,
                "relative_mass_sd": 0.002,
                **({"force": force} if kind == "force" else {}),
            },
        }
    )


def recorded(made: Campaign, kind: str) -> bt.Dataset:
    """The dataset as the lab has it: the velocity that it aimed at, and what it declares."""
    dataset = made.dataset(kind)
    velocity_sd = VELOCITY * (HARDLY if kind == "neither" else VELOCITY_SD)
    impacts = dataset.impacts.assign(velocity_m_s=VELOCITY)
    return replace(dataset, impacts=impacts).with_settings(
        uncertainty=Uncertainty(
            relative_mass_sd=0.002, velocity_sd_m_s=velocity_sd, relative_gain_sd=GAIN_SD, offset_sd=0.0
        )
    )


def intervals(fit: Fitted, truth: pd.DataFrame, kind: str) -> Iterator[Interval]:
    """Of each quantity the ends and the truth."""
    for name, column in COLUMNS.items():
        yield Interval(kind, name, ends(fit.posterior[name]), truth[column].to_numpy())


def row_of(number: int) -> dict[str, Any]:
    """What is kept of a study."""
    made = simulate(simulation := study(number))
    fit = fitted(recorded(made, simulation.name), number, {"like": "moving_mass"})
    of_prior = prior_draws(fit.prepared, number, np.random.default_rng(number))
    account = judge_added_mass(fit.prepared, fit.posterior, of_draws(fit.prepared, of_prior, number))
    row = sides(intervals(fit, made.truth, simulation.name))
    return row | {"passed": fit.passed, "kind": simulation.name, "told": account["passed"]}


def main() -> None:
    counted("coverage_channels-moving_mass", row_of, STUDIES)


if __name__ == "__main__":
    main()
