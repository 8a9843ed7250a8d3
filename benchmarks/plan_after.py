"""Drops that `plan --after` saves to a running study, beside the order of masses that the thesis has.

    .venv/bin/python benchmarks/plan_after.py

Each study has a truth of its own, drawn from the beliefs of models/plan-thesis.toml but with the program's
own belief of the mass exponent, so that the plan's question has an answer either way. Its five people are hit
in the thesis's conditions, all of them in one condition before the next. The study has begun with the first
two. From there it goes on in two ways until its question is answered with a probability above 0.95, or as
many drops are recorded as the thesis's nine conditions have: in the order of the thesis's table, or, at each
look, in the condition that leaves the fewest undecided bits, as `plan --after` finds it; that may be one that
was recorded.

Both ways have the same traces of the same people. Traces are simulated sample by sample, and what each tells
of K and C is found by the engine. A look's posterior is the planner's, of these sites, rather than a fit's
that takes seconds: of the first studies `bt.fit` is asked as well where the study ended. A row a study and
way has how many drops it took, the answer and its probability.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from evidence import measure
from evidence.registry import ROOT
from evidence.simulations import simulation
from plan_assurance import tissue_of

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.inference.answers.evaluation import draws_of
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.study import Study as Asked
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.studies.fitting import resolve
from bayestissue.studies.planning.assurance import Goal, planner
from bayestissue.studies.planning.design_prior import (
    BLOCK,
    DesignPrior,
    FittedDraws,
    PlannedPopulation,
    Streams,
)
from bayestissue.studies.planning.information import simulation_of, told_of_tissue
from bayestissue.studies.planning.plan_file import read_plan
from bayestissue.studies.planning.running import Running, with_levels
from bayestissue.studies.planning.studies import arrangements
from bayestissue.studies.planning.study_posterior import PlannedSites, posteriors
from bayestissue.studies.simulation import simulate

NUMBER, FITTED = 24, 6
PEOPLE, BEGUN, TWICE = 5, 2, 2
FORMULA = dict.fromkeys("KC", "log(mass_kg) + (1|subject) + (1|trial)")
PLAN = read_plan(ROOT / "models" / "plan-thesis.toml")
(QUESTION,) = PLAN.questions.values()
# Trials by mass and velocity, in the order of the thesis.
CONDITIONS = {condition.trial: condition.mass_and_velocity() for condition in PLAN.candidates.conditions}
SURE, REFERENCE_KG = PLAN.goal.probability, PLAN.reference_mass_kg
# The analysis.
MODEL = resolve("impact", formulas=FORMULA)[0].model_copy(
    update={"reference_mass_kg": REFERENCE_KG, "discrepancy": "none"}
)
BELIEFS = PLAN.population.model_copy(update={"mass_exponent": PlannedPopulation().mass_exponent})
# Draws of a posterior that is computed as often as planned ones, each time by points of its own: so that what
# is compiled for these serves it.
DRAWS = 4000
WAYS = ("thesis", "plan")


class Study(NamedTuple):
    """All traces that a study may come to record, and its truth."""

    dataset: Dataset
    sites: Running
    repeat: np.ndarray
    exponent: float


def impacts_of(people: list[str], trials: list[str]) -> pd.DataFrame:
    """Each person once in each condition."""
    rows = [(person, trial, *CONDITIONS[trial]) for trial in trials for person in people]
    return pd.DataFrame(rows, columns=["subject", "trial", "mass_kg", "velocity_m_s"])


def study_of(number: int) -> Study:
    """A study with a truth of its own."""
    rows = impacts_of([f"s{n}" for n in range(PEOPLE)], list(CONDITIONS))
    tissue = tissue_of(BELIEFS, MODEL, rows, 31, number)
    conditions = [condition.model_dump(exclude_none=True) for condition in PLAN.candidates.conditions]
    content = {
        "name": "study",
        "design": {"subjects": PEOPLE, "repeats": TWICE, "conditions": conditions},
        "recording": PLAN.recording.model_dump(exclude_none=True),
    }
    dataset = simulate(simulation(content, tissue=tissue, seed=31_000 + number)).dataset("study")
    prepared = prepare(dataset, MODEL, source="study")
    sites = Running(prepared.design.recorded.rows, *told_of_tissue(prepared))
    repeat = sites.rows.groupby(["subject", "trial"]).cumcount().to_numpy()
    return Study(dataset, sites, repeat, tissue["mass_exponent_K"])


def recorded_by(study: Study, order: list[str]) -> np.ndarray:
    """Which of all impacts are recorded after these conditions, those of a condition twice its repeats."""
    times = study.sites.rows["trial"].map(lambda trial: order.count(trial)).to_numpy()
    return study.repeat < times


def so_far(study: Study, order: list[str]) -> Running:
    """What is recorded after these conditions."""
    there = recorded_by(study, order)
    rows = study.sites.rows[there].reset_index(drop=True)
    return Running(rows, study.sites.centre[there], study.sites.precision[there])


def posterior_of(running: Running) -> tuple[xr.Dataset, float]:
    """Draws of the posterior of what is recorded, and the probability of the question's claim."""
    sd = PLAN.recording.relative_mass_sd
    (arranged,) = arrangements([running.rows], MODEL, reference_mass_kg=REFERENCE_KG, relative_mass_sd=sd)
    centre = np.broadcast_to(running.centre, (BLOCK, *running.centre.shape))
    present = np.ones(centre.shape[:2], bool)
    planned = arranged.model
    typical = DesignPrior(BELIEFS, at_median=True).truths(planned, arranged.design, Streams(0, 0))
    start = planned.unconstrained(typical.hyperparameters)
    drawn = posteriors(PlannedSites(planned, arranged.columns, running.precision, centre, present), start)
    weight = drawn.weight.ravel() / BLOCK
    chosen = np.random.default_rng(0).choice(len(weight), DRAWS, p=weight)
    values = {name: v.reshape(1, -1)[:, chosen] for name, v in drawn.hyperparameters.items()}
    b = drawn.b.reshape(1, len(weight), -1)[:, chosen]
    draws = planned.draws(arranged.design, values, b)
    return draws, float(draws_of(parse(QUESTION), Asked(draws, arranged.design.recorded)).mean())


