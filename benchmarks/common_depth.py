"""Whether the mass exponent at a common depth holds 0 where the tissue is the same for every mass.

    .venv/bin/python benchmarks/common_depth.py stiffening
    .venv/bin/python benchmarks/common_depth.py discrepancy_on_ball

Tissue whose stiffness depends on depth, fitted by its own element; "discrepancy" is the stiffening tissue
fitted by a spring and damper with a discrepancy beside them, "discrepancy_on_ball" that of Hunt and Crossley,
whose damper is not the same at all depths, so that the program should tell no exponent at one depth. Every
mass exponent of the tissue is 0, and all impacts have the same velocity, so that a heavier impactor goes
deeper: K's exponent at each impact's own greatest depth is above 0 for that reason alone, and the one at a
common depth is 0.

Each campaign has two people in ten conditions, 0.375 to 1.333 kg at 2.5 kHz, with effects of the conditions
of standard deviation 0.1. Four conditions, as in coverage.py, say so little of their own spread that
the interval hangs on its prior: there it held the truth in 96 to 100 % with a spread of 0.05.

A row a campaign and exponent has the posterior of it, whose truth is 0.
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd
from coverage import KEPT, MEASURING_CHAIN, Fits, model_of, rows_of
from evidence import recorded
from evidence.references import TISSUES

from bayestissue.base import runtime
from bayestissue.inference.quantities.secants import mass_exponents_of_secants
from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.studies.simulation import Simulation, simulate

# A share of 90 % is known to 9 % by 12 and to 4 % by all four cases together.
CAMPAIGNS = {f"common_depth-{case}": 12 for case in ("stiffening", "hunt_crossley", "wall", "discrepancy")}
CAMPAIGNS["common_depth_on_ball"] = 10
# The case: the tissue's element, and the model file.
CASES = {
    "stiffening": ("stiffening", "stiffening"),
    "hunt_crossley": ("hunt_crossley", "hunt_crossley"),
    "wall": ("wall", "wall"),
    "discrepancy": ("stiffening", "impact"),
    "discrepancy_on_ball": ("hunt_crossley", "impact"),
}
# Samples that all traces are filled up to, so that the fits of a case are compiled once.
LONGEST = 96
# So many draws know an end of an interval to one or two hundredths of probability.
SAMPLER = Sampler(draws=KEPT, effective=200)
MASSES = np.geomspace(0.375, 1.333, 10)


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


def model_of_case(case: str) -> ModelSpecification:
    """The case's model file, with a discrepancy from the start where it is to have one."""
    specification = model_of(CASES[case][1])
    discrepancy = "always" if specification.name == "impact" else "none"
    return specification.model_copy(update={"discrepancy": discrepancy, "sampler": SAMPLER})


def exponents_of(case: str, number: int, fits: Fits) -> pd.DataFrame:
    """The posterior of every exponent that a fit gives."""
    dataset = simulate(campaign(case, number)).dataset("common depth")
    prepared = fits.prepared(dataset)
    draws, passed = fits.fit(prepared, number)
    exponents = mass_exponents_of_secants(prepared, draws, number)
    exponents["mass_exponent_C"] = draws.population["mass_exponent_C"]
    rows = rows_of({name: (values, 0.0) for name, values in exponents.items()})
    return rows.assign(passed=passed)


def main() -> None:
    case = sys.argv[1]
    name = "common_depth_on_ball" if case == "discrepancy_on_ball" else f"common_depth-{case}"
    runtime.configure()
    with recorded(name) as record:
        fits = Fits(model_of_case(case), simulate(campaign(case, 0)).dataset("common depth"), LONGEST)
        for number in record.missing(range(CAMPAIGNS[name])):
            record.add(number, exponents_of(case, number, fits))


if __name__ == "__main__":
    main()
