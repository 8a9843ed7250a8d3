"""Drops that `plan --after` saves to a running study, beside the order of masses that the thesis has.

    .venv/bin/python benchmarks/plan_after.py
    .venv/bin/python benchmarks/plan_after.py --seconds 600

Each study has a truth of its own, drawn from the beliefs of models/plan-thesis.toml but with the program's
own belief of the mass exponent, so that the plan's question has an answer either way. Its five people are hit
in the thesis's conditions, all of them in one condition before the next. The study has begun with the first
two. From there it goes on in two ways until its question is answered with a probability above 0.95, or as
many drops are recorded as the thesis's nine conditions have: in the order of the thesis's table, or, at each
look, in the condition that leaves the fewest undecided bits, as `plan --after` finds it; that may be one that
was recorded.

Both ways have the same traces of the same people. Traces are simulated sample by sample, and what each tells
of K and C is found by the engine. A look's posterior is the planner's, of these sites, rather than a fit's
that takes seconds: of the first studies `bt.fit` is asked as well where the study ended, and the greatest
difference is in the table. A study goes to plan_after_studies.csv as soon as it has ended both ways, and
those there are not made again; the summary goes to plan_after.csv.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from evidence import recorded

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.meaning import draws_of
from bayestissue.inference.answers.study import Study as Asked
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.studies.fitting import resolve
from bayestissue.studies.planning.assurance import Goal, planner
from bayestissue.studies.planning.information import simulation_of
from bayestissue.studies.planning.plan_file import read_plan
from bayestissue.studies.planning.planned_population import BLOCK, Pilot, PlannedPopulation, Streams
from bayestissue.studies.planning.running import Running, RunningPrior, running_study
from bayestissue.studies.planning.studies import arrangements
from bayestissue.studies.planning.study_model import planned_model
from bayestissue.studies.planning.study_posterior import PlannedSites, posteriors
from bayestissue.studies.simulation import Simulation, simulate

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "benchmarks" / "plan_after.csv"
STUDIES = ROOT / "benchmarks" / "plan_after_studies.csv"
NUMBER, FITTED = 24, 6
PEOPLE, BEGUN, TWICE = 5, 2, 2
FORMULA = "log(mass_kg) + (1|subject) + (1|trial)"
PLAN = read_plan(ROOT / "models" / "plan-thesis.toml")
(QUESTION,) = PLAN.questions.values()
CONDITIONS = PLAN.candidates.conditions
SURE = PLAN.goal.probability
BELIEFS = PLAN.population.model_copy(update={"mass_exponent": PlannedPopulation().mass_exponent})
# Draws of a posterior that is computed as often as planned ones, each time by points of its own: so that what
# is compiled for these serves it.
DRAWS = 4000
WAYS = ("thesis", "plan")
COLUMNS = ["study", "way", "drops", "answer", "posterior", "by_fit", "exponent", "order"]


class Study(NamedTuple):
    """All traces that a study may come to record, and its truth."""

    dataset: Dataset
    sites: Running
    repeat: np.ndarray
    exponent: float


def specification() -> ModelSpecification:
    """The analysis."""
    model, _ = resolve("impact", formulas={"K": FORMULA, "C": FORMULA})
    return model.model_copy(update={"reference_mass_kg": PLAN.reference_mass_kg, "discrepancy": "none"})


def study_of(number: int, model: ModelSpecification) -> Study:
    """A study with a truth of its own."""
    rows = pd.DataFrame(
        [(f"s{n}", c.trial, *c.mass_and_velocity()) for c in CONDITIONS for n in range(PEOPLE)],
        columns=["subject", "trial", "mass_kg", "velocity_m_s"],
    )
    reference = float(model.reference_mass_kg or 0)
    design = build_design(model.formula, rows, reference_mass_kg=reference, source="study")
    planned, _ = planned_model(model, design)
    truths = BELIEFS.truths(planned, design, Streams(31, number // BLOCK))
    values = {name: float(v.reshape(BLOCK, -1)[number % BLOCK, 0]) for name, v in
              {**truths.hyperparameters, **truths.fixed}.items()}  # fmt: skip
    tissue: dict[str, Any] = {"reference_mass_kg": reference}
    for q, key in (("K", "K_N_per_m"), ("C", "C_N_s_per_m")):
        tissue[key] = float(np.exp(values[f"intercept_{q}"]))
        names = ("mass_exponent", "sd_subject", "sd_trial", "sd_impact")
        tissue |= {f"{name}_{q}": values[f"{name}_{q}"] for name in names}
    content = {
        "name": "study",
        "seed": 31_000 + number,
        "design": {
            "subjects": PEOPLE,
            "repeats": TWICE,
            "conditions": [condition.model_dump(exclude_none=True) for condition in CONDITIONS],
        },
        "tissue": tissue,
        "recording": PLAN.recording.model_dump(exclude_none=True),
    }
    dataset = simulate(Simulation.model_validate(content)).dataset("study")
    sites = running_study(prepare(dataset, model, source="study"), model)
    repeat = sites.rows.groupby(["subject", "trial"]).cumcount().to_numpy()
    return Study(dataset, sites, repeat, values["mass_exponent_K"])


def recorded_by(study: Study, order: list[str]) -> np.ndarray:
    """Which of all impacts are recorded after these conditions, those of a condition twice its repeats."""
    times = study.sites.rows["trial"].map(lambda trial: order.count(trial)).to_numpy()
    return study.repeat < times


def so_far(study: Study, order: list[str]) -> Running:
    """What is recorded after these conditions."""
    there = recorded_by(study, order)
    rows = study.sites.rows[there].reset_index(drop=True)
    return Running(rows, study.sites.centre[there], study.sites.precision[there])


def posterior_of(running: Running, model: ModelSpecification) -> tuple[xr.Dataset, float]:
    """Draws of the posterior of what is recorded, and the probability of the question's claim."""
    reference = float(model.reference_mass_kg or 0)
    (arranged,) = arrangements(
        [running.rows],
        model,
        reference_mass_kg=reference,
        relative_mass_sd=PLAN.recording.relative_mass_sd,
    )
    centre = np.broadcast_to(running.centre, (BLOCK, *running.centre.shape))
    present = np.ones(centre.shape[:2], bool)
    planned = arranged.model
    typical = BELIEFS.at_median().truths(planned, arranged.design, Streams(0, 0)).hyperparameters
    start = planned.unconstrained(typical)
    drawn = posteriors(PlannedSites(planned, arranged.columns, running.precision, centre, present), start)
    weight = drawn.weight.ravel() / BLOCK
    chosen = np.random.default_rng(0).choice(len(weight), DRAWS, p=weight)
    values = {name: v.reshape(1, -1)[:, chosen] for name, v in drawn.hyperparameters.items()}
    b = drawn.b.reshape(1, len(weight), -1)[:, chosen]
    draws = planned.draws(arranged.design, values, b)
    return draws, float(draws_of(parse(QUESTION), Asked(draws, arranged.design.recorded)).mean())


