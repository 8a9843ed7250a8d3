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
from functools import partial

import numpy as np
import pandas as pd
from evidence import measure
from evidence.simulations import simulation, tables
from studies import CHAIN

from bayestissue.inference.checking.measuring_chain import (
    AMPLITUDE,
    JUDGED,
    RATE,
    alarmed,
    estimated_error,
)
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.studies.simulation import simulate

# One right set in 200 may alarm: of 300 by each likelihood at most eight then do, with a probability of 99 %.
SETS, RIGHT_SETS, PEOPLE = 40, 300, 4
# What is judged is each impact's own: a fit takes the gain that all share at what they tell of it.
OWN = {"gain_error": "impact"}


def campaign(sets: int) -> Dataset:
    """All sets as one dataset, each person in one of them."""
    own = {"design": {"subjects": PEOPLE * sets}, "recording": CHAIN | OWN}
    return simulate(simulation(tables(__file__)["campaign"], own)).dataset("chain")


def scaled(data: Dataset, column: str, factor: np.ndarray | float) -> Dataset:
    """What is stated, times a factor."""
    return replace(data, impacts=data.impacts.assign(**{column: data.impacts[column] * factor}))


def shifted(data: Dataset) -> Dataset:
    """Every stated velocity too high by two of its declared standard deviations."""
    v, chain = data.impacts["velocity_m_s"], data.uncertainty
    sd = np.hypot(chain.velocity_sd_m_s, chain.relative_gain_sd * v)
    return replace(data, impacts=data.impacts.assign(velocity_m_s=v + 2 * sd))


def one_bad(data: Dataset) -> Dataset:
    """One velocity of each set a tenth too high: of its first person in its first condition."""
    first = (number_of(data, "subject") % PEOPLE == 0) & (number_of(data, "trial") == 0)
    return scaled(data, "velocity_m_s", np.where(first, 1.1, 1.0))


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
    "velocity 10 % too high": partial(scaled, column="velocity_m_s", factor=1.1),
    "velocity 10 % too low": partial(scaled, column="velocity_m_s", factor=0.9),
    "velocity two declared sd too high": shifted,
    "one velocity of twenty 10 % too high": one_bad,
    "gain 5 % too high": gained,
    "zero moves by 2 m/s2 at contact": moved,
    "mass 10 % too high": partial(scaled, column="mass_kg", factor=1.1),
}


def number_of(data: Dataset, column: str) -> np.ndarray:
    """The number of each impact's person, the sets' one after the other, or condition."""
    return pd.factorize(data.impacts[column], sort=True)[0]


def judged(unit: tuple[str, str]) -> pd.DataFrame:
    """Of each set whether it raises an alarm, and how far off the traces put the velocity (median)."""
    likelihood, spoilt = unit
    specification = ModelSpecification.model_validate({"name": likelihood, "likelihood": likelihood} | OWN)
    sets = RIGHT_SETS if spoilt == "nothing" else SETS
    data = campaign(sets)
    # The priors are those of the sound recordings.
    model = prepare(data, specification, source="the model").model
    prepared = replace(prepare(SPOILT[spoilt](data), specification, source="the model"), model=model)
    errors = {error: estimated_error(prepared, error) for error in JUDGED}
    off, rows = errors[AMPLITUDE].error / errors[AMPLITUDE].unit, []
    person, condition = number_of(data, "subject"), number_of(data, "trial")
    for number in range(sets):
        own = person // PEOPLE == number
        groups = {"trial": condition[own], "subject": person[own] % PEOPLE}
        alarm = any(alarmed(each.z[own], groups, RATE / len(JUDGED)) for each in errors.values())
        rows.append({"alarm": alarm, "velocity_off": np.median(off[own])})
    return pd.DataFrame(rows).assign(likelihood=likelihood, spoilt=spoilt)


def main() -> None:
    """Measure each way of spoiling by each likelihood."""
    units = {f"{kind}: {name}": (kind, name) for name in SPOILT for kind in ("impact", "arma")}
    measure("measuring_chain", units, judged)


if __name__ == "__main__":
    main()
