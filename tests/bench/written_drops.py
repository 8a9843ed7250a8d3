"""A recorder: drops on simulated people, as files that are whole, spoilt or unfinished."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from bayestissue.studies.init import init_dataset
from dataset_bench import DAMPING, RATE, STIFFNESS, closed_form

PATTERN = "{subject}_{side}_{mass_kg}kg_{n}.csv"
VELOCITY = 1.5
CAMPAIGN = f"""
name = "spring"
pattern = "{PATTERN}"

[signal]
quantity = "deceleration"
unit = "m/s^2"
contact = "on_sample"

[uncertainty]
velocity_sd_m_s = 0.01

[facts]
velocity_m_s = {VELOCITY}
"""
# Of one pad, whose masses an order has.
TOWER = """
name = "tower"
order = "order.csv"
[signal]
quantity = "deceleration"
unit = "m/s^2"
[facts]
subject = "pad"
velocity_m_s = 1.5
"""
PEOPLE, SIDES, MASSES = ("s01", "s02", "s03", "s04", "s05"), ("left", "right"), (0.5, 1.2)


class NoStudy:
    """A study so far of which nothing is asked; a drop of the kind "odd" is unlike the others."""

    drops = 0
    site = staticmethod(lambda impact: {"centre": [0.0] * (impact.kind == "odd"), "precision": None})
    unlike = staticmethod(lambda _, site, *__: "odd" if site["centre"] else "")
    words = staticmethod(lambda *_: [])
    update = staticmethod(lambda *_, **__: None)


def no_numbers(_: object) -> dict[str, object]:
    """Of a drop that nobody estimates."""
    return {"K": [None] * 3, "C": [None] * 3, "outcomes": {}}


def plan_of_drops(count: int, repeats: int = 3) -> list[str]:
    """Names of so many drops, person by person."""
    every = product(PEOPLE, SIDES, MASSES, range(1, repeats + 1))
    return [f"{person}_{side}_{mass}kg_{n}.csv" for person, side, mass, n in every][:count]


def drop(name: str, *, stiffer: float = 1.0, limit: float = np.inf, late_s: float = 0.0) -> bytes:
    """The file of a drop, whose truth and noise follow from its name; cut off, late or unlike if wanted."""
    person, _, weight, _ = name.removesuffix(".csv").split("_")
    mass = float(weight.removesuffix("kg"))
    rng = np.random.default_rng(list(name.encode()))
    of_person = np.random.default_rng(list(person.encode())).normal(0, 0.15)
    K = STIFFNESS * stiffer * np.exp(of_person + rng.normal(0, 0.03))
    time = np.arange(-0.01 + late_s, 0.05, 1 / RATE)
    d = closed_form(time, mass, VELOCITY, K, DAMPING)
    value = np.minimum(d + rng.normal(0, 0.3, time.size), limit)
    rows = (f"{t:.5f},{a:.4f}" for t, a in zip(time, value, strict=True))
    return "\n".join(["time_s,value", *rows, ""]).encode()


def write(folder: Path, name: str, data: bytes) -> None:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(data)


def by_init(recorded: Path, out: Path) -> Path:
    """The dataset that `init` makes of the files as the recorder has them in the end."""
    init_dataset(
        recorded,
        out,
        pattern=PATTERN,
        quantity="deceleration",
        unit="m/s^2",
        given={"velocity_m_s": VELOCITY},
        uncertainty={"velocity_sd_m_s": 0.01},
    )
    settings = out / "dataset.toml"
    settings.write_text(settings.read_text().replace("[signal]\n", '[signal]\ncontact = "on_sample"\n'))
    return out
