"""Assurance by a plan, in seconds, against studies that are simulated sample by sample, fitted and asked.

    .venv/bin/python benchmarks/plan_assurance.py

Six designs, a question each. A plan gives the shares of studies that answer yes, that answer no, and that
mislead. By brute force as many truths are drawn from the same beliefs, each one's campaign is simulated
through its recorder, fitted as a lab would, and asked. Both are Monte Carlo, so that they are compared by two
standard errors of their difference.

A fit whose chains did not pass is undecided; how many are is counted. Of a fit there are draws alone, without
the tables and checks of a run, and without a second one that has a discrepancy. A row a study has its
probability and whether the claim is true; rows of a plan its shares.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from evidence import measure
from evidence.simulations import simulation, tables
from studies import CHAIN, Fits, of_draws

from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.reliability import as_variables, coefficients
from bayestissue.inference.answers.study import Study
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.results.uncertainty_budget import measurement_sd, uncertainty_budget
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.specification import ModelSpecification, specification_of
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.studies.fitting import resolve
from bayestissue.studies.planning.assurance import Goal, planner
from bayestissue.studies.planning.design_prior import BLOCK, DesignPrior, PlannedPopulation, Streams
from bayestissue.studies.planning.information import simulation_of
from bayestissue.studies.planning.study_posterior import planned_model
from bayestissue.studies.simulation import Simulation, simulate
from bayestissue.studies.simulation.simulation_file import Recording

TABLES = tables(__file__)
PLANNED, PROBABILITY, CASES = TABLES["planned"], TABLES["probability"], TABLES["cases"]
# Samples that nearly all traces are filled up to, so that the fits of a case are compiled once; at 5 kHz.
LONGEST = 192
# Spreads of groups and slopes: as a posterior has them, and as a simulation file and a formula do.
GROUPS = (
    ("sd_subject_side", "sd_group", "subject:side"),
    ("sd_subject_mass_exponent", "sd_slope", "log(mass_kg)|subject"),
)


def tissue_of(
    population: PlannedPopulation, analysis: ModelSpecification, rows: pd.DataFrame, seed: int, number: int
) -> dict[str, Any]:
    """The tissue of a study whose truth is drawn from what is believed, as a simulation file has it."""
    reference = float(analysis.reference_mass_kg or np.exp(np.log(rows["mass_kg"]).mean()))
    design = build_design(analysis.formula, rows, reference_mass_kg=reference, source="plan")
    model, _ = planned_model(analysis, design)
    truths = DesignPrior(population).truths(model, design, Streams(seed, number // BLOCK))
    values = {**truths.hyperparameters, **truths.fixed}
    drawn = {name: float(v.reshape(BLOCK, -1)[number % BLOCK, 0]) for name, v in values.items()}
    tissue: dict[str, Any] = {"reference_mass_kg": reference}
    for q, key in (("K", "K_N_per_m"), ("C", "C_N_s_per_m")):
        tissue[key] = float(np.exp(drawn[f"intercept_{q}"]))
        names = (f"{stem}_{q}" for stem in ("mass_exponent", "sd_subject", "sd_trial", "sd_impact"))
        tissue |= {name: drawn.get(name, 0.0) for name in names}
    for name, key, group in GROUPS:
        if f"{name}_K" in drawn:
            tissue[key] = {group: {q: drawn[f"{name}_{q}"] for q in "KC"}}
    return tissue


def rows_of(case: dict[str, Any]) -> pd.DataFrame:
    """The impacts of a design."""
    sides, repeats = case.get("sides", ["left"]), range(case.get("repeats", 1))
    people = [f"s{number + 1:02d}" for number in range(case["people"])]
    rows = pd.DataFrame(
        [
            (person, f"t{M:g}", M, 1.5, side)
            for person, M, side, _ in product(people, case["masses"], sides, repeats)
        ],
        columns=["subject", "trial", "mass_kg", "velocity_m_s", "side"],
    )
    return rows if "sides" in case else rows.drop(columns="side")


def formula_of(case: dict[str, Any]) -> dict[str, str]:
    """Of K and of C."""
    return dict.fromkeys("KC", case.get("formula", "log(mass_kg) + (1|subject)"))


def recorder_of(case: dict[str, Any]) -> dict[str, Any]:
    """The recording of a simulation file."""
    return CHAIN | TABLES["recorders"][case.get("recorder", "good")]


def specification_of_case(case: dict[str, Any]) -> ModelSpecification:
    """The analysis."""
    return specification_of(
        {"likelihood": "impact", "discrepancy": "none", "formula": formula_of(case)}, "plan"
    )


def population_of(case: dict[str, Any]) -> PlannedPopulation:
    """What is believed of the tissue."""
    return PlannedPopulation.model_validate(TABLES["beliefs"] | case.get("beliefs", {}))


def campaign(case: dict[str, Any], study: int) -> Simulation:
    """A study's campaign, with a truth of its own from what is believed."""
    # Truths of each case's own, and others than the plan's: what chance does then differs between cases.
    seed = 70 + list(CASES.values()).index(case)
    factors = [{"name": "side", "levels": case["sides"]}] if "sides" in case else []
    design = {
        "subjects": case["people"],
        "repeats": case.get("repeats", 1),
        "conditions": [(f"t{mass:g}", mass, 1.5) for mass in case["masses"]],
        "factors": factors,
    }
    tissue = tissue_of(population_of(case), specification_of_case(case), rows_of(case), seed, study)
    content = {"name": "study", "seed": 1000 * seed + study, "recording": recorder_of(case)}
    return simulation(content, design=design, tissue=tissue)


