"""How often the intervals of `bayestissue fit` hold the truth where each mechanical element made the data.

    .venv/bin/python benchmarks/coverage_elements.py maxwell
    .venv/bin/python benchmarks/coverage_elements.py all --campaigns 10

Each campaign has five people in four conditions, 0.375 to 1.333 kg at 5 kHz, and mass exponents of its
own, drawn from N(0.5, 0.3); the accelerometer and its errors are those of coverage_fit.py. It goes through
the summary path of the element's own model file, and on to the exact one where its correction can't be
trusted, as `fit` does. 50 campaigns have 1000 impacts. The table goes to coverage_elements.csv.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from coverage_fit import LEVELS, Fits, campaign, kept_with, summarised
from evidence import recorded
from evidence.references import TISSUES

from bayestissue import runtime
from bayestissue.elements import element, element_names
from bayestissue.hierarchy.specification import read_specification
from bayestissue.inference.samplers.sampling import ConstrainedDraws
from bayestissue.simulation import Simulation, simulate

CAMPAIGNS = 50
ROOT = Path(__file__).parents[1]
TABLE = ROOT / "benchmarks" / "coverage_elements.csv"
FILES = {"kelvin_voigt": "impact"}


def campaign_of(name: str, seed: int) -> Simulation:
    """One campaign of `coverage_fit`, on another element, and with conditions that all elements bear."""
    made = campaign(seed).model_dump(mode="json")
    exponents = np.random.default_rng([seed, 8]).normal(0.5, 0.3, 2)
    made["tissue"] |= {"mass_exponent_K": exponents[0], "mass_exponent_C": exponents[1]}
    made["tissue"] |= {"sd_trial_K": 0.05, "sd_trial_C": 0.05, "element": name, **TISSUES[name]}
    if element(name).extra:
        made["tissue"]["sd_impact_parameters"] = 0.05
    return Simulation.model_validate(made)


def rows_of(
    found: ConstrainedDraws, truth: pd.DataFrame, made: Simulation, number: int
) -> list[dict[str, Any]]:
    """One row per quantity, impact and level: does the interval hold the truth, how wide, how far off."""
    columns = {"K": "K_N_per_m", "C": "C_N_s_per_m", "K_secant": "K_secant_N_per_m"}
    columns |= {"C_equivalent": "C_equivalent_N_s_per_m", "energy_lost": "energy_lost"}
    columns |= {name: name for name in made.tissue.parameters}
    quantities = {
        name: (found.impacts[name], truth[column].to_numpy())
        for name, column in columns.items()
        if column in truth and name in found.impacts
    }
    for q in ("K", "C"):
        true = np.array([getattr(made.tissue, f"mass_exponent_{q}")])
        quantities[f"mass_exponent_{q}"] = (found.sites[f"mass_exponent_{q}"][..., None], true)
    rows = []
    for name, (values, true) in quantities.items():
        flat = values.reshape(-1, values.shape[-1])
        scale = np.ones(1) if name.startswith("mass_exponent") else true
        off = np.abs(np.median(flat, axis=0) - true) / scale
        for level in LEVELS:
            low, high = np.quantile(flat, [0.5 - level / 200, 0.5 + level / 200], axis=0)
            held = (low <= true) & (true <= high)
            for h, o, w in zip(held, off, (high - low) / scale, strict=True):
                row = {"campaign": number, "quantity": name, "level": level, "held": h, "off": o, "width": w}
                rows.append(row)
    return rows


def measured(name: str, campaigns: int, seconds: float) -> tuple[pd.DataFrame, list[float]]:
    """Every row of every campaign that was begun in time, and the Pareto k of each."""
    model = ROOT / "models" / f"{FILES.get(name, name)}.toml"
    fits = Fits(read_specification(model), simulate(campaign_of(name, 0)).dataset("first"), exact=True)
    begun, rows, pareto = time.perf_counter(), [], []
    for number in range(campaigns):
        if time.perf_counter() - begun > seconds:
            break
        made = campaign_of(name, number)
        result = simulate(made)
        found, correction = fits.fit(fits.prepared(result.dataset(made.name)), number)
        rows += rows_of(found, result.truth, made, number)
        pareto.append(correction.pareto_k)
        path = "" if correction.trusted else ", the last by the exact path"
        print(f"{name}: {number + 1} campaigns, {time.perf_counter() - begun:.0f} s{path}", flush=True)
    return pd.DataFrame(rows), pareto


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("element", choices=(*element_names(), "all"))
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS)
    parser.add_argument("--seconds", type=float, default=np.inf, help="begin no campaign after these")
    asked = parser.parse_args()
    runtime.configure(one_core=True)
    for name in element_names() if asked.element == "all" else (asked.element,):
        with recorded(f"coverage_elements-{name}", f"benchmarks/coverage_elements.py {name}") as record:
            rows, pareto = measured(name, asked.campaigns, asked.seconds)
            # What is compiled for all six takes more mapped memory than a process may have.
            jax.clear_caches()
            if len(pareto) < CAMPAIGNS:
                record.left = f"{CAMPAIGNS - len(pareto)} of {CAMPAIGNS} campaigns"
            command = f"benchmarks/coverage_elements.py {name} --campaigns {len(pareto)}"
            lines = summarised(name, rows, pareto, command).rename(columns={"likelihood": "element"})
            kept_with(TABLE, lines, "element")


if __name__ == "__main__":
    main()
