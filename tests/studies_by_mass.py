"""A small study with masses in error, for tests that say by a normal what its traces tell."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayestissue.mechanics.oscillator import impact_motion
from bayestissue.model.hierarchy.specification import Formulas, MassError, ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.recordings.dataset import Dataset, Trace
from dataset_bench import settings_of


def prepared_study(
    impacts: pd.DataFrame, formula: str, mass_error: MassError, relative_mass_sd: float
) -> Prepared:
    """The model of these impacts, K and C by one formula; no test reads what was recorded."""
    time = np.arange(0, 0.05, 1e-3)
    x = impact_motion(time, np.full((len(impacts), 1), 60.0), 0.3, 1.5).displacement
    x = np.asarray(x) + 1e-5 * np.random.default_rng(0).normal(size=x.shape)
    settings = settings_of(quantity="displacement", uncertainty={"relative_mass_sd": relative_mass_sd})
    made = Dataset(settings, impacts, [Trace(time, row) for row in x])
    formulas = Formulas(K=formula, C=formula)
    specification = ModelSpecification(name="m", likelihood="a2", formula=formulas, mass_error=mass_error)
    return prepare(made, specification, source="m.toml")
