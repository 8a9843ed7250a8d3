"""A valid dataset made here, and ways to spoil it."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.recordings.dataset.dataset_file import Settings, content_of, parse_settings

STIFFNESS, DAMPING, RATE, SAMPLES = 3000.0, 25.0, 10_000.0, 400


def closed_form(time: np.ndarray, mass: float, velocity: float, K: float, C: float) -> np.ndarray:
    """The deceleration by a spring and damper that are met at 0, (K x + C v) / M where that is above 0."""
    since, frequency, ratio = np.maximum(time, 0), np.sqrt(K / mass), C / (2 * np.sqrt(K * mass))
    damped = frequency * np.sqrt(1 - ratio**2)
    decay = velocity * np.exp(-ratio * frequency * since)
    x = decay / damped * np.sin(damped * since)
    v = decay * (np.cos(damped * since) - ratio * frequency / damped * np.sin(damped * since))
    return np.where(time >= 0, np.maximum(K * x + C * v, 0), 0) / mass


def deceleration(
    mass: float, velocity: float, late: float = 0.0, *, K: float = STIFFNESS, C: float = DAMPING
) -> tuple[np.ndarray, np.ndarray]:
    """A spring and damper met 5 ms and ``late`` after the recording begins, with a little noise; SI units."""
    time = np.arange(SAMPLES) / RATE - 0.005
    noise = np.random.default_rng(int(1e6 * mass)).normal(0, 0.05, SAMPLES)
    return time.round(9), (closed_form(time - late, mass, velocity, K, C) + noise).round(4)


@dataclass
class Lab:
    """A valid dataset of four impacts in a folder of its own, to be read as it is or spoilt."""

    folder: Path
    settings: dict[str, Any] = field(default_factory=dict)

    def path(self, name: str) -> Path:
        return self.folder / name

    def replace(self, name: str, old: str, new: str, count: int = 1) -> None:
        """Replace text in a file, which must be there."""
        path = self.path(name)
        text = self.text(name)
        assert old in text, f"{old!r} is not in {name}"
        data = text.replace(old, new, count).encode()
        path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)

    def text(self, name: str) -> str:
        data = self.path(name).read_bytes()
        return (gzip.decompress(data) if name.endswith(".gz") else data).decode()

    def spoil(self, case: dict[str, Any]) -> None:
        """Change the dataset as a row of a table of cases says: by these methods, one after the other."""
        for method, given in case.items():
            if method != "says":
                getattr(self, method)(*given if isinstance(given, list) else [given])

    def remove(self, name: str) -> None:
        self.path(name).unlink()

    def write(self, name: str, text: str) -> None:
        """Write a file's bytes, those of Latin-1."""
        self.path(name).write_bytes(text.encode("latin-1"))

    def append(self, name: str, text: str) -> None:
        with self.path(name).open("a", encoding="utf-8") as file:
            file.write(text)

    def row(self, name: str, number: int, change: Callable[[str], str | None]) -> None:
        """Change one row (the header is row 1) of a text file, or take it out."""
        lines = self.text(name).split("\n")
        new = change(lines[number - 1])
        lines[number - 1 : number] = [] if new is None else [new]
        self.path(name).write_text("\n".join(lines), newline="")

    def cell(self, name: str, row: int, column: str, value: str) -> None:
        place = self.text(name).split("\n")[0].replace('"', "").split(",").index(column)

        def change(line: str) -> str:
            cells = line.split(",")
            cells[place] = value
            return ",".join(cells)

        self.row(name, row, change)

    def value(self, impacts: str, formula: str) -> None:
        """Change values by a formula of the time t, the value v and the number i of a sample."""
        for impact in impacts:
            self.samples(impact, lambda t, v: np.copyto(v, _computed(formula, t, v)))

    def time(self, impacts: str, formula: str) -> None:
        for impact in impacts:
            self.samples(impact, lambda t, v: np.copyto(t, _computed(formula, t, v)))

    def displacement(self, unit: str) -> None:
        self.replace("dataset.toml", '"deceleration"', '"displacement"')
        self.replace("dataset.toml", '"m/s^2"', f'"{unit}"')

    def keep(self, impact: str, stop: int) -> None:
        """Keep the first samples alone of one impact, behind the others."""
        table = pd.read_csv(self.path("traces.csv"))
        mine = table["impact"] == impact
        pd.concat([table[~mine], table[mine].iloc[:stop]]).to_csv(self.path("traces.csv"), index=False)

    def trace(self, first: str) -> None:
        """A file for each impact in place of the table, of which the first impact has this one."""
        for impact, part in pd.read_csv(self.path("traces.csv")).groupby("impact"):
            part.drop(columns="impact").to_csv(self.path(f"{impact}.csv"), index=False)
        self.remove("traces.csv")
        self.column("trace", [first, "b.csv", "c.csv", "d.csv"])

    def column(self, name: str, cells: object) -> None:
        """Set a column of the table of impacts."""
        impacts = pd.read_csv(self.path("impacts.csv"))
        impacts.assign(**{name: cells}).to_csv(self.path("impacts.csv"), index=False)

    def samples(self, impact: str, change: Callable[[np.ndarray, np.ndarray], Any]) -> None:
        """Change the time and value of all samples of an impact in place."""
        table = pd.read_csv(self.path("traces.csv"))
        mine = (table["impact"] == impact).to_numpy()
        time, value = (table.loc[mine, name].to_numpy().copy() for name in ("time_s", "value"))
        change(time, value)
        table.loc[mine, "time_s"], table.loc[mine, "value"] = time, value
        table.to_csv(self.path("traces.csv"), index=False)


def _computed(formula: str, t: np.ndarray, v: np.ndarray) -> np.ndarray:
    return eval(formula, {"np": np}, {"t": t, "v": v, "i": np.arange(t.size)})  # noqa: S307 - of our own tables


NAMES = ("a", "b", "c", "d")
MASSES = (0.5, 0.8, 1.0, 1.3)


def tables() -> tuple[pd.DataFrame, pd.DataFrame]:
    """The tables of a dataset of four impacts, and of their samples."""
    impacts = pd.DataFrame({"impact": NAMES, "subject": ["s1", "s1", "s2", "s2"]})
    impacts = impacts.assign(trial=["light", "heavy"] * 2, mass_kg=MASSES, velocity_m_s=[1.0, 1.1, 1.2, 0.9])
    impacts = impacts.assign(skinfold_mm=[11.5, 11.5, 14.0, 14.0], sex=["f", "f", "m", "m"])
    return impacts, samples_of(impacts)


def samples_of(impacts: pd.DataFrame, late: float = 0.0) -> pd.DataFrame:
    """A table of the samples of impacts, each by its mass and velocity."""
    motions = zip(impacts["mass_kg"], impacts["velocity_m_s"], strict=True)
    time, value = zip(*(deceleration(mass, velocity, late) for mass, velocity in motions), strict=True)
    names = np.repeat(impacts["impact"].to_numpy(), SAMPLES)
    return pd.DataFrame({"impact": names, "time_s": np.concatenate(time), "value": np.concatenate(value)})


SETTINGS: dict[str, Any] = {
    "name": "bench",
    "description": "four impacts",
    "signal": {"quantity": "deceleration", "unit": "m/s^2"},
    "uncertainty": {"relative_mass_sd": 0.01, "velocity_sd_m_s": 0.005},
}


def settings_of(**stated: Any) -> Settings:
    """What ``dataset.toml`` says of recordings in SI units, by names of arguments."""
    unit = "m" if stated["quantity"] == "displacement" else "m/s^2"
    return parse_settings(content_of({"name": "made", "unit": unit, **stated}))
