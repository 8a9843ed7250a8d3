"""How often intervals hold the truth where a phantom of known stiffness was hit too: simulated, fitted.

    .venv/bin/python benchmarks/phantom_coverage.py
    .venv/bin/python benchmarks/phantom_coverage.py 8

Studies of four people hit with two masses, beside eight impacts of one spring of 2500 N/m known to 1 %. By
turns the declared masses are 6 % too small, or the accelerometer reads 6 % too much, with people of damping
ratio 0.1 or 0.4; mass and gain are declared to 5 %. Noted are the 90 % intervals of K and C of each impact,
by the fit with the phantom and by one of the people alone.

A number is of the studies to do in all; those that were done are not done again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from studies import Interval, counted, ends, fitted, sides

import bayestissue as bt
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.recordings.dataset.impact_table import REFERENCE
from bayestissue.studies.simulation import Simulation, simulate

MASSES_KG, VELOCITY, OFF = (0.5, 1.0), 1.4, 1.06
DECLARED = Uncertainty(relative_mass_sd=0.05, velocity_sd_m_s=0.005, relative_gain_sd=0.05, offset_sd=0.0)
PHANTOM_K, PHANTOM_SD, PHANTOM_C = 2500.0, 25.0, 6.0
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
# Four kinds: a share of 90 % of the intervals of one is known to 7 %.
STUDIES = 80
KINDS = [(of, C) for of in ("mass", "gain") for C in (10.0, 35.0)]


def campaign(number: int, people: int, factor: float, tissue: dict[str, float], name: str) -> Simulation:
    """People, or a phantom, hit with both masses."""
    return Simulation.model_validate(
        {
            "name": name,
            "seed": number,
            "design": {
                "subjects": people,
                "conditions": [
                    {"trial": f"{mass} kg", "mass_kg": mass, "velocity_m_s": VELOCITY} for mass in MASSES_KG
                ],
            },
            "tissue": tissue,
            "recording": {
                "sampling_rate_hz": 5000.0,
                "noise_relative_to_peak": 0.005,
                "velocity_sd_m_s": DECLARED.velocity_sd_m_s,
                "mass_factor": factor,
            },
        }
    )


def study(number: int) -> tuple[bt.Dataset, pd.DataFrame]:
    """People and a phantom, and the people's truth; all random numbers follow from the study's number."""
    of, C = KINDS[number % len(KINDS)]
    rng = np.random.default_rng([number, 7])
    factor, gain = (OFF, 1.0) if of == "mass" else (1.0, OFF)
    spread = {f"sd_{level}_{name}": sd for level, sd in (("subject", 0.2), ("impact", 0.05)) for name in "KC"}
    tissue = {"K_N_per_m": 3000.0, "C_N_s_per_m": C, **spread}
    spring = {"K_N_per_m": PHANTOM_K, "C_N_s_per_m": PHANTOM_C}
    made = [
        simulate(campaign(2 * number + which, 4, factor, what, name))
        for which, (name, what) in enumerate((("people", tissue), ("phantom", spring)))
    ]
    stated = PHANTOM_K + PHANTOM_SD * rng.standard_normal()
    impacts, traces = [], []
    for name, one, known in zip(("people", "phantom"), made, (None, stated), strict=True):
        part = one.dataset(name)
        table = part.impacts.assign(impact=name + "-" + part.impacts["impact"].astype(str))
        table["subject"] = table["subject"] if known is None else "phantom"
        table[list(REFERENCE)] = (np.nan, np.nan) if known is None else (known, PHANTOM_SD)
        impacts.append(table)
        traces += [
            pd.DataFrame({"impact": impact, "time_s": trace.time_s, "value": gain * trace.value})
            for impact, trace in zip(table["impact"], part.traces, strict=True)
        ]
    dataset = bt.dataset(
        pd.concat(impacts, ignore_index=True),
        pd.concat(traces, ignore_index=True),
        quantity="deceleration",
        unit="m/s^2",
        uncertainty=DECLARED,
    )
    truth = made[0].truth
    return dataset, truth.assign(impact="people-" + truth["impact"].astype(str)).set_index("impact")


def alone(dataset: bt.Dataset) -> bt.Dataset:
    """The people of the study."""
    of_people = dataset.select(dataset.impacts[REFERENCE[0]].isna().to_numpy())
    impacts = of_people.impacts.drop(columns=list(REFERENCE)).reset_index(drop=True)
    return replace(of_people, impacts=impacts)


def row_of(number: int) -> dict[str, Any]:
    """What is kept of a study."""
    dataset, truth = study(number)
    fits = {"with": fitted(dataset, number), "without": fitted(alone(dataset), number)}

    def intervals() -> Iterator[Interval]:
        for which, fit in fits.items():
            of = f"{KINDS[number % len(KINDS)][0]} off, {which} the spring"
            names = fit.posterior["impact"].to_numpy().astype(str)
            for name, column in COLUMNS.items():
                yield Interval(of, name, ends(fit.posterior[name]), truth[column].loc[names].to_numpy())

    return sides(intervals()) | {"passed": all(fit.passed for fit in fits.values())}


def main() -> None:
    counted("coverage_phantoms", row_of, STUDIES)


if __name__ == "__main__":
    main()
