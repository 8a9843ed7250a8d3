"""What measuring x from its own mean does to estimates: one tissue, several masses, no noise."""

from __future__ import annotations

import pandas as pd

from bayestissue.dataset.model import Dataset
from bayestissue.inference.single.estimates import estimate
from bayestissue.simulation.campaign import simulate
from bayestissue.simulation.specification import Condition, Design, Recording, Simulation, Tissue

MASSES_KG = (0.375, 0.666, 1.0, 1.333)
_K, _C = 3000.0, 25.0


def one_tissue() -> Dataset:
    """Noise-free impacts of `MASSES_KG` on one and the same tissue."""
    conditions = tuple(Condition(trial=f"{mass:g} kg", mass_kg=mass, velocity_m_s=1.5) for mass in MASSES_KG)
    simulation = Simulation(
        name="one tissue",
        design=Design(conditions=conditions, subjects=1),
        tissue=Tissue(K_N_per_m=_K, C_N_s_per_m=_C),
        recording=Recording(sampling_rate_hz=10_000.0),
    )
    return simulate(simulation).dataset(simulation.name)


def centring_table() -> pd.DataFrame:
    """Estimates of one tissue from noise-free impacts of four masses, about the mean.

    Columns: ``mass_kg``; ``K_N_per_m``, ``C_N_s_per_m``, the truth; ``K_centred``, ``C_centred``, the
    thesis's fit to deviations from the sample mean (section 2.3).
    """
    dataset = one_tissue()
    centred = estimate(dataset, method="dds")
    return pd.DataFrame(
        {
            "mass_kg": dataset.impacts["mass_kg"],
            "K_N_per_m": _K,
            "C_N_s_per_m": _C,
            "K_centred": centred["K_N_per_m"],
            "C_centred": centred["C_N_s_per_m"],
        }
    )
