"""How often the 90 % interval of K's mass exponent holds 0 where the tissue's law is the same for every mass.

    .venv/bin/python benchmarks/common_depth.py stiffening
    .venv/bin/python benchmarks/common_depth.py hunt_crossley
    .venv/bin/python benchmarks/common_depth.py wall
    .venv/bin/python benchmarks/common_depth.py discrepancy
    .venv/bin/python benchmarks/common_depth.py discrepancy_on_ball --campaigns 20
    .venv/bin/python benchmarks/common_depth.py summary

Tissue whose stiffness depends on depth, fitted by its own element; "discrepancy" is the stiffening tissue
fitted by a spring and damper with a discrepancy beside them, "discrepancy_on_ball" that of Hunt and Crossley,
whose damper is not the same at all depths, so that the program should tell no exponent at one depth. Every
mass exponent of the tissue is 0, and all impacts have the same velocity, so that a heavier impactor goes
deeper: K's exponent at each impact's own greatest depth is above 0 for that reason alone, and the one at a
common depth is 0.

Each campaign has two people in ten conditions, 0.375 to 1.333 kg at 2.5 kHz, with effects of the conditions
of standard deviation 0.1. Four conditions, as in coverage_elements.py, say so little of their own spread that
the interval hangs on its prior: there it held the truth in 96 to 100 % with a spread of 0.05.

Counted are fits whose Pareto k can be trusted; with others the program goes on to the exact path, which takes
too long here. A campaign's intervals go to common_depth_campaigns.csv as soon as it is finished, and those
already there are not made again; the table of them all goes to common_depth.csv.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from coverage_fit import MEASURING_CHAIN, Fits
from evidence import recorded
from evidence.references import TISSUES

from bayestissue import runtime
from bayestissue.elements import element
from bayestissue.hierarchy.specification import ModelSpecification, read_specification
from bayestissue.inference.quantities.secants import mass_exponents_of_secants, of_secant
from bayestissue.inference.samplers.psis import GREATEST_K
from bayestissue.simulation import Simulation, simulate

CAMPAIGNS = 100
ROOT = Path(__file__).parents[1]
TABLE = ROOT / "benchmarks" / "common_depth.csv"
EVERY = ROOT / "benchmarks" / "common_depth_campaigns.csv"
# The case: the tissue's element, and the model file.
CASES = {
    "stiffening": ("stiffening", "stiffening"),
    "hunt_crossley": ("hunt_crossley", "hunt_crossley"),
    "wall": ("wall", "wall"),
    "discrepancy": ("stiffening", "impact"),
    "discrepancy_on_ball": ("hunt_crossley", "impact"),
}
MASSES = np.geomspace(0.375, 1.333, 10)
COLUMNS = ["case", "campaign", "quantity", "low", "median", "high", "pareto_k", "command"]


def campaign(case: str, number: int) -> Simulation:
    """A tissue of fixed law, under ten masses at one velocity."""
    tissue = CASES[case][0]
    effects = {f"sd_{group}_{q}": sd for group, sd in _SPREADS.items() for q in ("K", "C")}
    if element(tissue).extra:
        effects["sd_impact_parameters"] = 0.05
    conditions = [
        {"trial": f"t{i + 1}", "mass_kg": float(mass), "velocity_m_s": 1.0} for i, mass in enumerate(MASSES)
    ]
    typical = {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, "reference_mass_kg": 0.7, "element": tissue}
    return Simulation.model_validate(
        {
            "name": "common depth",
            "seed": 1000 * list(CASES).index(case) + number,
            "design": {"subjects": 2, "conditions": conditions},
            "tissue": typical | effects | TISSUES[tissue],
            "recording": {
                "sampling_rate_hz": 2500.0,
                "before_contact_s": 0.005,
                "after_contact_s": 0.005,
                **MEASURING_CHAIN,
            },
        }
    )


_SPREADS = {"subject": 0.2, "trial": 0.1, "impact": 0.05}


def model_of(case: str) -> ModelSpecification:
    """The case's model file, with a discrepancy from the start where it is to have one."""
    specification = read_specification(ROOT / "models" / f"{CASES[case][1]}.toml")
    beside = "always" if specification.name == "impact" else "none"
    return specification.model_copy(update={"discrepancy": beside})