def truth_of(case: dict[str, Any], made: Simulation) -> bool:
    """Whether the question's claim is true of what was simulated."""
    name, _, least = case["ask"].partition(" > ")
    tissue = made.tissue
    if name == "sd_subject_side_K":
        value = tissue.sd_group["subject:side"].K
    elif name == "ICC_C1_K":
        value = tissue.sd_subject_K**2 / (tissue.sd_subject_K**2 + tissue.sd_impact_K**2)
    else:
        value = tissue.mass_exponent_K
    return value > float(least)


@cache
def fits_of(name: str) -> Fits:
    """The fits of one design's studies, compiled once."""
    case = CASES[name]
    model, _ = resolve("impact", formulas=formula_of(case))
    least = int(LONGEST * recorder_of(case)["sampling_rate_hz"] / 5000.0)
    return Fits(model, simulate(campaign(case, 0)).dataset("study"), least)


def answer(name: str, study: int) -> dict[str, Any]:
    """One study, simulated, fitted and asked."""
    case, fits = CASES[name], fits_of(name)
    made = campaign(case, study)
    row = {"study": study, "truth": truth_of(case, made)}
    prepared = fits.prepared(simulate(made).dataset("study"))
    draws, passed = fits.fit(prepared, study)
    if not passed:
        return row | {"note": "chains"}
    posterior = of_draws(prepared, draws, study)
    if "ICC" in case["ask"]:
        posterior = posterior.merge(reliability(prepared, draws, posterior))
    finished = Study(posterior, prepared.design.recorded)
    return row | {"posterior": float(ask(finished, numbered([case["ask"]]))["posterior"].iloc[0])}


def reliability(prepared: Prepared, draws: Draws, posterior: xr.Dataset) -> xr.Dataset:
    """The coefficients of K, as a run has them."""
    spread = measurement_sd(uncertainty_budget(prepared, draws), "K")
    return as_variables(coefficients(posterior, prepared.design.recorded, {"K": spread}))


def planned(case: dict[str, Any]) -> list[dict[str, Any]]:
    """A row a share of studies, as a plan has it: those that answer yes, that answer no, and that mislead."""
    recorder = simulation_of(Recording.model_validate(recorder_of(case)))
    prior = DesignPrior(population_of(case))
    plan = planner([rows_of(case)], specification_of_case(case), prior, recorder, seed=5)
    goal = Goal(case["ask"], case["ask"])
    ((assessed,),) = plan.assess([goal], range(PLANNED // BLOCK), probability=PROBABILITY)
    true = assessed.table["true"].to_numpy()
    misleads = (assessed.yes & ~true) | (assessed.no & true)
    shares = {"yes": assessed.yes, "no": assessed.no, "misleads": misleads}
    known = {"studies": PLANNED, "probability": PROBABILITY}
    return [{"share": name, "by_plan": x.mean(), **known} for name, x in shares.items()]


def rows_of_unit(unit: tuple[str, int | None]) -> pd.DataFrame:
    """What a plan says of a design, or one of its studies."""
    name, study = unit
    rows = planned(CASES[name]) if study is None else [answer(name, study)]
    return pd.DataFrame(rows).assign(case=name)


def main() -> None:
    studies = ("plan", *range(TABLES["studies"]))
    units = {
        f"{name} {study}": (name, None if study == "plan" else study)
        for name, study in product(CASES, studies)
    }
    measure("plan_assurance", units, rows_of_unit)


if __name__ == "__main__":
    main()
