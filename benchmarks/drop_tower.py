r"""Raw recordings of a drop tower whose pads obey different laws, and what is true of a greater height.

    .venv/bin/python benchmarks/drop_tower.py tower
    .venv/bin/bayestissue init tower --pattern "{pad}_{drop_height_cm}cm_{repeat}.csv" --channel Accel \
        --quantity deceleration --gravity drop --set mass_kg=5 --set subject=tower \\
        --uncertainty velocity=0.01 --out drops
    .venv/bin/bayestissue fit drops --K pad --C pad --out by-impact
    .venv/bin/bayestissue fit drops --model stiffening-by-pad.toml --out by-stiffening
    .venv/bin/bayestissue compare by-impact by-stiffening --out compared \
        --ask "peak_force[pad=C, drop_height_cm=30]"

A flat mass of 5 kg falls on four pads from 12 and 20 cm, three times each. Three pads are a spring beside a
damper, C stiffens as it is compressed, F = K x (1 + (x / 12 mm)^2) + 120 x'. The accelerometer reads zero in
free fall and 50 g at most, with noise of 0.1 g; heights err by 0.01 m/s of the velocity. Integrated by scipy,
without the program. Printed is the greatest force of each pad, M times the mass's deceleration and weight,
from 30 cm.
"""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

MASS_KG, STANDARD_GRAVITY = 5.0, 9.80665
RATE_HZ, BEFORE_S, ALL_S = 10_000.0, 0.02, 0.1
NOISE_G, VELOCITY_SD = 0.1, 0.01
HEIGHTS_CM, REPEATS, ASKED_CM = (12, 20), 3, 30
# K in N/m, C in N s/m, and the depth at which a secant has doubled, m.
PADS = {
    "A": (30_000.0, 100.0, np.inf),
    "B": (60_000.0, 120.0, np.inf),
    "C": (30_000.0, 120.0, 0.012),
    "D": (180_000.0, 200.0, np.inf),
}


def force(pad: str, depth: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """What a pad pushes with, N; none is sticky."""
    K, C, doubled = PADS[pad]
    pushes = K * depth * (1 + (depth / doubled) ** 2) + C * velocity
    return np.where(depth > 0, np.maximum(pushes, 0.0), 0.0)


def drop(pad: str, velocity: float, time: np.ndarray) -> np.ndarray:
    """The force on the mass at times from contact on, N."""

    def rates(_: float, state: np.ndarray) -> tuple[float, float]:
        return state[1], STANDARD_GRAVITY - float(force(pad, state[0], state[1])) / MASS_KG

    motion = solve_ivp(
        rates, (0, time[-1]), (0.0, velocity), t_eval=time, rtol=1e-9, atol=1e-12, max_step=1e-4
    )
    return force(pad, *motion.y)


def velocity_from(height_cm: float) -> float:
    """At contact, m/s."""
    return float(np.sqrt(2 * STANDARD_GRAVITY * height_cm / 100))


def main() -> None:
    folder, rng = Path(sys.argv[1]), np.random.default_rng(30)
    folder.mkdir()
    time = np.arange(0.0, ALL_S, 1 / RATE_HZ)
    for pad, height, repeat in product(PADS, HEIGHTS_CM, range(1, REPEATS + 1)):
        contact = BEFORE_S + rng.uniform() / RATE_HZ
        after = time[time >= contact] - contact
        velocity = velocity_from(height) + VELOCITY_SD * rng.standard_normal()
        reading = np.zeros_like(time)
        # From 0 on, that the solver may begin there.
        reading[time >= contact] = drop(pad, velocity, np.r_[0.0, after])[1:] / MASS_KG / STANDARD_GRAVITY
        reading += NOISE_G * rng.standard_normal(len(time))
        table = pd.DataFrame({"Time (s)": time, "Accel (g)": reading})
        table.to_csv(folder / f"{pad}_{height}cm_{repeat}.csv", index=False, float_format="%.6g")
    for pad in PADS:
        # A microsecond's grid, of which the greatest is as good as exact.
        fine = np.arange(0.0, 0.05, 1e-6)
        print(f"pad {pad}: {drop(pad, velocity_from(ASKED_CM), fine).max():.0f} N from {ASKED_CM} cm")


if __name__ == "__main__":
    main()
