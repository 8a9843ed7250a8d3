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
from functools import partial

import numpy as np
import pandas as pd
from evidence import measure
from evidence.references import varied_tissue
from evidence.simulations import simulation, tables
from studies import CHAIN, FEW_DRAWS, Fits, model_of, rows_of

from bayestissue.inference.quantities.secants import mass_exponents_of_secants
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.recordings.dataset import Dataset
from bayestissue.studies.simulation import simulate

TABLES = tables(__file__)
CASES = TABLES["cases"]
# Samples that all traces are filled up to, so that the fits of a case are compiled once.
LONGEST = 96
MASSES_KG = np.geomspace(0.375, 1.333, 10)


def campaign(case: str, number: int) -> Dataset:
    """A tissue of fixed law, under ten masses at one velocity."""
    seed, conditions = (
        1000 * list(CASES).index(case),
        [(f"t{i + 1}", m, 1.0) for i, m in enumerate(MASSES_KG)],
    )
    own = {"tissue": varied_tissue(CASES[case][0]), "recording": CHAIN, "design": {"conditions": conditions}}
    return simulate(simulation(TABLES["campaign"], own, seed=seed + number)).dataset("common depth")


def model_of_case(case: str) -> ModelSpecification:
    """The case's model file, with a discrepancy from the start where it is to have one."""
    specification = model_of(CASES[case][1])
    discrepancy = "always" if specification.name == "impact" else "none"
    return specification.model_copy(update={"discrepancy": discrepancy, "sampler": FEW_DRAWS})


def exponents_of(case: str, fits: Fits, number: int) -> pd.DataFrame:
    """The posterior of every exponent that a fit gives."""
    prepared = fits.prepared(campaign(case, number))
    draws, passed = fits.fit(prepared, number)
    exponents = mass_exponents_of_secants(prepared, draws, number)
    exponents["mass_exponent_C"] = draws.population["mass_exponent_C"]
    rows = rows_of({name: (values, 0.0) for name, values in exponents.items()})
    return rows.assign(passed=passed)


def main() -> None:
    case = sys.argv[1]
    *_, campaigns, piece = CASES[case]
    fits = Fits(model_of_case(case), campaign(case, 0), LONGEST)
    measure(piece, range(campaigns), partial(exponents_of, case, fits))


if __name__ == "__main__":
    main()
