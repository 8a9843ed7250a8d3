"""How long `bayestissue fit` takes from command to finished report, by every element, and how it converged.

    .venv/bin/python benchmarks/fit_time.py
    .venv/bin/python benchmarks/fit_time.py --elements maxwell wall --tissue own

Each element's model file fits the example campaign (90 impacts, a spring and damper side by side), and the
same campaign made by a tissue of its own kind. `first` is with nothing compiled yet, `again` the same command
once more. Times are of the clock: bind the script to two cores that nothing else uses. A row goes to
fit_time.csv as soon as it is there; earlier rows of the same kind go.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import pandas as pd
from coverage_elements import FILES, ROOT, TISSUE
from coverage_fit import kept_with

from bayestissue.elements import element, element_names
from bayestissue.simulation import Simulation, simulate, write_campaign

TABLE = ROOT / "benchmarks" / "fit_time.csv"
EXAMPLE = ROOT / "data" / "example"
TISSUES = ("example", "own")
# Beyond this the answer is known, and how much later it would come is not asked.
MOST_S = 900


def campaign_of(name: str) -> Simulation:
    """The example campaign on a tissue of this element."""
    made = tomllib.loads((EXAMPLE / "spec.toml").read_text(encoding="utf-8"))
    made["tissue"] |= {"element": name, **TISSUE[name]}
    if element(name).extra:
        made["tissue"]["sd_impact_parameters"] = 0.05
    return Simulation.model_validate(made)


def timed(dataset: Path, name: str, folder: Path) -> tuple[float, float, dict[str, Any]]:
    """Seconds of the first and of the second run, and the second's folder in short."""
    out = folder / "run"
    command = [sys.executable, "-m", "bayestissue", "fit", str(dataset), "--out", str(out), "--overwrite"]
    command += ["--model", str(ROOT / "models" / f"{FILES.get(name, name)}.toml"), "--quiet"]
    environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(folder / "cache")
    seconds = []
    for _ in ("first", "again"):
        begun = time.perf_counter()
        try:
            subprocess.run(command, env=environment, timeout=MOST_S, check=False)  # noqa: S603 - our own program
        except subprocess.TimeoutExpired:
            return MOST_S, MOST_S, {}
        seconds.append(time.perf_counter() - begun)
    return seconds[0], seconds[1], told(out)


def told(out: Path) -> dict[str, Any]:
    """How the run in this folder converged, and by which path."""
    found = json.loads((out / "diagnostics.json").read_text(encoding="utf-8"))
    run = json.loads((out / "run.json").read_text(encoding="utf-8"))
    values = {check["name"]: check["value"] for check in found["checks"]}
    return {
        "path": "summary" if "Pareto k of the correction" in values else "exact",
        "discrepancy": run.get("discrepancy", {}).get("rms_of_peak", 0.0),
        "r_hat": round(found["worst"]["r_hat"]["value"], 4),
        "ess": round(min(found["worst"]["ess_bulk"]["value"], found["worst"]["ess_tail"]["value"])),
        "divergences": values["divergent transitions"],
        "passed": found["passed"],
    }


def row_of(name: str, tissue: str) -> dict[str, Any]:
    """One element on one tissue."""
    with tempfile.TemporaryDirectory() as temporary:
        dataset = EXAMPLE
        if tissue == "own":
            dataset, made = Path(temporary) / "campaign", campaign_of(name)
            dataset.mkdir()
            write_campaign(dataset, simulate(made), made)
        first, again, found = timed(dataset, name, Path(temporary))
    return {
        "element": name,
        "tissue": tissue,
        "first_s": round(first, 1),
        "again_s": round(again, 1),
        **found,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--elements", nargs="+", choices=element_names(), default=element_names())
    parser.add_argument("--tissue", nargs="+", choices=TISSUES, default=TISSUES)
    asked = parser.parse_args()
    for tissue in asked.tissue:
        for name in asked.elements:
            command = f"benchmarks/fit_time.py --elements {name} --tissue {tissue}"
            kept_with(TABLE, pd.DataFrame([row_of(name, tissue) | {"command": command}]), "command")


if __name__ == "__main__":
    main()
