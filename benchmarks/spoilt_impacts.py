"""How many sound impacts are flagged, and how many spoilt ones are caught, by kind of spoiling.

    .venv/bin/python benchmarks/spoilt_impacts.py
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayestissue import runtime
from bayestissue.dataset import Dataset
from bayestissue.dataset.checks import check_recordings
from bayestissue.dataset.model import Quantity, Trace
from bayestissue.dataset.recordings import Recordings
from bayestissue.dataset.samples import Samples
from bayestissue.inference.estimates import estimate
from bayestissue.simulation import sound
from bayestissue.simulation.spoiling import DISPLACEMENT, KINDS, record


def refused(data: Dataset) -> pd.Series:
    """What `check` refuses or warns of, one text per impact; empty where it says nothing."""
    values = [trace.value for trace in data.traces]
    start = np.concatenate([[0], np.cumsum([value.size for value in values])])
    times = np.concatenate([trace.time_s for trace in data.traces])
    count = len(data.impacts)
    samples = Samples(
        times, np.concatenate(values), start, np.arange(count), ["traces.csv"] * count, np.arange(start[-1])
    )
    found = check_recordings(Recordings.of(samples, data.impacts, data.quantity, data.uncertainty))
    said = pd.Series("", index=data.impacts["impact"])
    for problem in (*found.problems, *found.warnings):
        said[problem.impact] = f"refused: {problem.expected.split(':')[0]}"
    return said.reset_index(drop=True)


def judged(impacts: list[sound.Impact], traces: list[Trace], quantity: Quantity, reference: pd.DataFrame) -> pd.DataFrame:
    """Per impact: what was said of it, and how far its K and C are off the reference."""
    data = sound.dataset(impacts, traces, quantity)
    said = refused(data)
    table = estimate(data)
    flags = np.where(said != "", said, table["flags"])
    off = {
        name: np.abs(table[column] / reference[column] - 1).fillna(np.inf).to_numpy()
        for name, column in (("K_off", "K_N_per_m"), ("C_off", "C_N_s_per_m"))
    }
    return pd.DataFrame({"element": [each.element for each in impacts], "flags": flags, **off})
