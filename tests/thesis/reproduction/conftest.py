from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.resources import shared
from bayestissue.recordings.dataset import published as tables_of_the_thesis
from bayestissue.recordings.dataset.published import PublishedTables, read_published


@pytest.fixture(scope="session")
def published() -> PublishedTables:
    return read_published()


@dataclass(frozen=True)
class Printed:
    """Simulated impacts, whole and unrounded, beside the tables that would be printed of them."""

    impacts: pd.DataFrame
    tables: PublishedTables


@pytest.fixture
def print_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], Printed]:
    """Simulate 90 impacts, print them as the thesis did (three decimals, trials 7 and 25 lost), read them."""

    def simulate(seed: int) -> Printed:
        generator = np.random.default_rng(seed)
        folder = tmp_path / f"printed-{seed}"
        shutil.copytree(shared("data", "published"), folder)
        averages = pd.read_csv(folder / "averages.csv", dtype=str)
        condition = averages.query("quantity == 'K'")[["trial", "energy_J", "velocity_m_s", "mass_kg"]]
        impacts = condition.merge(pd.DataFrame({"subject": [str(s) for s in range(1, 11)]}), how="cross")
        mass = impacts["mass_kg"].astype(float)
        impacts["K"] = 2 + 20 * mass + generator.normal(size=90)
        impacts["C"] = 0.5 + 2 * mass * generator.lognormal(sigma=0.5, size=90)
        rows = impacts[~impacts["trial"].isin(["7", "25"])]
        shown = rows.assign(
            table="5.2",
            row=np.arange(1, len(rows) + 1),
            K=rows["K"].map("{:.3f}".format),
            C=rows["C"].map("{:.3f}".format),
        )
        shown.to_csv(folder / "estimates.csv", index=False)
        for quantity in ("K", "C"):
            groups = impacts.groupby("trial", sort=False)[quantity]
            found = {"average": groups.mean(), "sd": groups.std(), "range": groups.max() - groups.min()}
            for name, value in found.items():
                here = averages["quantity"] == quantity
                averages.loc[here, name] = averages.loc[here, "trial"].map(value.map("{:.3f}".format))
        averages.to_csv(folder / "averages.csv", index=False)
        numbers = dict.fromkeys(("energy_J", "velocity_m_s", "mass_kg"), float)
        with monkeypatch.context() as patch:
            patch.setattr(tables_of_the_thesis, "shared", lambda *parts: folder / parts[-1])
            return Printed(impacts.astype({**numbers, "trial": int}), read_published())

    return simulate
