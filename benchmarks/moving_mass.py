"""How often intervals hold the truth where tissue moves along: simulated, fitted by moving_mass.

    .venv/bin/python benchmarks/moving_mass.py 60

So many studies, in turn of three kinds: a force plate below the tissue and two masses; the accelerometer
alone and two masses; the accelerometer alone, one mass, and a velocity that is known to 30 % only. m is drawn
between 0.03 and 0.3 kg. One error of velocity and of the plate's gain is common to all impacts of a study.
Noted are the 90 % intervals of K, C and m of each impact, and of m's mean the overlap with its prior and
whether the first line names it.

Rows are added to results/moving_mass.csv, study by study: a script that is stopped goes on where it was.
The shares that held are printed, with standard errors over studies.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pandas as pd
from studies import shares_held, studied

import bayestissue as bt
from bayestissue.dataset.chain import Uncertainty
from bayestissue.simulation import Campaign, Simulation, simulate

KINDS = ("force", "velocity", "neither")
MASSES_KG, VELOCITY = (0.5, 1.0), 1.5
GAIN_SD, FORCE_GAIN_SD, VELOCITY_SD, HARDLY = 0.005, 0.01, 0.01, 0.3
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m", "moving_mass_kg": "moving_mass_kg"}
LEVEL = 0.9
MODEL = {"like": "moving_mass", "sampler": {"draws": 500}}


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
    return replace(dataset, impacts=impacts, uncertainty=Uncertainty(0.002, velocity_sd, GAIN_SD, 0.0))


def intervals(number: int) -> pd.DataFrame:
    """A row an interval: of what, its ends, the truth."""
    made = simulate(simulation := study(number))
    kind = simulation.name
    fit = bt.fit(recorded(made, kind), MODEL, seed=number)
    posterior = fit.posterior["posterior"].dataset
    ends = posterior[list(COLUMNS)].quantile([(1 - LEVEL) / 2, (1 + LEVEL) / 2], ("chain", "draw"))
    parts = []
    for name, column in COLUMNS.items():
        low, high = ends[name].transpose("quantile", ...).to_numpy()
        truth = made.truth[column].to_numpy()
        parts += [pd.DataFrame({"of": f"{name}, {kind}", "low": low, "high": high, "truth": truth})]
    added = fit.diagnostics["added_mass"]
    first = added["first"] in fit.about["verdict"]["headline"] if added["first"] else True
    return pd.concat(parts).assign(
        passed=fit.diagnostics["passed"], overlap=added["overlap"], told=added["passed"], said=first
    )


def main() -> None:
    rows = studied("moving_mass", int(sys.argv[1]), intervals)
    print(shares_held(rows).round(3).to_string())
    half = (rows["high"] - rows["low"]) / 2 / rows["truth"]
    print(half.groupby(rows["of"], sort=False).median().round(3).to_string())
    apart = rows[rows["of"].str.startswith("moving_mass_kg")].drop_duplicates("unit")
    by_kind = apart.groupby("of", sort=False)[["passed", "overlap", "told", "said"]].mean()
    print(by_kind.round(3).to_string())


if __name__ == "__main__":
    main()