def next_by_plan(running: Running, draws: xr.Dataset, order: list[str], model: ModelSpecification) -> str:
    """The condition that leaves the fewest undecided bits, as `plan --after` finds it."""
    single = {str(n): v.to_numpy().ravel() for n, v in draws.data_vars.items() if v.dims == ("chain", "draw")}
    pilot = Pilot(single, float(model.reference_mass_kg or 0), BELIEFS)
    candidates = [condition for condition in CONDITIONS if order.count(condition.trial) < TWICE]
    people = running.rows[["subject"]].drop_duplicates()
    designs = [
        people.assign(trial=c.trial, mass_kg=c.mass_and_velocity()[0], velocity_m_s=c.mass_and_velocity()[1])
        for c in candidates
    ]
    ready = planner(
        designs,
        model,
        RunningPrior.of_posterior(draws, pilot, running.rows["mass_kg"].to_numpy(float)),
        simulation_of(PLAN.recording),
        seed=len(order),
        running=running,
    )
    assessed = ready.assess([Goal("question", QUESTION)], range(1), probability=SURE)
    bits = [of_design[0].numbers()["undecided_bits"] for of_design in assessed]
    return candidates[int(np.argmin(bits))].trial


def carried_on(study: Study, way: str, model: ModelSpecification) -> tuple[list[str], float]:
    """The conditions of a study that goes on in one of the ways until it has answered, and its posterior."""
    thesis = [condition.trial for condition in CONDITIONS]
    order = thesis[:BEGUN]
    while True:
        running = so_far(study, order)
        draws, p = posterior_of(running, model)
        if not 1 - SURE <= p <= SURE or len(order) == len(thesis):
            return order, p
        following = next_by_plan(running, draws, order, model) if way == "plan" else thesis[len(order)]
        order = [*order, following]


