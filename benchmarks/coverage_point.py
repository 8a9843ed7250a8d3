"""How often the 90 % intervals of single impacts hold the truth.

    .venv/bin/python benchmarks/coverage_point.py

The intervals are those of `estimates.csv` of recorded decelerations, with the errors of the measuring chain
as they are declared. Each line is 600 impacts on tissues around K = 3000 N/m, C = 25 N s/m, at 10 kHz; a
coverage of 90 % measured on 600 has a standard error of 1.2 %. The coverage is of the unflagged ones, whose
share stands beside it, and "with_bounds" that of all impacts, flagged or not: where a recording does not
tell K, or C, its interval goes from 0 to an upper bound. Lines of a damping ratio are 600 impacts of 0.5,
0.7 and 1 kg on K = 3000 N/m, at 5 kHz under noise of 0.3 m/s², and 300 at 2 and 5 kHz under noise of a fifth
of the peak (a standard error of 1.7 %), of a seed that guided no choice of the program.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import evidence
import numpy as np

from bayestissue.base import runtime
from bayestissue.inference.single.impact_estimates import estimate
from bayestissue.studies.simulation import Simulation, simulate

IMPACTS, DAMPED, NOISY, SEED = 600, 600, 300, 2917
type Row = dict[str, object]


def recorded(chain: dict[str, float]) -> Row:
    """Of impacts around one K and C."""
    return estimated(campaign(chain))


def damped(zeta: float, chain: dict[str, float], impacts: int = DAMPED) -> Row:
    """The same of impacts of one damping ratio, whatever their mass."""
    masses = (0.5, 0.7, 1.0)
    spread = {f"sd_{level}_{q}": 0.0 for level in ("subject", "trial", "impact") for q in "KC"}
    tissue = {"K_N_per_m": 3000.0, "C_N_s_per_m": 2 * zeta * 3000**0.5, "reference_mass_kg": 1.0, **spread}
    conditions = [{"trial": f"{mass} kg", "mass_kg": mass, "velocity_m_s": 1.5} for mass in masses]
    content = {
        "name": "damped",
        "seed": SEED,
        "design": {"conditions": conditions, "subjects": impacts // len(masses)},
        "tissue": {**tissue, "mass_exponent_C": 0.5},
        "recording": chain,
    }
    return estimated(Simulation.model_validate(content))


def estimated(made: Simulation) -> Row:
    """How many intervals of simulated impacts hold the truth."""
    result = simulate(made)
    truth, found = result.truth, estimate(result.dataset(made.name))
    row: Row = {"impacts": len(truth)}
    for letter, unit in (("K", "N_per_m"), ("C", "N_s_per_m")):
        true = truth[f"{letter}_{unit}"].to_numpy()
        low, high = (found[f"{letter}_{end}_{unit}"].to_numpy() for end in ("low", "high"))
        sound = found["flags"].to_numpy() == ""
        held, bounded = (low <= true) & (true <= high), np.isfinite(high)
        row |= {f"{letter}_held": held[sound].sum(), "unflagged": sound.sum()}
        row |= {f"{letter}_held_with_bounds": held[bounded].sum(), f"{letter}_bounded": bounded.sum()}
    return row


def campaign(chain: dict[str, float]) -> Simulation:
    tissue = {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, "sd_impact_K": 0.2, "sd_impact_C": 0.2}
    conditions = [{"trial": "a", "mass_kg": 0.7, "velocity_m_s": 1.5}]
    design = {"conditions": conditions, "subjects": IMPACTS}
    content = {"name": "coverage", "seed": 0, "design": design, "tissue": tissue, "recording": chain}
    return Simulation.model_validate(content)


def cases() -> dict[str, Callable[[], Row]]:
    """What makes each line, by its name."""
    white = {"noise_relative_to_peak": 0.005}
    with_offset = {**white, "offset_sd_m_s2": 0.2, "before_contact_s": 0.002}
    with_errors = {**white, "relative_mass_sd": 0.005, "velocity_sd_m_s": 0.0075, "relative_gain_sd": 0.005}
    lines = {
        "white noise on d, 0.1 % of its peak": partial(recorded, {"noise_relative_to_peak": 0.001}),
        "white noise on d, 0.5 % of its peak": partial(recorded, white),
        "that, and offsets of 0.2 m/s² behind a quiet part of 2 ms": partial(recorded, with_offset),
        "white noise of 0.5 %, and 0.5 % of error in each of M, V and gain": partial(recorded, with_errors),
    }
    for zeta in (0.4, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0):
        chain = {"noise_sd_m_s2": 0.3, "sampling_rate_hz": 5000}
        lines[f"white noise on d, 0.3 m/s² at 5 kHz; damping ratio {zeta}"] = partial(damped, zeta, chain)
    for rate, zeta in itertools.product((2000, 5000), (0.2, 0.4, 1.0)):
        chain = {"noise_relative_to_peak": 0.2, "sampling_rate_hz": rate}
        name = f"white noise on d, 20 % of its peak at {rate // 1000} kHz; damping ratio {zeta}"
        lines[name] = partial(damped, zeta, chain, NOISY)
    return lines


def main() -> None:
    runtime.configure()
    with evidence.recorded("coverage_point") as record:
        lines = cases()
        for name in record.missing(lines):
            record.add(name, [lines[name]()])


if __name__ == "__main__":
    main()
