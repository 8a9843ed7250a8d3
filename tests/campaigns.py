"""Small simulated studies with their truth, and whether intervals hold it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.studies.simulation import Campaign, Simulation, simulate

# A campaign of whole fits: of one size, so that what one compiles serves the others.
FOUR_BY_FOUR = """
name = "four by four"
seed = 4
[design]
subjects = 4
[[design.conditions]]
trial = "m0.4"
mass_kg = 0.4
velocity_m_s = 1.5
[[design.conditions]]
trial = "m0.6"
mass_kg = 0.6
velocity_m_s = 1.5
[[design.conditions]]
trial = "m0.9"
mass_kg = 0.9
velocity_m_s = 1.5
[[design.conditions]]
trial = "m1.3"
mass_kg = 1.3
velocity_m_s = 1.5
[tissue]
K_N_per_m = 3000.0
C_N_s_per_m = 25.0
sd_subject_K = 0.2
sd_impact_K = 0.05
sd_subject_C = 0.2
sd_impact_C = 0.05
[recording]
sampling_rate_hz = 2000.0
noise_relative_to_peak = 0.005
relative_mass_sd = 0.002
velocity_sd_m_s = 0.005
[output]
traces = "csv"
"""
COLUMNS = {"K": "K_N_per_m", "C": "C_N_s_per_m"}
# A good recorder, each error of the measuring chain as large as it is declared.
RECORDER = {
    "sampling_rate_hz": 5000.0,
    "noise_relative_to_peak": 0.005,
    "offset_sd_m_s2": 0.2,
    "relative_gain_sd": 0.005,
    "velocity_sd_m_s": 0.005,
    "relative_mass_sd": 0.002,
}


def spreads(**of_level: float) -> dict[str, float]:
    """Standard deviations of log K and of log C alike, by level: of a subject, a trial, an impact."""
    return {f"sd_{level}_{q}": sd for level, sd in of_level.items() for q in "KC"}


def study(
    tissue: Mapping[str, Any] | None = None,
    recording: Mapping[str, Any] | None = None,
    *,
    people: int = 1,
    masses: Sequence[float] = (0.7,),
    velocity: float | Sequence[float] = 1.5,
    design: Mapping[str, Any] | None = None,
    **content: Any,
) -> Simulation:
    """People of 3000 N/m and 25 N s/m, each hit in conditions t0, t1, ... of these masses [kg].

    Args:
        tissue: what its table says besides.
        recording: its table; half a per cent of the peak is noise unless it says otherwise.
        people: how many.
        masses: of each condition.
        velocity: at contact [m/s], of all conditions or of each.
        design: what its table says besides.
        content: further tables and keys, such as seed, gravity or recorder.
    """
    pairs = zip(masses, np.broadcast_to(velocity, len(masses)).tolist(), strict=True)
    conditions = [{"trial": f"t{i}", "mass_kg": M, "velocity_m_s": V} for i, (M, V) in enumerate(pairs)]
    tables = {
        "design": {"subjects": people, "conditions": conditions, **(design or {})},
        "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, **(tissue or {})},
        "recording": {"noise_relative_to_peak": 0.005} if recording is None else recording,
    }
    return Simulation.model_validate({"name": "study", **tables, **content})


def simulated(*tables: Mapping[str, Any], **changes: Any) -> Campaign:
    """The recordings and the truth of such a `study`."""
    return simulate(study(*tables, **changes))


def held(found: Any, truth: pd.DataFrame, name: str) -> np.ndarray:
    """Of which impacts the 90 % interval of a parameter holds the truth.

    Args:
        found: a table of estimates, the posterior of a fit, or posteriors of single impacts.
        truth: of the same impacts.
        name: of the parameter.
    """
    column = COLUMNS.get(name, name)
    if isinstance(found, pd.DataFrame):
        low, high = (found[f"{name}_{end}{column.removeprefix(name)}"] for end in ("low", "high"))
    elif isinstance(found, Mapping):
        low, high = np.quantile(found[name], [0.05, 0.95], axis=(0, 1))
    else:
        low, high = (found.quantities[name][end] for end in ("low", "high"))
    true = truth[column].to_numpy()
    return np.asarray((low <= true) & (true <= high))


def holds(found: Any, truth: pd.DataFrame, names: Iterable[str] = "KC", least: float | None = None) -> None:
    """Nine in ten intervals hold the truth, within three binomial standard errors.

    Of few impacts, or of ones that depend on one another, ``least`` is the share that holds it at least.
    """
    for name in names:
        share = held(found, truth, name).mean()
        if least is None:
            assert abs(share - 0.9) < binomial(len(truth)), name
        else:
            assert share >= least, name


def binomial(number: int, share: float = 0.9) -> float:
    """Three standard errors of a share."""
    return 3 * np.sqrt(share * (1 - share) / number)
