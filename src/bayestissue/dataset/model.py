"""The dataset as the rest of the program sees it: a table of impacts, and recordings in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Float64

from bayestissue.errors import Problem

Quantity = Literal["deceleration", "acceleration", "displacement"]


@dataclass(frozen=True, eq=False)
class Trace:
    """The recording of one impact.

    Attributes:
        time_s: the recorder's own time, s; 0 need not be the moment of contact.
        value: deceleration or acceleration in m/s², or displacement in m, after scale and offset.
    """

    time_s: Float64[np.ndarray, " sample"]
    value: Float64[np.ndarray, " sample"]


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of the measuring chain; 0 where nothing was stated.

    Attributes:
        relative_mass_sd: of the impactor's mass, as a fraction of it.
        velocity_sd_m_s: of the velocity at contact, m/s.
        relative_gain_sd: of the recorder's sensitivity, as a fraction of it.
        offset_sd: of the recorder's zero, in SI units of the recorded quantity.
    """

    relative_mass_sd: float = 0.0
    velocity_sd_m_s: float = 0.0
    relative_gain_sd: float = 0.0
    offset_sd: float = 0.0


@dataclass(frozen=True, eq=False)
class Dataset:
    """A checked dataset.

    Attributes:
        name: what ``dataset.toml`` calls it.
        description: free text.
        impacts: one row per impact: ``impact``, ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s``
            (missing where a displacement was recorded without one) and the covariates.
        traces: the recordings, in the order of ``impacts``.
        quantity: what was recorded; the sign of ``traces`` follows from it.
        uncertainty: of the measuring chain.
        warnings: what looks odd but stops nothing.
        left_out: what was wrong with the impacts that ``skip_bad`` left out.
        folder: where it was read from.
        input_hash: SHA-256 over the files that were read.
    """

    name: str
    description: str
    impacts: pd.DataFrame
    traces: list[Trace]
    quantity: Quantity
    uncertainty: Uncertainty
    warnings: tuple[Problem, ...]
    left_out: tuple[Problem, ...]
    folder: Path
    input_hash: str
