"""How many fits end with draws that pass, and what they cost: clean sets of few impacts, campaigns.

    .venv/bin/python benchmarks/fits_pass.py clean
    .venv/bin/python benchmarks/fits_pass.py stiffening wall

``clean``: one, two, four and eight impacts of a spring and damper whose noise is 0.5 % of the peak, twelve
seeds of each, fitted by the model file `impact` with the default sampler. An element's name: the fifteen
campaigns of coverage.py, fitted by the element's own model file. What is compiled for one fit serves the
next of its kind, as in a process that fits many; each row says how long it took the processor in all.

Rows are added to results/fits_pass.csv, one a fit: a script that is stopped goes on where it was. Numbers
after ``from=`` begin with that one.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from coverage import campaign
from evidence.simulations import simulation, tables
from studies import CHAIN, model_of

from bayestissue.base import runtime
from bayestissue.inference.chain.draws import ChainJob
from bayestissue.inference.fit import fit_traces
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.studies.simulation import Simulation, simulate

SEEDS, CAMPAIGNS = 12, 15
TABLES = tables(__file__)
PATH = Path(__file__).parent / "results" / "fits_pass.csv"


def cases(kind: str) -> Iterator[tuple[str, int, Simulation, str]]:
    """Of each fit its kind, number, simulation and model file."""
    if kind != "clean":
        yield from ((kind, number, campaign(kind, number), kind) for number in range(CAMPAIGNS))
        return
    for size, design in TABLES["sizes"].items():
        for seed in range(SEEDS):
            clean = simulation(TABLES["campaign"], design=design, recording=CHAIN, seed=seed)
            yield f"clean {size}", seed, clean, "impact"


def fitted(made: Simulation, model: str, seed: int) -> dict[str, Any]:
    """The verdict of one fit, and its cost."""
    specification = model_of(model)
    prepared = prepare(simulate(made).dataset(made.name), specification, source="the model file")
    start, worked = time.monotonic(), time.process_time()
    diagnostics = fit_traces(ChainJob(prepared, specification.sampler, seed), specification).diagnostics
    worst = diagnostics["worst"]["r_hat"]
    return {
        "impacts": len(prepared.impacts),
        "passed": diagnostics["passed"],
        "r_hat": round(worst["value"], 4),
        "of": worst["variable"],
        "segments": diagnostics["route"]["segments"],
        "seconds": round(time.monotonic() - start, 1),
        "processor_s": round(time.process_time() - worked, 1),
    }


def main() -> None:
    runtime.configure()
    first = [int(word.removeprefix("from=")) for word in sys.argv[1:] if word.startswith("from=")] or [0]
    known = set(pd.read_csv(PATH)[["kind", "number"]].itertuples(False, None)) if PATH.is_file() else set()
    for kind in (word for word in sys.argv[1:] if not word.startswith("from=")):
        for name, number, made, model in cases(kind):
            if (name, number) in known or number < first[0]:
                continue
            # What is compiled for many shapes takes more mapped memory than a process may have.
            runtime.release_compiled()
            row = {"kind": name, "number": number} | fitted(made, model, number)
            pd.DataFrame([row]).to_csv(PATH, mode="a", header=not PATH.is_file(), index=False)
            print(row, flush=True)
    table = pd.read_csv(PATH).groupby("kind")
    columns = {"fits": ("passed", "size"), "passed": ("passed", "sum")}
    columns |= {"median_s": ("processor_s", "median"), "longest_s": ("processor_s", "max")}
    print(table.agg(**columns).to_string())


if __name__ == "__main__":
    main()
