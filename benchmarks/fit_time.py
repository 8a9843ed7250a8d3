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
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from itertools import product
from pathlib import Path
from typing import Any

from coverage import FILES, ROOT
from evidence import recorded
from evidence.references import TISSUES as OF_ELEMENTS

from bayestissue.mechanics.elements import element, element_names
from bayestissue.model.hierarchy.specification import SIDE_BY_SIDE
from bayestissue.studies.simulation import Simulation, simulate, write_campaign

EXAMPLE = ROOT / "data" / "example"
TISSUES = ("example", "own")
# Beyond this the answer is known, and how much later it would come is not asked.
MOST_S = 900


def campaign_of(name: str | None, **changed: Any) -> Simulation:
    """The example campaign on a tissue of this element, its own unless given."""
    made = tomllib.loads((EXAMPLE / "spec.toml").read_text(encoding="utf-8")) | changed
    if name is not None:
        made["tissue"] |= {"element": name, **OF_ELEMENTS[name]}
        if element(name).extra:
            made["tissue"]["sd_impact_parameters"] = 0.05
    return Simulation.model_validate(made)


def written(made: Simulation, folder: Path) -> Path:
    """A campaign in a folder of its own."""
    folder.mkdir()
    write_campaign(folder, simulate(made), made)
    return folder


def timed(
    datasets: dict[str, Path], name: str, folder: Path, program: Path, cores: int
) -> tuple[dict[str, float], Path]:
    """Seconds of the clock and of the processor of every run, and the folder of the last."""
    environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
    environment |= {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPATH": str(program / "src")}
    free = os.sched_getaffinity(0)
    found, model = {}, str(program / "models" / f"{FILES.get(name, name)}.toml")
    for run, dataset in datasets.items():
        out = folder / run
        command = [sys.executable, "-m", "bayestissue", "fit", str(dataset), "--out", str(out)]
        begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        # The command inherits what this process is bound to.
        os.sched_setaffinity(0, sorted(free)[:cores])
        try:
            command += ["--model", model, "--quiet"]
            subprocess.run(command, env=environment, timeout=MOST_S, check=False)  # noqa: S603 - our own program
        except subprocess.TimeoutExpired:
            return found | {f"{run}_s": MOST_S}, out
        finally:
            os.sched_setaffinity(0, free)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        found[f"{run}_s"] = round(time.perf_counter() - begun, 1)
        found[f"{run}_cpu_s"] = round(sum(after[:2]) - sum(before[:2]), 1)
    return found, out


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


def row_of(name: str, tissue: str, program: Path, cores: int) -> dict[str, Any]:
    """One element on one tissue."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if tissue == "example":
            # Of 81 impacts instead of 90, and traces of other lengths.
            fewer = campaign_of(None, seed=77, design={"subjects": 9, "repeats": 1})
            runs = {"first": EXAMPLE, "again": EXAMPLE, "other": written(fewer, folder / "other_campaign")}
        else:
            half = campaign_of(name, design={"subjects": 5, "repeats": 1})
            runs = {"first": written(half, folder / "campaign")}
        seconds, out = timed(runs, name, folder, program, cores)
        found = told(out.with_name("first"))
    return {"element": name, "tissue": tissue, "cores": cores, **seconds, **found}


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
        for name, tissue, cores, program in product(asked.elements, asked.tissue, asked.cores, asked.program):
            print({"program": program.name} | row_of(name, tissue, program.resolve(), cores), flush=True)
        return
    for name in asked.elements:
        with recorded(f"fit_time-{name}") as record:
            # The example is a spring and damper; other elements are timed on tissue of their own kind.
            for tissue in record.missing(["example" if name == SIDE_BY_SIDE else "own"]):
                record.add(tissue, [row_of(name, tissue, ROOT, 2)])


if __name__ == "__main__":
    main()
