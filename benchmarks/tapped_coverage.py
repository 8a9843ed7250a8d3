"""How often intervals hold the truth of masses that a hammer taps: simulated studies, fitted.

    .venv/bin/python benchmarks/tapped_coverage.py
    .venv/bin/python benchmarks/tapped_coverage.py 20

Studies of four people, each tapped with three masses on the tissue, twice. K, the damping ratio, the taps'
duration, the noise and the sampling rate are drawn; all declared masses are wrong by one factor, known to
5 %, the hammer's gain to 1 % and the accelerometer's to 0.5 %. Noted of each are the 90 % intervals of the
factor, of both gains, of K, C and the mass of each tap and of the mass exponents, how far the masses are off,
and whether the first line says so.

A number is of the studies to do in all; those that were done are not done again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from force_coverage import intervals
from studies import counted, fitted, sides

from bayestissue.dataset.chain import Uncertainty
from bayestissue.inference.checking.force import judge_force
from bayestissue.simulation import Simulation, simulate

MASSES_KG, IMPULSE = (0.8, 1.4, 2.4), 0.4
MASS_SD, GAIN_SD, FORCE_GAIN_SD = 0.05, 0.005, 0.01
RATES_HZ = (2000.0, 5000.0)
# A share of 90 % of their intervals is known to 3 %.
STUDIES = 100


def study(number: int) -> Simulation:
    """One study; its random numbers follow from its number."""
    random = np.random.default_rng([number, 23])
    K = 4000.0 * 2.0 ** random.uniform(-1, 1)
    ratio = 0.03 * 10.0 ** random.uniform(0, 1)
    return Simulation.model_validate(
        {
            "name": "tapped",
            "seed": number,
            "design": {
                "subjects": 4,
                "repeats": 2,
                "conditions": [
                    {"trial": f"{mass} kg", "mass_kg": mass, "impulse_N_s": IMPULSE} for mass in MASSES_KG
                ],
            },
            "tissue": {
                "K_N_per_m": K,
                "C_N_s_per_m": 2 * ratio * np.sqrt(K * MASSES_KG[1]),
                "reference_mass_kg": MASSES_KG[1],
                **{f"sd_{of}_{q}": sd for of, sd in (("subject", 0.2), ("impact", 0.05)) for q in "KC"},
            },
            "tap": {"duration_s": random.uniform(0.003, 0.008)},
            "recording": {
                "sampling_rate_hz": RATES_HZ[number % len(RATES_HZ)],
                "noise_sd_m_s2": 0.02 * 10.0 ** random.uniform(0, 1),
                "offset_sd_m_s2": 0.1,
                "relative_gain_sd": GAIN_SD,
                "relative_mass_sd": 0.002,
                "mass_factor": float(np.exp(MASS_SD * random.standard_normal())),
                "force": {
                    **{"place": "hammer", "noise_sd_N": 0.1, "offset_sd_N": 0.1},
                    "relative_gain_sd": FORCE_GAIN_SD,
                },
            },
        }
    )


def row_of(number: int) -> dict[str, Any]:
    """What is kept of a study."""
    made = simulate(simulation := study(number))
    declared = Uncertainty(MASS_SD, 0.0, GAIN_SD, 0.0)
    fit = fitted(replace(made.dataset(simulation.name), uncertainty=declared), number)
    tap = fit.prepared.tap
    assert tap is not None
    account = judge_force(tap, "hammer", fit.posterior, fit.prepared.signal.mass)
    off = abs(simulation.recording.mass_factor - 1)
    row = sides(intervals(fit, made.truth, simulation))
    return row | {"passed": fit.passed, "off": off, "named": bool(account["first"])}


def main() -> None:
    counted("coverage_channels-tapped", row_of, STUDIES)


if __name__ == "__main__":
    main()
