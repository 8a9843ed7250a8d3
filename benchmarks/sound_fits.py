"""What a fit says of datasets that obey its model: nothing against it, in how many of forty.

    .venv/bin/python benchmarks/sound_fits.py

Twelve to twenty-four impacts by a spring and damper each, with white noise of 0.2 to 2 % of the peak and
contact at any phase of a sampling interval, at 2 and 5 kHz; in half of them mass, velocity, gain and zero err
as declared. Each goes through the summary path of the model file. And 4,000 impacts at 2 kHz by `estimate`:
how many have p below 0.01, where the model's own noise gives 1 %. It goes to sound_fits.csv, whose lines are
not measured again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from coverage_fit import Fits
from evidence import recorded

import bayestissue as bt
from bayestissue import runtime
from bayestissue.hierarchy.specification import read_specification
from bayestissue.inference.checking.model_form import SMALL_P, judged, with_impacts
from bayestissue.inference.factors.noise_left import noise_p
from bayestissue.inference.results.tree import predicted
from bayestissue.simulation import Simulation, simulate

DATASETS, IMPACTS, FIRST_SEED = 40, 4000, 50_000
RATES_HZ = (2000.0, 5000.0)
CHAIN = {
    "relative_mass_sd": 0.005,
    "velocity_sd_m_s": 0.0075,
    "relative_gain_sd": 0.005,
    "offset_sd_m_s2": 0.2,
}
ROOT = Path(__file__).parents[1]
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


def fitted(number: int, fits: Fits, made: Simulation, *, errs: bool) -> dict[str, Any]:
    """The verdict of one dataset's fit, as `bayestissue fit` has it."""
    prepared = fits.prepared(simulate(made).dataset(made.name))
    draws, _ = fits.fit(prepared, number)
    signal = prepared.signal
    inside = np.arange(signal.x.shape[1]) < signal.n_samples[:, None]
    replicated = predicted(prepared, draws, number)["deceleration"].astype(float)
    form = judged(np.where(inside, signal.deceleration, np.nan), replicated.reshape(-1, *inside.shape))
    middle = np.median(draws.impacts["parameters"].astype(float), axis=(0, 1))
    p = noise_p(prepared.model, prepared.data, middle)
    form = with_impacts(form, prepared.impacts["impact"].astype(str).tolist(), p)
    return {
        "what": f"dataset {number}",
        "rate_hz": made.recording.sampling_rate_hz,
        "errors": errs,
        "impacts": form["impacts"]["tested"],
        "below": form["impacts"]["below"],
        "score": round(form["score"], 2),
        "nothing_against": form["words"].startswith("Nothing against the model"),
    }


def counted(rate: float, impacts: int) -> dict[str, Any]:
    """How many of so many impacts have a small p."""
    made = campaign(FIRST_SEED - 1, rate, errs=True, people=impacts)
    p = bt.estimate(simulate(made).dataset(made.name))["whiteness_p"].to_numpy()
    tested, below = int(np.isfinite(p).sum()), int((p < SMALL_P).sum())
    return {"what": "impacts alone", "rate_hz": rate, "errors": True, "impacts": tested, "below": below}


def measure() -> None:
    """Write the table, each line as soon as it is measured."""
    rows = pd.read_csv(TABLE).to_dict("records") if TABLE.exists() else []
    done = {row["what"] for row in rows}
    if "impacts alone" not in done:
        rows.append(counted(RATES_HZ[0], IMPACTS))
    model = read_specification(ROOT / "models" / "impact.toml")
    fits: dict[int, Fits] = {}
    for number in range(DATASETS):
        people, errs = 2 + number // 2 % 3, number % 4 < 2
        made = campaign(FIRST_SEED + number, RATES_HZ[number % 2], errs=errs, people=people, repeats=2)
        if people not in fits:
            fits[people] = Fits(model, simulate(made).dataset(made.name))
        if f"dataset {number}" not in done:
            rows.append(fitted(number, fits[people], made, errs=errs))
            print(rows[-1], flush=True)
            pd.DataFrame(rows).to_csv(TABLE, index=False)


def main() -> None:
    runtime.configure()
    with recorded("sound_fits"):
        measure()


if __name__ == "__main__":
    main()
