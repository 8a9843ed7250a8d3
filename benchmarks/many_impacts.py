"""A campaign of a hundred thousand impacts, simulated and fitted: time, memory, and whether intervals hold.

    .venv/bin/python benchmarks/many_impacts.py arma impact
    .venv/bin/python benchmarks/many_impacts.py impact --subjects 50

Everything runs as the commands that anyone would type. The memory is that of all processes of the fit at one
time, looked at four times a second. A row a model goes to many_impacts.csv.
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
TABLE = Path(__file__).with_suffix(".csv")
COLUMN = {"K": "K_N_per_m", "C": "C_N_s_per_m"}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("models", nargs="+", choices=("arma", "a2", "impact"))
    parser.add_argument("--subjects", type=int, default=500)
    parser.add_argument("--repeats", type=int, default=10)
    chosen = parser.parse_args()
    if chosen.models == ["impact"] and (chosen.subjects, chosen.repeats) == (500, 10):
        with recorded("many_impacts"):
            measure(chosen)
    else:
        measure(chosen)


def measure(chosen: argparse.Namespace) -> None:
    """Simulate the campaign, and fit it by each model."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        began = time.perf_counter()
        data = simulated(here, chosen.subjects, chosen.repeats)
        print(f"simulated in {time.perf_counter() - began:.0f} s; load {os.getloadavg()[0]:.1f}", flush=True)
        for model in chosen.models:
            keep(report(model, data, here / model))


def keep(row: dict[str, object]) -> None:
    """Put a row into the table, in the place of one of the same model and as many impacts."""
    made = pd.DataFrame([row])
    if TABLE.is_file():
        before = pd.read_csv(TABLE)
        same = (before["model"] == row["model"]) & (before["impacts"] == row["impacts"])
        made = pd.concat([before[~same], made], ignore_index=True)
    made.to_csv(TABLE, index=False)


def simulated(here: Path, subjects: int, repeats: int) -> Path:
    conditions = "".join(
        f'[[design.conditions]]\ntrial = "{mass:g} kg at {velocity:g} m/s"\n'
        f"mass_kg = {mass}\nvelocity_m_s = {velocity}\n"
        for mass in MASSES_KG
        for velocity in VELOCITIES_M_S
    )
    text = f"{SPECIFICATION}subjects = {subjects}\nrepeats = {repeats}\n{conditions}"
    (here / "spec.toml").write_text(text, encoding="utf-8")
    run("simulate", here / "spec.toml", "--out", here / "data", "--quiet")
    return here / "data"


def run(*arguments: object) -> subprocess.Popen[bytes]:
    process = subprocess.Popen([sys.executable, "-m", "bayestissue", *map(str, arguments)])  # noqa: S603
    process.wait()
    return process


def report(model: str, data: Path, out: Path) -> dict[str, object]:
    """Fit, print what came of it, and return the row of the table."""
    before, began, memory = os.times(), time.perf_counter(), Memory()
    model_file = Path(__file__).resolve().parents[1] / "models" / f"{model}.toml"
    status = run("fit", data, "--model", model_file, "--out", out).returncode
    took, after, peak = time.perf_counter() - began, os.times(), memory.stop()
    seconds = after.children_user + after.children_system - before.children_user - before.children_system
    about = json.loads((out / "run.json").read_text(encoding="utf-8"))
    checks = json.loads((out / "diagnostics.json").read_text(encoding="utf-8"))["checks"]
    size = sum(path.stat().st_size for path in out.iterdir()) / 2**30
    print(f"\n{model}: status {status}, {took / 60:.1f} min, {seconds / 60:.1f} min of processor time")
    print(f"peak memory {peak:.2f} GiB, results {size:.2f} GiB, load {os.getloadavg()[0]:.1f} at the end")
    print(
        f"draws kept of an impact: {about.get('kept_draws_of_an_impact', 'all')}; {about['verdict']['words']}"
    )
    for check in checks:
        print(f"  {check['name']}: {check['value']:.4g} ({check['limit']})")
    summary = pd.read_csv(out / "summary.csv", dtype={"unit": str})
    whole = summary[~summary["variable"].isin(["K", "C"]) & summary["label"].isna()]
    print(whole[["variable", "mean", "sd", "ess_bulk", "ess_tail", "r_hat"]].to_string(index=False))
    truth = pd.read_csv(data / "truth.csv").set_index("impact")
    row: dict[str, object] = {"model": model, "impacts": len(truth), "status": status}
    row |= {"minutes": round(took / 60, 2), "processor_minutes": round(seconds / 60, 2)}
    row |= {"memory_GiB": round(peak, 2), "results_GiB": round(size, 2)}
    row |= {check["name"]: float(f"{check['value']:.4g}") for check in checks}
    for quantity, column in COLUMN.items():
        found = summary[summary["variable"] == quantity].set_index("label")
        true = truth.loc[found.index, column]
        held = [true.between(found[f"eti{p}_low"], found[f"eti{p}_high"]).mean() for p in (50, 90)]
        off = (found["median"] / true - 1).abs().median()
        width = ((found["eti90_high"] - found["eti90_low"]) / found["median"]).median()
        print(f"{quantity}: {len(found)} impacts, 50 % held {held[0]:.1%}, 90 % held {held[1]:.1%}, ", end="")
        print(f"off by {off:.2%}, 90 % width {width:.2%}", flush=True)
        row |= {f"{quantity}_held_50": round(held[0], 4), f"{quantity}_held_90": round(held[1], 4)}
        row |= {f"{quantity}_off": float(f"{off:.3g}"), f"{quantity}_width": float(f"{width:.3g}")}
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
