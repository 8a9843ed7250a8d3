"""How long `bayestissue reproduce` takes from command to finished report, by one program or several.

    .venv/bin/python benchmarks/reproduce_time.py
    .venv/bin/python benchmarks/reproduce_time.py --program OLD .

`first` is with nothing compiled yet, `again` the same command once more. Seconds of the clock, and of the
processor (`cpu_s`), which other work on the machine changes less. `--program` names checkouts whose programs
are timed in turn, all by this Python and its libraries. Beside the times the table has the mass exponents
(mean and 90 % interval) and each explanation's accuracy by trial, so that it is seen whether they agree.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import pandas as pd
from evidence import recorded
from evidence.commands import timed
from evidence.registry import ROOT


def results(folder: Path) -> dict[str, str | float]:
    """What was found."""
    summary = pd.read_csv(folder / "summary.csv").set_index("variable")
    found: dict[str, str | float] = {}
    for name in ("mass_exponent_K", "mass_exponent_C"):
        row = summary.loc[name]
        found[name] = f"{row['mean']:.3f} ({row['eti90_low']:.3f} to {row['eti90_high']:.3f})"
    table = pd.read_csv(folder / "comparison.csv")
    by_trial = table[table["scheme"] == "leave one trial out"]
    return found | {row["model"]: round(row["elpd"], 1) for _, row in by_trial.iterrows()}


def main() -> None:
    """Time every program."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--program", nargs="+", type=Path, default=[ROOT])
    chosen = parser.parse_args()
    if chosen.program != [ROOT]:
        print(measured(chosen.program).T.to_string(header=False))
        return
    with recorded("reproduce_time") as record:
        record.write(measured(chosen.program).drop(columns="program"))


def measured(programs: list[Path]) -> pd.DataFrame:
    """A row a run of each program."""
    rows = []
    for program in programs:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for run in ("first", "again"):
                command = ("reproduce", "--quiet", "--out", folder / run)
                compiled = str(folder / "compiled")
                seconds = timed(*command, program=program, JAX_COMPILATION_CACHE_DIR=compiled)
                rows.append({"program": str(program), "run": run, **seconds, **results(folder / run)})
    return pd.DataFrame(rows)


if __name__ == "__main__":
    main()
