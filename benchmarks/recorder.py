"""Impacts behind a recorder's low-pass: how often 90 % intervals hold K and C, the filter declared and not.

    .venv/bin/python benchmarks/recorder.py

Each line is 96 simulated impacts, sixteen people at two masses, that peak within 4 to 8 ms, sampled at
10 kHz with white noise of 0.5 % of the peak behind the filter, by `estimate --method impact`. A coverage of
90 % measured on 96 has a standard error of 3.1 %. "suspected" counts the impacts of which `check` says that
a low-pass is not declared. Where all of the noise, or half of its variance, went through the filter too, that
is not declared, and the quiet parts before contact have to tell. Of filters that software ran over the
samples, with a corner of an eighth of the sampling rate, 192 impacts each are there twice: declared as they
are, and as analog. The last lines are sound recordings of six elements, sampled at 1 to 10 kHz, and impacts
as short as those above on each of them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from evidence import measure
from evidence.simulations import simulation, tables
from sound import TISSUES, dataset
from sound import impacts as different
from spoiling import sound_ones
from studies import UNITS, held

from bayestissue.inference.single.impact_estimates import estimate
from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.quality.force_laws import suspected
from bayestissue.studies.simulation import Simulation, simulate

SOUND_ONES, NOISES = 1000, (0.001, 0.005, 0.02)
TABLES = tables(__file__)


def campaign(of: dict[str, Any]) -> Simulation:
    """Sixteen people hit with two masses behind a recorder."""
    behind = {"recorder": of["recorder"]} if "recorder" in of else {}
    return simulation(TABLES["campaign"], {"design": {"repeats": of.get("repeats", 3)}}, behind)


def line(name: str, *, declared: bool) -> dict[str, Any]:
    """What the estimates of one filter say of the truth."""
    of = TABLES["lines"][name]
    result = simulate(campaign(of))
    data, truth = result.dataset("recorder"), result.truth
    if "behind" in of:
        data = with_noise(data, of["behind"])
    changes = {"noise": None} if "behind" in of else of.get("as", {})
    recorder = data.recorder.model_copy(update=changes) if data.recorder and declared else None
    data = data.with_settings(recorder=recorder)
    assert truth["time_to_peak_s"].between(0.004, 0.008).all()
    found = estimate(data)
    cells: dict[str, Any] = {"filter": name, "declared": declared, "impacts": len(truth)}
    for q, unit in UNITS.items():
        cells[f"{q} held"] = int(held(truth, found, q).sum())
        off = float(np.median(found[f"{q}_{unit}"] / truth[f"{q}_{unit}"] - 1))
        cells[f"{q} off by %"] = round(100 * off, 2)
    return cells if declared else cells | {"suspected": suspected_of(name, data)["suspected"]}


def with_noise(data: Dataset, behind: float) -> Dataset:
    """The same with so much more noise behind the filter, over that of the campaign."""
    random = np.random.default_rng(18)
    sd = behind * TABLES["campaign"]["recording"]["noise_relative_to_peak"]
    traces = [
        Trace(each.time_s, each.value + sd * each.value.max() * random.standard_normal(each.value.size))
        for each in data.traces
    ]
    return replace(data, traces=traces)


def sound() -> dict[str, Any]:
    """Of how many sound recordings `check` says that they went through a low-pass."""
    made = sound_ones(different(SOUND_ONES, seed=18), SOUND_ONES, seed=18)
    return suspected_of("sound recordings", dataset(made.impacts, made.traces))


def short() -> dict[str, Any]:
    """The same of stiff tissues of all elements, with errors of the measuring chain and any noise."""
    found = []
    errors = {"velocity_sd_m_s": 0.015, "relative_gain_sd": 0.01, "offset_sd_m_s2": 0.5}
    for (element, tissue), noise in product(TISSUES.items(), NOISES):
        stiff = {"K_N_per_m": 8 * tissue["K_N_per_m"], "C_N_s_per_m": 2.5 * tissue["C_N_s_per_m"]}
        made = simulation(
            TABLES["campaign"],
            {"tissue": {**tissue, "element": element}, "recording": errors, "design": {"repeats": 2}},
            {"tissue": stiff, "recording": {"noise_relative_to_peak": noise}},
        )
        data = simulate(made).dataset("short")
        found.append(suspected_of("short impacts on six elements", data))
    return {**found[0], **{name: sum(each[name] for each in found) for name in ("impacts", "suspected")}}


def suspected_of(name: str, data: Dataset) -> dict[str, Any]:
    """Of how many recordings `check` says so."""
    count = int(np.isfinite(suspected(displacements(data)).corner_hz).sum())
    return {"filter": name, "declared": False, "impacts": len(data.impacts), "suspected": count}


def main() -> None:
    units = {
        f"{name}, {'declared' if declared else 'not declared'}": partial(line, name, declared=declared)
        for name, of in TABLES["lines"].items()
        for declared in of.get("declared", (True, False))
    }
    units |= {"sound recordings, not declared": sound, "short impacts on six elements, not declared": short}
    measure("recorder", units, lambda rows: rows())


if __name__ == "__main__":
    main()
