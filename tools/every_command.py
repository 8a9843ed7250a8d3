"""Run every command of the installed program, in a new folder, as after `pip install bayestissue`.

    python tools/every_command.py

Of the environment of this Python. Where that has the declared dependencies alone, a library that some
command imports and the project does not declare ends here. Every command prints its help; four impacts are
simulated, read from recordings, checked, estimated, fitted, asked, shown and exported.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

PROGRAM = Path(sys.executable).with_name("bayestissue")
SPECIFICATION = """
name = "four impacts"
seed = 1
[design]
subjects = 2
[[design.conditions]]
trial = "light"
mass_kg = 0.5
velocity_m_s = 1.5
[[design.conditions]]
trial = "heavy"
mass_kg = 1.0
velocity_m_s = 1.5
[tissue]
K_N_per_m = 3000.0
C_N_s_per_m = 25.0
sd_impact_K = 0.05
sd_impact_C = 0.05
[recording]
sampling_rate_hz = 2000.0
noise_relative_to_peak = 0.005
[output]
traces = "csv"
"""
MODEL = """
like = "impact"
[sampler]
chains = 2
draws = 200
effective = 100
"""
# So few impacts may leave a diagnostic in doubt, which is no failure.
PASSED = (0, 3)
COMMANDS = """
import typer
from bayestissue.cli import app
print(*typer.main.get_command(app).commands)
"""


def called(*words: str, folder: Path, statuses: tuple[int, ...] = (0,)) -> str:
    """What a command prints; the end of this script where it has another exit status."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    said = " ".join(Path(word).name if word is words[0] else word for word in words)
    if done.returncode not in statuses:
        sys.exit(f"{said}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    print(said.splitlines()[0], flush=True)
    return done.stdout


def recordings(dataset: Path, folder: Path) -> None:
    """A file for each impact of a dataset, as a recorder writes it."""
    folder.mkdir()
    with (dataset / "impacts.csv").open(encoding="utf-8") as stream:
        about = {row["impact"]: row for row in csv.DictReader(stream)}
    with (dataset / "traces.csv").open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            impact = about[row["impact"]]
            path = folder / f"{impact['subject']}_{float(impact['mass_kg']):g}kg_1.csv"
            new = not path.exists()
            with path.open("a", encoding="utf-8") as file:
                file.write("time_s,deceleration\n" * new + f"{row['time_s']},{row['value']}\n")


def main() -> None:
    """Everything, one after another."""
    with TemporaryDirectory() as made:
        folder, program = Path(made), str(PROGRAM)
        for name in called(sys.executable, "-c", COMMANDS, folder=folder).split():
            called(program, name, "--help", folder=folder)
        (folder / "four.toml").write_text(SPECIFICATION, encoding="utf-8")
        (folder / "short.toml").write_text(MODEL, encoding="utf-8")
        called(program, "model", "impact", folder=folder)
        called(program, "model", "./short.toml", folder=folder)
        called(program, "simulate", "four.toml", "--out", "drops", folder=folder)
        recordings(folder / "drops", folder / "recorded")
        stated = ["--quantity", "deceleration", "--unit", "m/s^2", "--gravity", "none"]
        facts = ["--set", "velocity_m_s=1.5", *stated]
        called(program, "init", "recorded", "--out", "read", *facts, folder=folder)
        called(program, "check", "read", "--out", "checked", folder=folder)
        called(program, "estimate", "read", "--out", "estimates", folder=folder)
        fit = ("fit", "read", "--model", "./short.toml", "--out", "fit")
        called(program, *fit, folder=folder, statuses=PASSED)
        called(program, "ask", "fit", "K > 1000", folder=folder)
        called(program, "report", "fit", folder=folder)
        called(program, "export", "fit", "--out", "export", folder=folder)
    print("every command works")


if __name__ == "__main__":
    main()