def by_fit(study: Study, order: list[str]) -> float:
    """The same posterior by a fit of the traces."""
    there = np.flatnonzero(recorded_by(study, order))
    whole = study.dataset
    part = replace(
        whole,
        impacts=whole.impacts.iloc[there].reset_index(drop=True),
        traces=[whole.traces[number] for number in there],
    )
    return float(bt.fit(part, "impact", K=FORMULA, C=FORMULA).ask(QUESTION)["posterior"].iloc[0])


def make_studies(number: int, until: float) -> int:
    """Those that are not there yet; how many are left when the time is up."""
    there = set(pd.read_csv(STUDIES)["study"]) if STUDIES.exists() else set()
    waiting, model = [study for study in range(number) if study not in there], specification()
    for done, which in enumerate(waiting):
        if time.monotonic() > until:
            return len(waiting) - done
        study, rows = study_of(which, model), []
        for way in WAYS:
            order, p = carried_on(study, way, model)
            answer = "yes" if p > SURE else "no" if p < 1 - SURE else ""
            fitted = by_fit(study, order) if which < FITTED else np.nan
            rows.append([which, way, PEOPLE * len(order), answer, p, fitted, study.exponent, " ".join(order)])
        table = pd.DataFrame(rows, columns=COLUMNS)
        table.to_csv(STUDIES, mode="a", header=not STUDIES.exists(), index=False)
        print(table.drop(columns=["study"]).to_string(index=False, header=False), flush=True)
    return 0


def summary(studies: pd.DataFrame) -> pd.DataFrame:
    """A row each way, and the saving of the second with its standard error, paired by study."""
    true = studies["exponent"] < float(QUESTION.rpartition("<")[2])
    studies = studies.assign(
        wrong=studies["answer"].map({"yes": True, "no": False}).ne(true) & studies["answer"].ne("")
    )
    drops = studies.pivot_table(index="study", columns="way", values="drops")
    saved = drops["thesis"] - drops["plan"]
    both = (
        studies.pivot_table(index="study", columns="way", values="answer", aggfunc="first").ne("").all(axis=1)
    )
    rows = []
    for way in WAYS:
        of_way = studies[studies["way"] == way]
        rows.append(
            {
                "way": way,
                "studies": len(of_way),
                "drops": of_way["drops"].mean(),
                "drops_se": of_way["drops"].sem(),
                "answered": int(of_way["answer"].ne("").sum()),
                "wrong": int(of_way["wrong"].sum()),
                "fits": int(of_way["by_fit"].notna().sum()),
                "largest_difference": (of_way["by_fit"] - of_way["posterior"]).abs().max(),
                "saving": saved.mean(),
                "saving_se": saved.sem(),
                "of_both_answered": int(both.sum()),
                "saving_of_those": saved[both].mean(),
                "saving_of_those_se": saved[both].sem(),
            }
        )
    return pd.DataFrame(rows)


def main() -> None:
    """Make what is missing, and the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--studies", type=int, default=NUMBER)
    parser.add_argument("--seconds", type=float, default=np.inf, help="how long this call may take")
    arguments = parser.parse_args()
    runtime.configure()
    runtime.keep_compiled()
    with recorded("plan_after") as record:
        left = make_studies(arguments.studies, time.monotonic() + arguments.seconds)
        record.left = f"{left} studies" if left else ""
        rows = summary(pd.read_csv(STUDIES, keep_default_na=False, na_values={"by_fit": ""}))
        rows.to_csv(TABLE, index=False, float_format="%.4g")
    print(rows.to_string(index=False))


if __name__ == "__main__":
    main()
