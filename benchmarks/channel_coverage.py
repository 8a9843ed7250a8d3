"""How often intervals hold the truth where more was recorded than decelerations: simulated, fitted.

    .venv/bin/python benchmarks/channel_coverage.py force
    .venv/bin/python benchmarks/channel_coverage.py moving_mass 18

`force`: studies of four people hit with four masses, every second one along gravity. All declared masses are
wrong by one factor, known to 5 %; the accelerometer's gain is known to 0.5 % and the load cell's to 1 %, one
gain of the load cell a study. Of three studies one has a force plate below the tissue, two a load cell with
50 g in front of it. Noted of each are the 90 % intervals of the factor, of both gains, of K, C and the mass
of each impact and of the mass exponents, how far the masses are off, and whether the first line says so.

`moving_mass`: tissue moves along, and is fitted so. Studies are in turn of three kinds: a force plate below
the tissue and two masses; the accelerometer alone and two masses; the accelerometer alone, one mass, and a
velocity that is known to 30 % only. m is drawn between 0.03 and 0.3 kg. One error of velocity and of the
plate's gain is common to all impacts of a study. Noted are the 90 % intervals of K, C and m of each impact,
and whether the fit says that m's mean is known.

`phantoms`: studies of four people hit with two masses, beside eight impacts of one spring of 2500 N/m known
to 1 %. By turns the declared masses are 6 % too small, or the accelerometer reads 6 % too much, with people
of damping ratio 0.1 or 0.4; mass and gain are declared to 5 %. Noted are the 90 % intervals of K and C of
each impact, by the fit with the phantom and by one of the people alone.

A number is of the studies to do in all; those that were done are not done again.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from evidence.simulations import simulation, tables
from scipy.stats import gmean
from studies import Fitted, Interval, counted, ends, fitted, of_draws, sides

import bayestissue as bt
from bayestissue.inference.checking.mass_checks import judge_added_mass, judge_force
from bayestissue.inference.quantities.quantity_draws import prior_draws
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.recordings.dataset.impact_table import REFERENCE
from bayestissue.studies.simulation import simulate

TABLES = tables(__file__)
# What residuals say of a force that follows the law of the deceleration; of these they are not asked.
NOISE = {"structured": False, "below": 0, "tested": 0, "combined": 1.0, "names": []}
FOLLOWS = {"structured": False, "score": 0.0, "impacts": NOISE}
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m", "mass": "mass_kg", "moving_mass_kg": "moving_mass_kg"}


def declared(kind: str, **more: float) -> Uncertainty:
    """What the lab says of its measuring chain."""
    return Uncertainty.model_validate(TABLES["declared"][kind] | more)


def of_impacts(of: str, fit: Fitted, truth: pd.DataFrame, *names: str) -> Iterator[Interval]:
    """Of each quantity of the impacts the ends and the truth."""
    for name in names:
        yield Interval(of, name, ends(fit.posterior[name]), truth[COLUMNS[name]].to_numpy())


def force(number: int) -> dict[str, Any]:
    """A study with a force beside the deceleration."""
    known = declared("force")
    factor = float(np.exp(known.relative_mass_sd * np.random.default_rng([number, 11]).standard_normal()))
    place = {"place": "impactor", "tip_mass_kg": 0.05} if number % 3 else {"place": "base"}
    recording = {"mass_factor": factor, "force": place}
    gravity = "drop" if number % 2 else "none"
    content = simulation(TABLES["force"], recording=recording, seed=number, gravity=gravity)
    made = simulate(content)
    fit, truth = fitted(made.dataset("force").with_settings(uncertainty=known), number), made.truth
    assert fit.prepared.force is not None
    account = judge_force(fit.prepared.force, fit.posterior, fit.prepared.signal.mass, FOLLOWS)
    common = {
        "mass_factor": factor,
        "gain_factor": truth["force_gain"].iloc[0] / gmean(truth["gain"]),
        "mass_exponent_K": 0.0,
        "mass_exponent_C": 0.0,
    }
    of = place["place"]
    intervals = [Interval(of, name, ends(fit.posterior[name]), true) for name, true in common.items()]
    row = sides([*intervals, *of_impacts(of, fit, truth, "K", "C", "mass")])
    return row | {"passed": fit.passed, "off": abs(factor - 1), "named": bool(account["first"])}


def moving_mass(number: int) -> dict[str, Any]:
    """A study of tissue that moves along: the lab has the velocity that it aimed at, and what it declares."""
    random, kind = np.random.default_rng([number, 17]), ("force", "velocity", "neither")[number % 3]
    masses, velocity, sd = ((0.5, 0.5), 1.5, 0.3) if kind == "neither" else ((0.5, 1.0), 1.5, 0.01)
    # What all impacts share of the velocity's error.
    shared = (sd / 3 if kind == "neither" else sd) * random.standard_normal()
    conditions = [(f"t{k}", mass, velocity * (1 + shared)) for k, mass in enumerate(masses)]
    own = {
        "design": {"conditions": conditions},
        "tissue": {"parameters": {"moving_mass_kg": float(0.03 * 10 ** random.uniform())}},
        "recording": {"force": TABLES["plate"]} if kind == "force" else {},
    }
    made = simulate(simulation(TABLES["moving_mass"], own, name=kind, seed=number))
    dataset = made.dataset(kind)
    dataset = replace(dataset, impacts=dataset.impacts.assign(velocity_m_s=velocity)).with_settings(
        uncertainty=declared("moving_mass", velocity_sd_m_s=velocity * sd)
    )
    fit = fitted(dataset, number, {"like": "moving_mass"})
    of_prior = prior_draws(fit.prepared, number)
    account = judge_added_mass(fit.prepared, fit.posterior, of_draws(fit.prepared, of_prior, number))
    row = sides(of_impacts(kind, fit, made.truth, "K", "C", "moving_mass_kg"))
    return row | {"passed": fit.passed, "kind": kind, "told": account["passed"]}


def with_phantom(number: int) -> tuple[bt.Dataset, pd.DataFrame]:
    """People and a phantom, and the people's truth; all random numbers follow from the study's number."""
    off, C = divmod(number % 4, 2)
    factor, gain = (1.0, 1.06) if off else (1.06, 1.0)
    own = {"tissue": {"C_N_s_per_m": (10.0, 35.0)[C]}, "recording": {"mass_factor": factor}}
    contents = {"people": [TABLES["people"], own], "phantom": [TABLES["people"], own, TABLES["phantom"]]}
    truth, impacts, traces = pd.DataFrame(), [], []
    for which, (name, content) in enumerate(contents.items()):
        made = simulate(simulation(*content, seed=2 * number + which))
        part = made.dataset(name)
        table = part.impacts.assign(impact=name + "-" + part.impacts["impact"].astype(str))
        table[list(REFERENCE)] = np.nan
        if name == "phantom":
            stated = (
                made.truth["K_N_per_m"].iloc[0] + 25.0 * np.random.default_rng([number, 7]).standard_normal()
            )
            table = table.assign(subject="phantom", **dict(zip(REFERENCE, (stated, 25.0), strict=True)))
        else:
            truth = made.truth.set_index("people-" + made.truth["impact"].astype(str))
        impacts.append(table)
        traces += [
            pd.DataFrame({"impact": impact, "time_s": trace.time_s, "value": gain * trace.value})
            for impact, trace in zip(table["impact"], part.traces, strict=True)
        ]
    tables = (pd.concat(each, ignore_index=True) for each in (impacts, traces))
    known = declared("phantoms")
    return bt.dataset(*tables, quantity="deceleration", unit="m/s^2", uncertainty=known), truth


def phantoms(number: int) -> dict[str, Any]:
    """A study that also hit a spring of known stiffness, fitted with it and without."""
    dataset, truth = with_phantom(number)
    people = dataset.select(dataset.impacts[REFERENCE[0]].isna().to_numpy())
    alone = people.impacts.drop(columns=list(REFERENCE)).reset_index(drop=True)
    fits = {"with": fitted(dataset, number), "without": fitted(replace(people, impacts=alone), number)}
    intervals: list[Interval] = []
    for which, fit in fits.items():
        of = f"{'gain' if number % 4 > 1 else 'mass'} off, {which} the spring"
        own = truth.loc[fit.posterior["impact"].to_numpy().astype(str)]
        intervals += of_impacts(of, fit, own, "K", "C")
    return sides(intervals) | {"passed": all(fit.passed for fit in fits.values())}


# By kind the piece of evidence, and how many studies know a share of 90 % to 2, 4 and 7 %.
KINDS = {
    "force": ("coverage_channels-force", force, 200),
    "moving_mass": ("coverage_channels-moving_mass", moving_mass, 60),
    "phantoms": ("coverage_phantoms", phantoms, 80),
}


def main() -> None:
    counted(*KINDS[sys.argv[1]])


if __name__ == "__main__":
    main()
