"""How often a fit says that the traces contradict the measuring chain, where it is right and where it is not.

    .venv/bin/python benchmarks/measuring_chain.py

Sets of twenty impacts, four people in five conditions at 2 kHz, with errors of mass, velocity, gain and
offset as declared (0.005 m/s, 0.5 % of the gain) and noise of 0.5 % of the peak, spoilt in one way each, are
judged as `bayestissue.inference.checking.measuring_chain` does, by the likelihoods "impact" and "arma". A row
a set says whether there was an alarm, and how far the traces put the velocity off (median).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from coverage import MEASURING_CHAIN
from evidence import recorded

from bayestissue.base import runtime
from bayestissue.inference.checking.incredible import RATE, alarms
from bayestissue.inference.checking.measuring_chain import AMPLITUDE, JUDGED, freed
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.studies.simulation import Simulation, simulate

# One right set in 200 may alarm: of 300 by each likelihood at most eight then do, with a probability of 99 %.
SETS, RIGHT_SETS, PEOPLE = 40, 300, 4
CONDITIONS = [(0.4, 1.2), (0.7, 1.2), (1.0, 1.0), (1.3, 0.9), (0.7, 0.8)]
SIZE = PEOPLE * len(CONDITIONS)


def campaign(sets: int) -> Dataset:
    """All sets as one dataset, each person in one of them."""
    content = {
        "name": "chain",
        "seed": 50_000,
        "design": {
            "subjects": PEOPLE * sets,
            "conditions": [
                {"trial": f"t{i}", "mass_kg": m, "velocity_m_s": v} for i, (m, v) in enumerate(CONDITIONS)
            ],
        },
        "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, "sd_subject_K": 0.2, "sd_impact_K": 0.05}
        | {"sd_subject_C": 0.2, "sd_impact_C": 0.05},
        "recording": {
            "sampling_rate_hz": 2000.0,
            **MEASURING_CHAIN,
        },
    }
    return simulate(Simulation.model_validate(content)).dataset("chain")


def scaled(column: str, factor: float) -> Callable[[Dataset], Dataset]:
    """What is stated, times a factor."""
    return lambda data: replace(data, impacts=data.impacts.assign(**{column: factor * data.impacts[column]}))


def shifted(data: Dataset) -> Dataset:
    """Every stated velocity too high by two of its declared standard deviations."""
    v, chain = data.impacts["velocity_m_s"], data.uncertainty
    sd = np.hypot(chain.velocity_sd_m_s, chain.relative_gain_sd * v)
    return replace(data, impacts=data.impacts.assign(velocity_m_s=v + 2 * sd))


def one_bad(data: Dataset) -> Dataset:
    """One velocity of each set a tenth too high: of its first person in its first condition."""
    first = (person_of(data) == 0) & (condition_of(data) == 0)
    v = data.impacts["velocity_m_s"]
    return replace(data, impacts=data.impacts.assign(velocity_m_s=v * np.where(first, 1.1, 1.0)))


def gained(data: Dataset) -> Dataset:
    """A recorder that reads 5 % too much."""
    return replace(data, traces=[Trace(each.time_s, 1.05 * each.value) for each in data.traces])


def moved(data: Dataset) -> Dataset:
    """A zero that moves by 2 m/s² where the trace has begun to rise."""
    traces = []
    for each in data.traces:
        begun = np.argmax(each.value > 0.1 * each.value.max()) - 1
        traces.append(Trace(each.time_s, each.value + 2.0 * (np.arange(each.value.size) >= begun)))
    return replace(data, traces=traces)


SPOILT: dict[str, Callable[[Dataset], Dataset]] = {
    "nothing": lambda data: data,
    "velocity 10 % too high": scaled("velocity_m_s", 1.1),
    "velocity 10 % too low": scaled("velocity_m_s", 0.9),
    "velocity two declared sd too high": shifted,
    "one velocity of twenty 10 % too high": one_bad,
    "gain 5 % too high": gained,
    "zero moves by 2 m/s2 at contact": moved,
    "mass 10 % too high": scaled("mass_kg", 1.1),
}


def person_of(data: Dataset) -> np.ndarray:
    """The number of each impact's person within the set."""
    return pd.factorize(data.impacts["subject"], sort=True)[0] % PEOPLE


def set_of(data: Dataset) -> np.ndarray:
    """The number of each impact's set."""
    return pd.factorize(data.impacts["subject"], sort=True)[0] // PEOPLE


def condition_of(data: Dataset) -> np.ndarray:
    """The number of each impact's condition."""
    return pd.factorize(data.impacts["trial"], sort=True)[0]


def judged(likelihood: str, spoil: Callable[[Dataset], Dataset], sets: int) -> pd.DataFrame:
    """Of each set whether it raises an alarm, and how far off the traces put the velocity (median)."""
    specification = ModelSpecification.model_validate({"name": likelihood, "likelihood": likelihood})
    data = campaign(sets)
    # The priors are those of the sound recordings.
    model = prepare(data, specification, source="the model").model
    prepared = replace(prepare(spoil(data), specification, source="the model"), model=model)
    errors = {error: freed(prepared, error) for error in JUDGED}
    off, rows = errors[AMPLITUDE].error / errors[AMPLITUDE].unit, []
    for number in range(sets):
        own = set_of(data) == number
        groups = {"trial": condition_of(data)[own], "subject": person_of(data)[own]}
        alarm = any(alarms(each.z[own], groups, RATE / len(JUDGED)).any for each in errors.values())
        rows.append({"alarm": alarm, "velocity_off": np.median(off[own])})
    return pd.DataFrame(rows)


def main() -> None:
    """Measure each way of spoiling by each likelihood."""
    runtime.configure()
    with recorded("measuring_chain") as record:
        units = {f"{kind}: {name}": (kind, name) for name in SPOILT for kind in ("impact", "arma")}
        for unit in record.missing(units):
            likelihood, name = units[unit]
            rows = judged(likelihood, SPOILT[name], RIGHT_SETS if name == "nothing" else SETS)
            record.add(unit, rows.assign(likelihood=likelihood, spoilt=name))


if __name__ == "__main__":
    main()
