"""A campaign of many impacts, simulated and fitted: time, memory, and whether intervals hold.

    .venv/bin/python benchmarks/many_impacts.py
    .venv/bin/python benchmarks/many_impacts.py --people 500

Everything runs as the commands that anyone would type. The memory is that of all processes of the fit at one
time, looked at four times a second. Each person is hit 200 times: a share of 90 % of 15 people's impacts is
known to 0.5 %. Of other numbers of people the row is printed and not kept.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import nullcontext
from pathlib import Path

import pandas as pd
from evidence import recorded

MASSES_KG = (0.375, 0.5, 0.666, 1.0, 1.333)
VELOCITIES_M_S = (0.8, 1.1, 1.4, 1.8)
SPECIFICATION = """
name = "many impacts"
seed = 7
[tissue]
K_N_per_m = 3000.0
C_N_s_per_m = 25.0
sd_subject_K = 0.2
sd_subject_C = 0.2
sd_trial_K = 0.03
sd_trial_C = 0.03
sd_impact_K = 0.05
sd_impact_C = 0.05
[recording]
sampling_rate_hz = 3000.0
before_contact_s = 0.005
after_contact_s = 0.005
noise_relative_to_peak = 0.003
noise_sd_m_s2 = 0.3
offset_sd_m_s2 = 0.2
relative_gain_sd = 0.005
velocity_sd_m_s = 0.005
relative_mass_sd = 0.002
[output]
traces = "parquet"
float32 = true
[design]
"""
SUBJECTS, REPEATS = 15, 10
COLUMN = {"K": "K_N_per_m", "C": "C_N_s_per_m"}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--people", type=int, default=SUBJECTS)
    people = parser.parse_args().people
    kept = recorded("many_impacts") if people == SUBJECTS else nullcontext()
    with kept as record, tempfile.TemporaryDirectory() as folder:
        row = report(simulated(Path(folder), people), Path(folder) / "run")
        if record is None:
            print(row)
        else:
            record.write([row])


def simulated(here: Path, subjects: int) -> Path:
    conditions = "".join(
        f'[[design.conditions]]\ntrial = "{mass:g} kg at {velocity:g} m/s"\n'
        f"mass_kg = {mass}\nvelocity_m_s = {velocity}\n"
        for mass in MASSES_KG
        for velocity in VELOCITIES_M_S
    )
    text = f"{SPECIFICATION}subjects = {subjects}\nrepeats = {REPEATS}\n{conditions}"
    (here / "spec.toml").write_text(text, encoding="utf-8")
    run("simulate", here / "spec.toml", "--out", here / "data", "--quiet")
    return here / "data"


def run(*arguments: object) -> subprocess.Popen[bytes]:
    process = subprocess.Popen([sys.executable, "-m", "bayestissue", *map(str, arguments)])  # noqa: S603
    process.wait()
    return process


def report(data: Path, out: Path) -> dict[str, object]:
    """Fit, and the row of the table."""
    before, start, memory = os.times(), time.perf_counter(), Memory()
    model = Path(__file__).resolve().parents[1] / "models" / "impact.toml"
    status = run("fit", data, "--model", model, "--out", out).returncode
    seconds, after, peak = time.perf_counter() - start, os.times(), memory.stop()
    processor = after.children_user + after.children_system - before.children_user - before.children_system
    checks = json.loads((out / "diagnostics.json").read_text(encoding="utf-8"))["checks"]
    summary = pd.read_csv(out / "summary.csv", dtype={"unit": str})
    truth = pd.read_csv(data / "truth.csv").set_index("impact")
    row: dict[str, object] = {"impacts": len(truth), "status": status}
    row |= {"minutes": seconds / 60, "processor_minutes": processor / 60, "memory_GiB": peak}
    row["results_GiB"] = sum(path.stat().st_size for path in out.iterdir()) / 2**30
    row |= {check["name"]: check["value"] for check in checks}
    for quantity, column in COLUMN.items():
        rows = summary[summary["variable"] == quantity].set_index("label")
        true = truth.loc[rows.index, column]
        for level in (50, 90):
            row[f"{quantity}_held_{level}"] = true.between(
                rows[f"eti{level}_low"], rows[f"eti{level}_high"]
            ).sum()
        row[f"{quantity}_off"] = (rows["median"] / true - 1).abs().median()
        row[f"{quantity}_width"] = ((rows["eti90_high"] - rows["eti90_low"]) / rows["median"]).median()
    return row


class Memory:
    """Greatest memory of this process's descendants together, GiB."""

    def __init__(self) -> None:
        self._peak, self._going = 0, True
        self._watch = threading.Thread(target=self._look, daemon=True)
        self._watch.start()

    def stop(self) -> float:
        """Look no more; what was the most."""
        self._going = False
        self._watch.join()
        return self._peak / 2**20

    def _look(self) -> None:
        while self._going:
            self._peak = max(self._peak, sum(kibibytes(child) for child in descendants(os.getpid())))
            time.sleep(0.25)


def descendants(process: int) -> list[int]:
    found = []
    for listed in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            children = [int(child) for child in listed.read_text().split()]
        except OSError:
            continue
        for child in children:
            found += [child, *descendants(child)]
    return found


def kibibytes(process: int) -> int:
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


if __name__ == "__main__":
    main()
