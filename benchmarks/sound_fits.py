"""What a fit says of datasets that obey its model: nothing against it, in how many of forty.

    .venv/bin/python benchmarks/sound_fits.py

Twelve to twenty-four impacts by a spring and damper each, with white noise of 0.2 to 2 % of the peak and
contact at any phase of a sampling interval, at 2 and 5 kHz; in half of them mass, velocity, gain and zero err
as declared. Each goes through `bayestissue.fit` as it is. Then 4,000 impacts at 2 kHz by `estimate`: how many
have p below 0.01, where the model's own noise gives 1 %. It goes to sound_fits.csv.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from evidence import recorded

import bayestissue as bt
from bayestissue import runtime
from bayestissue.inference.checking.model_form import SMALL_P
from bayestissue.simulation import Simulation, simulate

DATASETS, IMPACTS, FIRST_SEED = 40, 4000, 50_000
RATES_HZ = (2000.0, 5000.0)
CHAIN = {
    "relative_mass_sd": 0.005,
    "velocity_sd_m_s": 0.0075,
    "relative_gain_sd": 0.005,
    "offset_sd_m_s2": 0.2,
}
TABLE = Path(__file__).with_suffix(".csv")


def campaign(seed: int, rate: float, *, errs: bool, people: int, repeats: int = 1) -> Simulation:
    """People hit with three masses, or with the middle one alone where there are thousands."""
    noise = float(np.exp(np.random.default_rng([seed, 9]).uniform(np.log(0.002), np.log(0.02))))
    masses = (0.5, 0.7, 1.0) if people < DATASETS else (0.7,)
    conditions = [{"trial": f"{mass} kg", "mass_kg": mass, "velocity_m_s": 1.5} for mass in masses]
    spread = {f"sd_{level}_{name}": 0.15 for level in ("subject", "impact") for name in "KC"}
    return Simulation.model_validate(
        {
            "name": "sound",
            "seed": seed,
            "design": {"subjects": people, "conditions": conditions, "repeats": repeats},
            "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, **spread},
            "recording": {
                "sampling_rate_hz": rate,
                "noise_relative_to_peak": noise,
                **(CHAIN if errs else {}),
            },
        }
    )


def fitted(number: int) -> dict[str, Any]:
    """The verdict of one dataset's fit."""
    rate, errs = RATES_HZ[number % 2], number % 4 < 2
    made = campaign(FIRST_SEED + number, rate, errs=errs, people=2 + number % 3, repeats=2)
    form = bt.fit(simulate(made).dataset(made.name), "impact").diagnostics["model_form"]
    of = form["impacts"]
    return {
        "what": "dataset",
        "rate_hz": rate,
        "errors": errs,
        "impacts": of["tested"],
        "below": of["below"],
        "score": round(form["score"], 2),
        "nothing_against": form["words"].startswith("Nothing against the model"),
    }


def counted(rate: float, impacts: int) -> dict[str, Any]:
    """How many of so many impacts have a small p."""
    made = campaign(FIRST_SEED - 1, rate, errs=True, people=impacts)
    p = bt.estimate(simulate(made).dataset(made.name))["whiteness_p"].to_numpy()
    below = int((p < SMALL_P).sum())
    return {
        "what": "impacts",
        "rate_hz": rate,
        "errors": True,
        "impacts": int(np.isfinite(p).sum()),
        "below": below,
    }


def measure(datasets: int, impacts: int) -> None:
    """Write the table."""
    rows = [counted(rate, impacts) for rate in RATES_HZ[: 1 if impacts else 0]]
    for row in rows:
        print(row, flush=True)
    for number in range(datasets):
        rows.append(fitted(number))
        print(rows[-1], flush=True)
    pd.DataFrame(rows).to_csv(TABLE, index=False)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=int, default=DATASETS)
    parser.add_argument("--impacts", type=int, default=IMPACTS)
    asked = parser.parse_args()
    runtime.configure()
    with recorded("sound_fits"):
        measure(asked.datasets, asked.impacts)


if __name__ == "__main__":
    main()
