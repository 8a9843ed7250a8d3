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
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from coverage import MEASURING_CHAIN, Fits
from evidence import recorded
from studies import of_draws

from bayestissue.base import runtime
from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.reliability import as_variables, coefficients, variances
from bayestissue.inference.answers.study import Study
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.results.uncertainty_budget import measurement_sd, uncertainty_budget
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.specification import ModelSpecification, specification_of
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.studies.fitting import resolve
from bayestissue.studies.planning.assurance import Goal, planner
from bayestissue.studies.planning.information import simulation_of
from bayestissue.studies.planning.planned_population import BLOCK, PlannedPopulation, Streams
from bayestissue.studies.planning.study_model import planned_model
from bayestissue.studies.simulation import Simulation, simulate
from bayestissue.studies.simulation.simulation_file import Recording

# A share of one design is known to 18 %, the mean difference of all six from the plan to 7 %.
NUMBER, PLANNED = 8, 2000
PROBABILITY = 0.95
GOOD = {"sampling_rate_hz": 5000.0, **MEASURING_CHAIN}
# Samples that nearly all traces are filled up to, so that the fits of a case are compiled once.
LONGEST = 192
BAD = GOOD | {"sampling_rate_hz": 2500.0, "noise_relative_to_peak": 0.08, "velocity_sd_m_s": 0.03}
KNOWN = {"distribution": "normal", "sd": 0.3}
# What is believed of the tissue: narrow enough that the questions are open, neither settled nor hopeless.
BELIEFS: dict[str, Any] = {
    "intercept": {"K": {**KNOWN, "mean": 8.0}, "C": {**KNOWN, "mean": 3.2}},
    "mass_exponent": {"K": {"distribution": "normal", "mean": 0.3, "sd": 0.3}, "C": 0.2},
    "sd_subject": {"K": 0.2, "C": 0.2},
    "sd_trial": {"K": 0.03, "C": 0.03},
    "sd_impact": {"K": 0.1, "C": 0.1},
}
MASS = "log(mass_kg) + (1|subject)"
# People, masses, repeats and sides of each, the formula, what else is believed, the recorder, the question.
CASES: dict[str, dict[str, Any]] = {
    "one or none": {
        "people": 8,
        "masses": [0.4, 1.2],
        "beliefs": {"mass_exponent": {"K": {"distribution": "normal", "mean": 0.5, "sd": 0.3}, "C": 0.2}},
        "ask": "mass_exponent_K > 0.5",
    },
    "bad recorder": {"people": 6, "masses": [0.5, 1.0], "recorder": BAD, "ask": "mass_exponent_K > 0.1"},
    "conditions": {
        "people": 4,
        "masses": [0.4, 0.6, 0.9, 1.3],
        "formula": "log(mass_kg) + (1|subject) + (1|trial)",
        "ask": "mass_exponent_K > 0.2",
    },
    "slopes": {
        "people": 8,
        "masses": [0.5, 0.7, 1.0],
        "formula": "log(mass_kg) + (log(mass_kg)|subject)",
        "beliefs": {"sd_slope": {"log(mass_kg)|subject": {"K": 0.25, "C": 0.1}}},
        "ask": "mass_exponent_K > 0.2",
    },
    "two sides": {
        "people": 8,
        "masses": [0.7],
        "repeats": 2,
        "sides": ["left", "right"],
        "formula": "(1|subject) + (1|subject:side)",
        "beliefs": {
            "sd_group": {"subject:side": {"K": {"distribution": "half-normal", "scale": 0.15}, "C": 0.1}}
        },
        "ask": "sd_subject_side_K > 0.06",
    },
    "repeatability": {
        "people": 10,
        "masses": [0.7],
        "repeats": 3,
        "formula": "(1|subject)",
        "beliefs": {"sd_subject": {"K": {"distribution": "half-normal", "scale": 0.3}, "C": 0.2}},
        "ask": "ICC_C1_K > 0.75",
    },
}


def rows_of(case: dict[str, Any]) -> pd.DataFrame:
    """The impacts of a design."""
    rows = pd.MultiIndex.from_product(
        [
            [f"s{number + 1:02d}" for number in range(case["people"])],
            case["masses"],
            case.get("sides", ["left"]),
            range(case.get("repeats", 1)),
        ],
        names=["subject", "mass_kg", "side", "repeat"],
    ).to_frame(index=False)
    rows = rows.assign(trial=[f"t{mass:g}" for mass in rows["mass_kg"]], velocity_m_s=1.5)
    columns = ["subject", "trial", "mass_kg", "velocity_m_s", *(["side"] if "sides" in case else [])]
    return rows[columns]


def specification_of_case(case: dict[str, Any]) -> ModelSpecification:
    """The analysis."""
    formula = case.get("formula", MASS)
    content = {"likelihood": "impact", "discrepancy": "none", "formula": {"K": formula, "C": formula}}
    return specification_of(content, "plan")


