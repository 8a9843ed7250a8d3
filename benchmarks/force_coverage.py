"""How often intervals hold the truth where a force was recorded beside the deceleration: simulated, fitted.

    .venv/bin/python benchmarks/force_coverage.py 200

So many studies of four people hit with four masses, every second one along gravity. All declared masses are
wrong by one factor, known to 5 %; the accelerometer's gain is known to 0.5 % and the load cell's to 1 %, one
gain of the load cell a study. Of three studies one has a force plate below the tissue, two a load cell with
50 g in front of it. Noted of each are the 90 % intervals of the factor, of K, C and the mass of each impact,
and whether the first line says that masses are off.

Rows are added to results/force_coverage.csv, study by study: a script that is stopped goes on where it was.
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
from bayestissue.simulation import Simulation, simulate

MASSES_KG, VELOCITY = (0.5, 0.7, 0.9, 1.2), 1.4
MASS_SD, GAIN_SD, FORCE_GAIN_SD, VELOCITY_SD = 0.05, 0.005, 0.01, 0.005
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m", "mass": "mass_kg"}
LEVEL = 0.9


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


def intervals(number: int) -> pd.DataFrame:
    """A row an interval: of what, its ends, the truth."""
    made = simulate(simulation := study(number))
    declared = Uncertainty(MASS_SD, VELOCITY_SD, GAIN_SD, 0.0)
    fit = bt.fit(replace(made.dataset(simulation.name), uncertainty=declared), seed=number)
    posterior = fit.posterior["posterior"].dataset
    truth = made.truth.set_index("impact")
    ends = posterior[["mass_factor", *COLUMNS]].quantile(
        [(1 - LEVEL) / 2, (1 + LEVEL) / 2], ("chain", "draw")
    )
    parts = [pd.DataFrame({"of": ["mass_factor"], "truth": simulation.recording.mass_factor})]
    parts += [pd.DataFrame({"of": name, "truth": truth[column]}) for name, column in COLUMNS.items()]
    found = [
        ends[name].transpose("quantile", ...).to_numpy().reshape(2, -1) for name in ("mass_factor", *COLUMNS)
    ]
    rows = [part.assign(low=low, high=high) for part, (low, high) in zip(parts, found, strict=True)]
    said = bool(fit.about["verdict"]["headline"].count("mass"))
    return pd.concat(rows).assign(passed=fit.diagnostics["passed"], said=said)


def main() -> None:
    rows = studied("force_coverage", int(sys.argv[1]), intervals)
    print(shares_held(rows))
    apart = rows[rows["of"] == "mass_factor"]
    print(f"passed {apart['passed'].mean():.3f}, masses named in the first line {apart['said'].mean():.3f}")


if __name__ == "__main__":
    main()