def finished(case: str) -> pd.DataFrame:
    """The rows of the case's campaigns that are finished."""
    every = pd.read_csv(EVERY) if EVERY.is_file() else pd.DataFrame(columns=COLUMNS)
    return every[every["case"] == case]


def trusted(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of fits whose summaries stand for the traces."""
    return rows[rows["pareto_k"] < GREATEST_K]


def measure(case: str, campaigns: int, seconds: float) -> None:
    """Fit campaigns until so many are trusted, those begun within so many seconds, and keep the intervals."""
    begun, fits, command = time.perf_counter(), None, _command(case, campaigns)
    for number in itertools.count():
        rows = finished(case)
        enough = trusted(rows)["campaign"].nunique() >= campaigns
        if enough or time.perf_counter() - begun > seconds:
            break
        if number in set(rows["campaign"]):
            continue
        dataset = simulate(campaign(case, number)).dataset("common depth")
        fits = fits or Fits(model_of(case), dataset)
        prepared = fits.prepared(dataset)
        found, correction = fits.fit(prepared, number)
        found = of_secant(prepared, found)
        exponents = mass_exponents_of_secants(prepared, found, number)
        exponents["mass_exponent_C"] = found.sites["mass_exponent_C"]
        made = []
        for name, draws in exponents.items():
            low, median, high = np.quantile(draws, [0.05, 0.5, 0.95])
            made.append((case, number, name, low, median, high, correction.pareto_k, command))
        _append(pd.DataFrame(made, columns=COLUMNS))
        print(f"{case}: campaign {number}, {time.perf_counter() - begun:.0f} s", flush=True)


def _command(case: str, campaigns: int) -> str:
    return f"benchmarks/common_depth.py {case}" + f" --campaigns {campaigns}" * (campaigns != CAMPAIGNS)


def _append(rows: pd.DataFrame) -> None:
    """In one piece, so that several cases can be measured at once."""
    text = rows.to_csv(index=False, header=False, float_format="%.5g")
    try:
        with EVERY.open("x", encoding="utf-8") as file:
            file.write(",".join(COLUMNS) + "\n" + text)
    except FileExistsError:
        with EVERY.open("a", encoding="utf-8") as file:
            file.write(text)


def summarised(every: pd.DataFrame) -> pd.DataFrame:
    """One line per case and quantity: in how many trusted campaigns the 90 % interval holds 0."""
    lines: list[dict[str, Any]] = []
    for (case, quantity), rows in every.groupby(["case", "quantity"], sort=False):
        part = trusted(rows)
        held = (part["low"] <= 0) & (part["high"] >= 0)
        share = float(held.mean())
        lines.append(
            {
                "case": case,
                "quantity": quantity,
                "level": 90,
                "held": int(held.sum()),
                "campaigns": len(part),
                "share": round(share, 4),
                "binomial_se": round(float(np.sqrt(share * (1 - share) / len(part))), 4),
                "mean_median": float(f"{part['median'].mean():.3g}"),
                "median_width": float(f"{(part['high'] - part['low']).median():.3g}"),
                "not_trusted": len(rows) - len(part),
                "command": part["command"].iloc[0],
            }
        )
    return pd.DataFrame(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", choices=(*CASES, "summary"))
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS)
    parser.add_argument("--seconds", type=float, default=np.inf, help="begin no campaign after these")
    asked = parser.parse_args()
    runtime.configure(one_core=True)
    if asked.case == "summary":
        write()
        return
    name = "common_depth_on_ball" if asked.case == "discrepancy_on_ball" else f"common_depth-{asked.case}"
    with recorded(name) as record:
        measure(asked.case, asked.campaigns, asked.seconds)
        if left := asked.campaigns - trusted(finished(asked.case))["campaign"].nunique():
            record.left = f"{left} of {asked.campaigns} campaigns"
        write()


def write() -> None:
    """Print and write the table of all cases."""
    lines = summarised(pd.read_csv(EVERY))
    print(lines.drop(columns="command").to_string(index=False))
    lines.to_csv(TABLE, index=False)


if __name__ == "__main__":
    main()
