"""A plan that goes on from a running study agrees with the fit of what is there, and tells what more adds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base import runtime
from bayestissue.studies.planning.assurance import Goal, Planner, planner
from bayestissue.studies.planning.information import simulation_of
from bayestissue.studies.planning.planned_population import Pilot, PlannedPopulation
from bayestissue.studies.planning.running import RunningPrior, running_study
from bayestissue.studies.simulation import simulate
from bayestissue.studies.simulation.simulation_file import Recording
from campaigns import spreads, study
from counted import COMPILED, counted

pytestmark = pytest.mark.slow

FORMULA = "log(mass_kg) + (1|subject)"
RECORDING = {"noise_relative_to_peak": 0.005, "velocity_sd_m_s": 0.005, "relative_mass_sd": 0.002}


class Begun(NamedTuple):
    fit: bt.Fit
    further: list[pd.DataFrame]
    planner: Planner
    # Programs by this fit and then by one of another dataset of the same design.
    compiled: tuple[int, int]


@pytest.fixture(scope="module")
def begun() -> Begun:
    tissue = {"mass_exponent_K": 0.3, **spreads(subject=0.2, impact=0.1)}
    simulation = study(tissue, RECORDING, people=5, masses=(0.5, 1.0), seed=4)
    dataset = simulate(simulation).dataset("running")
    # As in a new process: after many tests a fit would do so itself, between the two that are counted.
    runtime.release_compiled(0)
    with counted() as events:
        fit = bt.fit(dataset, "impact", K=FORMULA, C=FORMULA)
    again = simulate(simulation.model_copy(update={"seed": 5})).dataset("again")
    with counted() as of_another:
        bt.fit(again, "impact", K=FORMULA, C=FORMULA)
    assert fit.prepared is not None
    specification = fit.specification
    running = running_study(fit.prepared, specification)
    posterior = fit.posterior["posterior"].to_dataset()
    draws = {
        str(name): array.to_numpy().ravel()
        for name, array in posterior.data_vars.items()
        if array.dims == ("chain", "draw")
    }
    pilot = Pilot(draws, float(fit.prepared.design.reference_mass_kg), PlannedPopulation())
    nobody = running.rows[:0]
    more = pd.concat(
        [running.rows[running.rows["subject"] == "s01"].assign(subject=f"new{n}") for n in range(10)]
    )
    further = [nobody, more]
    ready = planner(
        further,
        specification,
        RunningPrior.of_posterior(posterior, pilot, running.rows["mass_kg"].to_numpy()),
        simulation_of(Recording.model_validate(RECORDING)),
        running=running,
    )
    return Begun(fit, further, ready, (events[COMPILED], of_another[COMPILED]))


def test_a_fit_works_as_little_as_it_did(begun: Begun) -> None:
    """Counts of a small fit, the same on any machine but for what is stated."""
    first, again = begun.compiled
    # Programs of a new process: what another test has compiled is not compiled again. Two more are let pass.
    assert first <= 70
    # Traces of other lengths have a few programs of their own.
    assert again <= 20
    # Bytes of 4,000 draws of 10 impacts, exactly.
    assert sum(part.to_dataset().nbytes for part in begun.fit.posterior.subtree) <= 9_933_284


def test_without_further_impacts_a_plan_says_what_the_fit_says(begun: Begun) -> None:
    fitted = begun.fit.posterior["posterior"]["mass_exponent_K"].to_numpy()
    goals = [Goal("claim", "mass_exponent_K > 0.2"), Goal("width", "mass_exponent_K", width=0.1)]
    goals.append(Goal("middle", f"mass_exponent_K > {np.median(fitted):.6g}"))
    (now, _) = begun.planner.assess(goals, range(1))
    # All studies are the same one, each with points of its own: their scatter is what these are wrong by.
    assert np.std(now[0].p) < 0.05
    low, high = np.quantile(fitted, [0.05, 0.95])
    # Within a tenth of a standard deviation.
    assert now[2].p.mean() == pytest.approx(0.5, abs=0.04)
    assert now[1].width.mean() == pytest.approx((high - low) / 2, rel=0.1)
    assert now[0].p.mean() == pytest.approx((fitted > 0.2).mean(), abs=0.05)


def test_further_people_tell_more(begun: Begun) -> None:
    goals = [Goal("claim", "mass_exponent_K > 0.2"), Goal("width", "mass_exponent_K", width=0.1)]
    now, later = begun.planner.assess(goals, range(3))
    assert later[1].width.mean() < 0.8 * now[1].width.mean()
    assert later[0].numbers()["undecided_bits"] < now[0].numbers()["undecided_bits"]
    # What is going to be said is, on average, what is said now: probabilities are a martingale.
    error = later[0].p.std() / np.sqrt(later[0].studies)
    assert abs(later[0].p.mean() - now[0].p.mean()) < 3 * error + 0.02
