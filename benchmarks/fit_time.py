"""How long `bayestissue fit` takes from command to finished report, by every element, and how it converged.

    .venv/bin/python benchmarks/fit_time.py
    .venv/bin/python benchmarks/fit_time.py --elements maxwell wall --tissue own
    .venv/bin/python benchmarks/fit_time.py --elements maxwell --tissue own --cores 1 2 --program OLD .

Each element's model file fits the example campaign (90 impacts, a spring and damper side by side), and the
same campaign of half of its people made by a tissue of its own kind. `first` is with nothing compiled yet. On
the example `again` is the same command once more, and `other` the same command on a campaign of nine people
instead of ten.
Seconds of the clock, and of the processor (`_cpu_s`), which other work on the machine changes less.
`--program` names checkouts whose programs are timed in turn, all by this Python and its libraries; `--cores`
how many cores each is bound to.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import tomllib
from itertools import product
from pathlib import Path
from typing import Any

from evidence import recorded
from evidence.commands import timed
from evidence.references import varied_tissue
from evidence.registry import ROOT
from evidence.simulations import merged

from bayestissue.mechanics.elements import element_names
from bayestissue.model.hierarchy.specification import SIDE_BY_SIDE
from bayestissue.studies.simulation import Simulation, simulate, write_campaign

EXAMPLE = ROOT / "data" / "example"
TISSUES = ("example", "own")
# Beyond this the answer is known, and how much later it would come is not asked.
MOST_S = 900


def campaign_of(name: str | None, **changed: Any) -> Simulation:
    """The example campaign on a tissue of this element, its own unless given."""
    made = tomllib.loads((EXAMPLE / "spec.toml").read_text(encoding="utf-8")) | changed
    return Simulation.model_validate(merged(made, {} if name is None else {"tissue": varied_tissue(name)}))


def written(made: Simulation, folder: Path) -> Path:
    """A campaign in a folder of its own."""
    folder.mkdir()
    write_campaign(folder, simulate(made), made)
    return folder


def seconds_of(
    datasets: dict[str, Path], name: str, folder: Path, program: Path, cores: int
) -> dict[str, float]:
    """Seconds of the clock and of the processor of every run, a folder each."""
    variables = {"XDG_CACHE_HOME": str(folder / "cache"), "JAX_COMPILATION_CACHE_DIR": None}
    model = program.resolve() / "models" / f"{'impact' if name == SIDE_BY_SIDE else name}.toml"
    free, found = os.sched_getaffinity(0), {}
    # The command inherits what this process is bound to.
    os.sched_setaffinity(0, sorted(free)[:cores])
    try:
        for run, dataset in datasets.items():
            command = ("fit", dataset, "--out", folder / run, "--model", model, "--quiet")
            spent = timed(*command, program=program, most_s=MOST_S, **variables)
            found |= {f"{run}_{clock}": seconds for clock, seconds in spent.items()}
    except subprocess.TimeoutExpired:
        found[f"{run}_s"] = MOST_S
    finally:
        os.sched_setaffinity(0, free)
    return found


def told(out: Path) -> dict[str, Any]:
    """How the run in this folder converged."""
    if not (out / "diagnostics.json").is_file():
        return {}
    found = json.loads((out / "diagnostics.json").read_text(encoding="utf-8"))
    run = json.loads((out / "run.json").read_text(encoding="utf-8"))
    return {
        "discrepancy": run.get("discrepancy", {}).get("rms_of_peak", 0.0),
        "r_hat": round(found["worst"]["r_hat"]["value"], 4),
        "ess": round(min(found["worst"]["ess_bulk"]["value"], found["worst"]["ess_tail"]["value"])),
        "passed": found["passed"],
    }


def row_of(name: str, kind: str, program: Path, cores: int) -> dict[str, Any]:
    """One element on one tissue."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if kind == "example":
            # Of 81 impacts instead of 90, and traces of other lengths.
            fewer = campaign_of(None, seed=77, design={"subjects": 9, "repeats": 1})
            runs = {"first": EXAMPLE, "again": EXAMPLE, "other": written(fewer, folder / "other_campaign")}
        else:
            half = campaign_of(name, design={"subjects": 5, "repeats": 1})
            runs = {"first": written(half, folder / "campaign")}
        seconds = seconds_of(runs, name, folder, program, cores)
        return {"element": name, "tissue": kind, "cores": cores, **seconds, **told(folder / "first")}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--elements", nargs="+", choices=element_names(), default=element_names())
    parser.add_argument("--tissue", nargs="+", choices=TISSUES, default=TISSUES)
    parser.add_argument("--program", nargs="+", type=Path, default=[ROOT], help="checkouts to time")
    parser.add_argument("--cores", nargs="+", type=int, default=[2], help="how many cores it is bound to")
    asked = parser.parse_args()
    if (asked.program, asked.cores, tuple(asked.tissue)) != ([ROOT], [2], TISSUES):
        for name, kind, cores, program in product(asked.elements, asked.tissue, asked.cores, asked.program):
            print({"program": program.name} | row_of(name, kind, program.resolve(), cores), flush=True)
        return
    for name in asked.elements:
        with recorded(f"fit_time-{name}") as record:
            # The example is a spring and damper; other elements are timed on tissue of their own kind.
            for kind in record.missing(["example" if name == SIDE_BY_SIDE else "own"]):
                record.add(kind, row_of(name, kind, ROOT, 2))


if __name__ == "__main__":
    main()