def next_by_plan(running: Running, draws: xr.Dataset, order: list[str]) -> str:
    """The condition that leaves the fewest undecided bits, as `plan --after` finds it."""
    single = {str(n): v.to_numpy().ravel() for n, v in draws.data_vars.items() if v.dims == ("chain", "draw")}
    mass_kg = running.rows["mass_kg"].to_numpy(float)
    prior = DesignPrior(BELIEFS, with_levels(FittedDraws(single, REFERENCE_KG), draws, mass_kg))
    trials, people = [trial for trial in CONDITIONS if order.count(trial) < TWICE], running.rows["subject"]
    designs = [impacts_of(list(people.unique()), [trial]) for trial in trials]
    recorder = simulation_of(PLAN.recording)
    ready = planner(designs, MODEL, prior, recorder, seed=len(order), running=running)
    assessed = ready.assess([Goal("question", QUESTION)], range(1), probability=SURE)
    return trials[int(np.argmin([of_design[0].numbers()["undecided_bits"] for of_design in assessed]))]


def carried_on(study: Study, way: str) -> tuple[list[str], float]:
    """The conditions of a study that goes on in one of the ways until it has answered, and its posterior."""
    thesis = list(CONDITIONS)
    order = thesis[:BEGUN]
    while True:
        running = so_far(study, order)
        draws, p = posterior_of(running)
        if not 1 - SURE <= p <= SURE or len(order) == len(thesis):
            return order, p
        order = [*order, next_by_plan(running, draws, order) if way == "plan" else thesis[len(order)]]


def by_fit(study: Study, order: list[str]) -> float:
    """The same posterior by a fit of the traces."""
    there = np.flatnonzero(recorded_by(study, order))
    whole = study.dataset
    part = replace(
        whole,
        impacts=whole.impacts.iloc[there].reset_index(drop=True),
        traces=[whole.traces[number] for number in there],
    )
    return float(bt.fit(part, "impact", **FORMULA).ask(QUESTION)["posterior"].iloc[0])


def rows_of(number: int) -> pd.DataFrame:
    """A study that has ended both ways."""
    study, rows = study_of(number), []
    for way in WAYS:
        order, p = carried_on(study, way)
        row = {"way": way, "drops": PEOPLE * len(order)}
        row |= {"answer": "yes" if p > SURE else "no" if p < 1 - SURE else "", "posterior": p}
        row["by_fit"] = by_fit(study, order) if number < FITTED else np.nan
        rows.append(row | {"exponent": study.exponent, "order": " ".join(order)})
    return pd.DataFrame(rows)


def main() -> None:
    runtime.keep_compiled()
    measure("plan_after", range(NUMBER), rows_of)


if __name__ == "__main__":
    main()
