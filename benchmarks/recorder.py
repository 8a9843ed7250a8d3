"""Impacts behind a recorder's low-pass: how often 90 % intervals hold K and C, the filter declared and not.

    .venv/bin/python benchmarks/recorder.py

Each line is 160 simulated impacts, sixteen people at two masses, that peak within 4 to 8 ms, sampled at
10 kHz with white noise of 0.5 % of the peak behind the filter, by `estimate --method impact`. A coverage of
90 % measured on 160 has a standard error of 2.4 %. "suspected" counts the impacts of which `check` says that
a low-pass is not declared. Where all of the noise, or half of its variance, went through the filter too, that
is not declared, and the quiet parts before contact have to tell. Of filters that software ran over the
samples, with a corner of an eighth of the sampling rate, 320 impacts each are there twice: declared as they
are, and as analog. The last lines are sound recordings of six elements, sampled at 1 to 10 kHz, and impacts
as short as those above on each of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from evidence import recorded
from sound import TISSUES, dataset
from sound import impacts as different
from spoiling import sound_ones

from bayestissue.base import runtime
from bayestissue.inference.single.impact_estimates import estimate
from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.quality.force_laws import suspected
from bayestissue.studies.simulation import Simulation, simulate

IMPACTS = 96
SOUND_ONES = 1000
NOISE = 0.005
NOISES = (0.001, 0.005, 0.02)
SOUND, SHORT = "sound recordings", "short impacts on six elements"
SLOW = {"low_pass_hz": 500.0}
CASES: dict[str, dict[str, Any] | None] = {
    "second order, 500 Hz": SLOW,
    "SAE class 180": {"sae_class": 180},
    "none": None,
    "one pole, 500 Hz": {**SLOW, "order": 1},
    "Bessel of fourth order, 500 Hz": {**SLOW, "order": 4, "kind": "bessel"},
    "second order, 2000 Hz": {"low_pass_hz": 2000.0},
}
# Recorders whose noise goes through the filter, and further noise behind it over that.
BEFORE: dict[str, tuple[dict[str, Any], float]] = {
    "SAE class 180, noise before it": ({"sae_class": 180}, 0.0),
    "second order, 500 Hz, noise before and behind it": (SLOW, 1.0),
}


# By software; and what each is called where it is taken for an analog one.
DIGITAL: dict[str, dict[str, Any]] = {
    "second order, 1250 Hz, by software": {"low_pass_hz": 1250.0, "applied": "digital"},
    "SAE class 600, by software": {"sae_class": 600},
}
AS_ANALOG = ", taken as analog"


def campaign(recorder: dict[str, Any] | None, impacts: int = IMPACTS) -> Simulation:
    """Sixteen people hit with two masses, as often as makes so many impacts."""
    conditions = [
        {"trial": name, "mass_kg": mass, "velocity_m_s": 1.5} for name, mass in (("a", 0.45), ("b", 0.75))
    ]
    tissue = {"K_N_per_m": 32000.0, "C_N_s_per_m": 60.0}
    tissue |= {f"sd_{level}_{name}": 0.06 for level in ("subject", "impact") for name in "KC"}
    design = {"conditions": conditions, "subjects": 16, "repeats": -(-impacts // 32)}
    content = {"name": "recorder", "seed": 18, "design": design, "tissue": tissue}
    content |= {"recording": {"noise_relative_to_peak": NOISE}}
    return Simulation.model_validate(content | ({"recorder": recorder} if recorder else {}))


def line(case: str, *, declared: bool, impacts: int = IMPACTS) -> dict[str, Any]:
    """What the estimates of one case say of the truth."""
    known = CASES | {name + end: table for name, table in DIGITAL.items() for end in ("", AS_ANALOG)}
    recorder, behind = BEFORE[case] if case in BEFORE else (known[case], 0.0)
    made = campaign({**recorder, "noise": "before"} if recorder and case in BEFORE else recorder, impacts)
    campaign_made = simulate(made)
    data, truth = campaign_made.dataset(made.name), campaign_made.truth
    if case in BEFORE:
        data = _of_both(data, behind)
    if case.endswith(AS_ANALOG):
        assert data.recorder is not None
        data = data.with_settings(recorder=data.recorder.model_copy(update={"applied": "analog"}))
    assert truth["time_to_peak_s"].between(0.004, 0.008).all()
    data = data if declared else data.with_settings(recorder=None)
    found = estimate(data)
    cells: dict[str, Any] = {"filter": case, "declared": declared, "impacts": len(truth)}
    for name, unit in (("K", "N_per_m"), ("C", "N_s_per_m")):
        true = truth[f"{name}_{unit}"]
        low, high = (found[f"{name}_{end}_{unit}"] for end in ("low", "high"))
        cells[f"{name} held"] = int(((low <= true) & (true <= high)).sum())
        cells[f"{name} off by %"] = round(100 * float(np.median(found[f"{name}_{unit}"] / true - 1)), 2)
    if not declared:
        cells["suspected"] = _suspected(case, data)["suspected"]
    return cells


def _of_both(data: Dataset, behind: float) -> Dataset:
    """The same with so much more noise behind the filter, and without a word on where any of it entered."""
    assert data.recorder is not None
    random = np.random.default_rng(18)
    traces = [
        Trace(
            each.time_s,
            each.value + behind * NOISE * each.value.max() * random.standard_normal(each.value.size),
        )
        for each in data.traces
    ]
    return replace(data, traces=traces).with_settings(
        recorder=data.recorder.model_copy(update={"noise": None})
    )


def sound(impacts: int) -> dict[str, Any]:
    """Of how many sound recordings `check` says that they went through a low-pass."""
    made = sound_ones(different(impacts, seed=18), impacts, seed=18)
    return _suspected(SOUND, dataset(made.impacts, made.traces))


def short(impacts: int) -> dict[str, Any]:
    """The same of stiff tissues of all elements, with errors of the measuring chain and any noise."""
    found = []
    chain = {"velocity_sd_m_s": 0.015, "relative_gain_sd": 0.01, "offset_sd_m_s2": 0.5}
    for element, tissue in TISSUES.items():
        for noise in NOISES:
            content = campaign(None, -(-impacts // len(TISSUES) // len(NOISES))).model_dump()
            del content["recorder"]
            content["tissue"] |= {"element": element, **tissue}
            content["tissue"]["K_N_per_m"] *= 8
            content["tissue"]["C_N_s_per_m"] *= 2.5
            content["recording"] |= {"noise_relative_to_peak": noise, **chain}
            data = simulate(Simulation.model_validate(content)).dataset("short")
            found.append(_suspected(SHORT, data))
    return {**found[0], **{name: sum(each[name] for each in found) for name in ("impacts", "suspected")}}


def _suspected(name: str, data: Dataset) -> dict[str, Any]:
    count = int(np.isfinite(suspected(displacements(data)).corner_hz).sum())
    return {"filter": name, "declared": False, "impacts": len(data.impacts), "suspected": count}


def main() -> None:
    runtime.configure()
    cases = [(name, declared) for name in CASES for declared in (True, False) if CASES[name] or not declared]
    cases += [(name + end, True) for name in DIGITAL for end in ("", AS_ANALOG)]
    cases += [*((name, True) for name in BEFORE), (SOUND, False), (SHORT, False)]
    units = {
        f"{name}, {'declared' if declared else 'not declared'}": (name, declared) for name, declared in cases
    }
    without_truth = {SOUND: sound, SHORT: short}
    with recorded("recorder") as record:
        for unit in record.missing(units):
            name, declared = units[unit]
            impacts = 2 * IMPACTS if "software" in name else IMPACTS
            counted = without_truth.get(name)
            row = counted(SOUND_ONES) if counted else line(name, declared=declared, impacts=impacts)
            record.add(unit, [row])


if __name__ == "__main__":
    main()