def population_of(case: dict[str, Any]) -> PlannedPopulation:
    """What is believed of the tissue."""
    return PlannedPopulation.model_validate(BELIEFS | case.get("beliefs", {}))


def campaign(case: dict[str, Any], study: int) -> Simulation:
    """A study's campaign, with a truth of its own from what is believed."""
    rows, specification = rows_of(case), specification_of_case(case)
    reference = float(np.exp(np.log(rows["mass_kg"]).mean()))
    design = build_design(specification.formula, rows, reference_mass_kg=reference, source="plan")
    model, _ = planned_model(specification, design)
    # Truths of each case's own, and others than the plan's: what chance does then differs between cases.
    seed = 70 + list(CASES.values()).index(case)
    truths = population_of(case).truths(model, design, Streams(seed, study // BLOCK))
    of_study = {name: float(v[study % BLOCK]) for name, v in truths.hyperparameters.items()}
    fixed = {name: float(v[study % BLOCK, 0]) for name, v in truths.fixed.items()}
    tissue: dict[str, Any] = {
        "K_N_per_m": float(np.exp(fixed["intercept_K"])),
        "C_N_s_per_m": float(np.exp(fixed["intercept_C"])),
        "reference_mass_kg": reference,
    }
    for q in ("K", "C"):
        tissue[f"mass_exponent_{q}"] = fixed.get(f"mass_exponent_{q}", 0.0)
        tissue |= {
            f"sd_{group}_{q}": of_study.get(f"sd_{group}_{q}", 0.0)
            for group in ("subject", "trial", "impact")
        }
    for name, key in (
        ("sd_subject_side", ("sd_group", "subject:side")),
        ("sd_subject_mass_exponent", ("sd_slope", "log(mass_kg)|subject")),
    ):
        if f"{name}_K" in of_study:
            tissue[key[0]] = {key[1]: {q: of_study[f"{name}_{q}"] for q in ("K", "C")}}
    content: dict[str, Any] = {
        "name": "study",
        "seed": 1000 * seed + study,
        "design": {
            "subjects": case["people"],
            "repeats": case.get("repeats", 1),
            "conditions": [
                {"trial": f"t{mass:g}", "mass_kg": mass, "velocity_m_s": 1.5} for mass in case["masses"]
            ],
        },
        "tissue": tissue,
        "recording": case.get("recorder", GOOD),
    }
    if "sides" in case:
        content["design"]["factors"] = [{"name": "side", "levels": case["sides"]}]
    return Simulation.model_validate(content)


def truth_of(case: dict[str, Any], simulation: Simulation) -> bool:
    """Whether the question's claim is true of what was simulated."""
    name, _, least = case["ask"].partition(" > ")
    tissue = simulation.tissue
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
    formula = case.get("formula", MASS)
    model, _ = resolve("impact", formulas={"K": formula, "C": formula})
    least = int(LONGEST * case.get("recorder", GOOD)["sampling_rate_hz"] / GOOD["sampling_rate_hz"])
    return Fits(model, simulate(campaign(case, 0)).dataset("study"), least)


def answer(name: str, study: int) -> dict[str, Any]:
    """One study, simulated, fitted and asked."""
    case, fits = CASES[name], fits_of(name)
    simulation = campaign(case, study)
    row = {"study": study, "truth": truth_of(case, simulation)}
    prepared = fits.prepared(simulate(simulation).dataset("study"))
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
    of_K = {"K": variances(posterior, prepared.design.recorded, "K", measurement_sd=spread)}
    return as_variables(coefficients(of_K, posterior))


def planned(case: dict[str, Any]) -> list[dict[str, Any]]:
    """A row a share of studies, as a plan has it: those that answer yes, that answer no, and that mislead."""
    simulation = simulation_of(Recording.model_validate(case.get("recorder", GOOD)))
    plan = planner([rows_of(case)], specification_of_case(case), population_of(case), simulation, seed=5)
    goal = Goal(case["ask"], case["ask"])
    ((assessed,),) = plan.assess([goal], range(PLANNED // BLOCK), probability=PROBABILITY)
    misleads = (assessed.yes & ~assessed.true) | (assessed.no & assessed.true)
    shares = {"yes": assessed.yes, "no": assessed.no, "misleads": misleads}
    known = {"studies": PLANNED, "probability": PROBABILITY}
    return [{"share": name, "by_plan": x.mean(), **known} for name, x in shares.items()]


def main() -> None:
    runtime.configure()
    with recorded("plan_assurance") as record:
        units = {f"{name} {study}": (name, study) for name in CASES for study in ("plan", *range(NUMBER))}
        for unit in record.missing(units):
            name, study = units[unit]
            rows = planned(CASES[name]) if study == "plan" else [answer(name, study)]
            record.add(unit, [row | {"case": name} for row in rows])


if __name__ == "__main__":
    main()
