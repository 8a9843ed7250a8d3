"""Calibration of fits of a design with two sides a person, sessions, and people's own mass exponents.

    .venv/bin/python benchmarks/calibration_designs.py
    .venv/bin/python benchmarks/calibration_designs.py --lane 1 --lanes 2    # a half, beside --lane 2

As calibration.py does it: 300 times everything is drawn from the model itself, top down, the draw is fitted
as `path = "automatic"` does it, and the rank of each drawn value among 99 thinned draws is uniform if that
samples the posterior. Of the effects the first level's are ranked, and the first person's own mass exponent.
Five people are hit on two sides in four conditions, 0.375 to 1.333 kg, each impact in one of four sessions.
Ranks are added to calibration_ranks_designs.csv as they are made; the same command goes on where it stopped,
and puts the table of tests into calibration.csv. Model: calibration-designs.toml.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from pathlib import Path

import numpy as np
import pandas as pd
from calibration import drawing, ranks_of_one, table, with_traces
from coverage_fit import campaign, kept_with

from bayestissue import runtime
from bayestissue.hierarchy.specification import read_specification
from bayestissue.hierarchy.trace_data import Prepared, prepare
from bayestissue.simulation import simulate

CAMPAIGNS, SAMPLES, SEED = 300, 110, 2027
HERE = Path(__file__).parent
RANKS_FILE = HERE / "calibration_ranks_designs.csv"
FACTORS = (
    {"name": "side", "levels": ["left", "right"]},
    {"name": "session", "levels": 4, "every": False},
)


def blank() -> Prepared:
    """Model, design and measuring chain, with traces of which only the start is told."""
    specification = read_specification(HERE / "calibration-designs.toml")
    made = campaign(0)
    design = type(made.design).model_validate({**made.design.model_dump(), "factors": FACTORS})
    dataset = simulate(made.model_copy(update={"design": design})).dataset("calibration")
    prepared = prepare(dataset, specification, source="the model file")
    start = np.zeros((len(prepared.impacts), SAMPLES))
    start[:, 1] = prepared.signal.velocity * prepared.signal.dt
    return with_traces(prepared, start)


def made_before() -> pd.DataFrame:
    """The ranks of earlier calls, each campaign once."""
    if not RANKS_FILE.is_file():
        return pd.DataFrame({"campaign": []})
    return pd.read_csv(RANKS_FILE).drop_duplicates("campaign").sort_values("campaign", ignore_index=True)


def add(row: dict[str, float]) -> None:
    """Add a line, after a header where there is none; in one write, so that two lanes may share the file."""
    frame = pd.DataFrame([row])
    with contextlib.suppress(FileExistsError), RANKS_FILE.open("x", encoding="utf-8") as file:
        file.write(",".join(frame.columns) + "\n")
    with RANKS_FILE.open("a", encoding="utf-8") as file:
        file.write(frame.to_csv(index=False, header=False, float_format="%.3f", lineterminator="\n"))


def run(campaigns: int, seconds: float, lane: int, lanes: int) -> None:
    """Fit the campaigns of one lane that no earlier call has fitted."""
    base, begun = blank(), time.perf_counter()
    draw = drawing(base)
    groups = [
        term.effect(q) for q in "KC" for term in base.design.responses[q].terms if term.grouping != "trial"
    ]
    before = set(made_before()["campaign"])
    for number in range(lane - 1, campaigns, lanes):
        if number in before:
            continue
        if time.perf_counter() - begun > seconds:
            break
        add({"campaign": number} | ranks_of_one(base, draw, number, SEED, groups=groups))
        print(f"campaign {number}: {time.perf_counter() - begun:.0f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Calibration of fits of a design with further group terms.")
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS, help="in all, those of earlier calls too")
    parser.add_argument("--seconds", type=float, default=np.inf, help="begin no campaign after these")
    parser.add_argument("--lane", type=int, default=1, help="which share of the campaigns, from 1")
    parser.add_argument("--lanes", type=int, default=1, help="how many shares there are")
    asked = parser.parse_args()
    runtime.configure()
    run(asked.campaigns, asked.seconds, asked.lane, asked.lanes)
    found = made_before()
    command = "benchmarks/calibration_designs.py"
    command += f" --campaigns {len(found)}" if len(found) != CAMPAIGNS else ""
    result = table("designs", found.drop(columns="campaign"), command)
    print(result.drop(columns=["likelihood", "command"]).to_string(index=False))
    kept_with(HERE / "calibration.csv", result, "likelihood")


if __name__ == "__main__":
    main()
