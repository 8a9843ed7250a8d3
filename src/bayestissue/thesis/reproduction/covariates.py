"""The variables of the thesis's correlation and regression tables, made from energy, velocity and mass."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

_FACTORS = {"energy": "energy_J", "velocity": "velocity_m_s", "mass": "mass_kg"}

NEVER_TABULATED = "skin fold and muscle thickness were never tabulated"
NEVER_VARIES = "a covariate that never varies correlates with nothing"


def factors(name: str) -> tuple[str, ...]:
    """The factors, sorted, of a variable as the thesis writes it, such as ``"Energy* Mass *Velocity"``.

    ``"Velocity*Energy"`` and ``"Energy * Velocity"`` come out the same; ``"Mass Sq"`` is mass twice. What
    isn't made of energy, velocity and mass is its own single factor.
    """
    words = name.lower().strip()
    squared = re.fullmatch(r"(\w+) se?q", words)
    parts = [squared[1]] * 2 if squared else [part.strip() for part in words.split("*")]
    return tuple(sorted(parts))


def covariate(name: str, table: pd.DataFrame) -> np.ndarray | None:
    """The product of the factors of ``name`` for every condition of ``table``; None for skin and muscle."""
    parts = factors(name)
    if any(part not in _FACTORS for part in parts):
        return None
    return np.prod([table[_FACTORS[part]].to_numpy(float) for part in parts], axis=0)


def has_mass(name: str) -> bool:
    """Whether mass is a factor of the variable ``name``."""
    return "mass" in factors(name)
