"""What stands in a reader's folder before a page begins; pages name these by `<!-- prepare: NAME -->`."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from nptdms import ChannelObject, TdmsWriter
from pages import DOCS, SHARED, run
from scipy.io import savemat
from scipy.signal import lsim, lti

import bayestissue as bt
from dataset_bench import DAMPING, RATE, STIFFNESS, deceleration
from made_once import made_once
from make_fit_run import make_scored_run
from recorder_files import c3d, lvm

TUTORIAL = DOCS / "tutorial" / "first-report.md"


@made_once
def tutorial(folder: Path) -> Path:
    """Folder as the first tutorial leaves it: the dataset, its model file, the finished fit."""
    folder.mkdir(parents=True, exist_ok=True)
    run(TUTORIAL, folder)
    # Links of the page that begins from here are its own.
    for name in SHARED:
        (folder / name).unlink()
    return folder


DROPS = [("s01", "left", 0.5), ("s01", "right", 0.5), ("s02", "left", 1.2)]
SPEED = np.sqrt(2 * 9.80665 * 0.12)


def free_running(mass: float, velocity: float) -> tuple[np.ndarray, np.ndarray]:
    """`deceleration`, met anywhere between two samples."""
    late = np.random.default_rng(int(1e7 * mass)).uniform(0, 1 / RATE)
    return deceleration(mass, velocity, late)


def recorders(folder: Path) -> None:
    """The same three drops from 12 cm in a folder of each recorder's files."""
    for name in ("labview", "tdms", "matlab", "c3d", "csv", "excel-de"):
        (folder / name).mkdir()
    for who, side, mass in DROPS:
        stem = f"{who}_{side}_{mass}kg"
        time, value = free_running(mass * (1.01 if side == "right" else 1.0), SPEED)
        in_g = value / 9.80665
        lvm(folder / "labview" / f"{stem}.lvm", time, {"Force": value, "Impact": in_g}, unit="g")
        with TdmsWriter(folder / "tdms" / f"{stem}.tdms") as writer:
            about = {"wf_increment": 1 / RATE, "wf_start_offset": float(time[0]), "unit_string": "m/s^2"}
            writer.write_segment([ChannelObject("Drop", "Impact", value, properties=about)])
        savemat(folder / "matlab" / f"{stem}.mat", {"t": time, "acc": in_g, "who": "someone"})
        c3d(folder / "c3d" / f"{stem}.c3d", {"Fz": value, "Impact": value}, RATE, {"Impact": "m/s^2"})
        table = pd.DataFrame({"Time (ms)": (1e3 * time).round(4), "Impact (g)": in_g.round(4)})
        table.to_csv(folder / "csv" / f"{stem}.csv", index=False)
        rows = [f"{1e3 * t:.3f};{a:.4f}".replace(".", ",") for t, a in zip(time, in_g, strict=True)]
        german = "\r\n".join(["Zeit;Stoß", "ms;g", *rows])
        (folder / "excel-de" / f"{stem}.csv").write_bytes(german.encode("cp1252"))


def long_recording(folder: Path) -> None:
    """Recordings of three drops each, a second apart: by one mass, and by two."""
    for name, last in (("sessions", 0.5), ("mixed", 1.2)):
        (folder / name).mkdir()
        rng = np.random.default_rng(3)
        value = rng.normal(0, 0.05, int(3.5 * RATE))
        for number, mass in enumerate((0.5, 0.5, last)):
            start = int((number + 0.99) * RATE)
            _, hit = deceleration(mass * (1 + 0.01 * number), 1.5)
            value[start : start + len(hit)] += hit
        table = pd.DataFrame({"Time (s)": np.arange(len(value)) / RATE, "Impact (m/s^2)": value.round(3)})
        table.to_csv(folder / name / "s01.csv", index=False)


def sides(folder: Path) -> None:
    """Two drops on each side of two people in two sessions, by one operator."""
    rows, recordings = [], {}
    every = product(("s01", "s02"), ("left", "right"), ("first", "second"), (0.5, 1.2))
    for person, side, session, mass in every:
        name = f"{person}-{side}-{session}-{mass}"
        about = {"subject": person, "trial": "drop", "side": side, "session": session, "operator": "o1"}
        rows.append({"impact": name, "mass_kg": mass, "velocity_m_s": SPEED, **about})
        recordings[name] = deceleration(mass * (1 + 0.001 * len(rows)), SPEED)
    given = {"quantity": "deceleration", "unit": "m/s^2", "uncertainty": {"relative_mass_sd": 0.002}}
    bt.dataset(pd.DataFrame(rows), recordings, name="drops", **given).write(folder / "drops")


def recorder_at_work(folder: Path) -> None:
    """What a recorder has written: a pilot, and six drops of two people, one of which ends amid the blow."""
    for name, people, repeats in (("pilot-recorded", ("p1",), 2), ("recorded", ("s01", "s02"), 3)):
        (folder / name).mkdir()
        for person, number in product(people, range(1, repeats + 1)):
            time, value = deceleration(0.5 + 0.001 * number + 0.01 * (person == "s02"), SPEED)
            if (person, number) == ("s02", 2):
                time, value = time[:120], value[:120]
            table = pd.DataFrame(
                {"Time (ms)": (1e3 * time).round(4), "Impact (g)": (value / 9.80665).round(5)}
            )
            table.to_csv(folder / name / f"{person}_left_0.5kg_{number}.csv", index=False)


def two_runs(folder: Path) -> None:
    """Finished fits by two models, with invented numbers where they were not made before."""
    for name, worse in (("impact", 0.0), ("stiffening", 2.0)):
        if not (folder / "runs" / name).exists():
            make_scored_run(folder / "runs" / name, likelihood="impact", worse=worse)


def arrays(folder: Path) -> None:
    """Drops as CSV files of two columns, s and m/s²."""
    for name, mass in {"drop": 0.5, "a": 0.5, "b": 0.8, "c": 1.0}.items():
        time, value = deceleration(mass, SPEED)
        table = pd.DataFrame({"time_s": time, "deceleration": value})
        table.to_csv(folder / f"{name}.csv", index=False)


def one_table(folder: Path) -> None:
    """All samples of three drops in one long table, ms and g."""
    parts = []
    for number, (_, _, mass) in enumerate(DROPS, start=1):
        time, value = free_running(mass * (1 + 0.001 * number), SPEED)
        columns = {"time_s": (1e3 * time).round(4), "value": (value / 9.80665).round(4)}
        parts.append(pd.DataFrame({"impact": f"d{number}", **columns}))
    (folder / "drops").mkdir()
    pd.concat(parts).to_csv(folder / "drops" / "traces.csv", index=False)


def pads(folder: Path) -> None:
    """Drops from two heights on four pads, an accelerometer beside a force plate."""
    (folder / "tower").mkdir()
    rng, mass, rate, g = np.random.default_rng(5), 5.0, 10_000.0, 9.80665
    stiffness = {"A": 12e3, "B": 20e3, "C": 15e3, "D": 40e3}
    for pad, height, repeat in product(stiffness, (12, 20), (1, 2, 3)):
        K = stiffness[pad]
        time = np.arange(1200) / rate
        since = np.maximum(time - 0.01 - rng.uniform() / rate, 0)
        system = lti([[0, 1], [-K / mass, -80 / mass]], [[0], [1]], [[K / mass, 80 / mass]], [[0]])
        fine = np.arange(24_000) / (20 * rate)
        _, felt, _ = lsim(system, np.full_like(fine, g), fine, X0=[0, np.sqrt(2 * g * height / 100)])
        force = np.where(np.maximum.accumulate(felt < 0), 0.0, felt)
        value = np.where(since > 0, np.interp(since, fine, force), 0.0)
        noisy = value / g + rng.normal(0, 0.02, len(time))
        columns = {
            "Time (s)": time.round(6),
            "Accel (g)": noisy.round(4),
            "Force (N)": (mass * value + rng.normal(0, 2, len(time))).round(2),
        }
        pd.DataFrame(columns).to_csv(folder / "tower" / f"{pad}_{height}cm_{repeat}.csv", index=False)


def trial(folder: Path) -> None:
    """A drop on each side of three treated and three control people, before and after K and C grew by 1.2."""
    (folder / "recorded").mkdir()
    rng = np.random.default_rng(4)
    for number in range(6):
        group, person = ("treated" if number % 2 else "control"), f"p{number + 1}"
        own = 0.15 * rng.standard_normal(2)
        for session in ("before", "after"):
            visit = own + 0.03 * rng.standard_normal(2) + 0.05 * (session == "after")
            visit += np.log(1.2) * (session == "after" and group == "treated")
            for side in ("left", "right"):
                K, C = np.array([STIFFNESS, DAMPING]) * np.exp(visit + 0.03 * rng.standard_normal(2))
                late = rng.uniform(0, 1 / RATE)
                time, value = deceleration(0.5, SPEED, late, K=K, C=C)
                value += rng.normal(0, 0.05, len(value))
                columns = {"Time (ms)": (1e3 * time).round(4), "Impact (g)": (value / 9.80665).round(5)}
                name = f"{group}_{person}_{session}_{side}.csv"
                pd.DataFrame(columns).to_csv(folder / "recorded" / name, index=False)
