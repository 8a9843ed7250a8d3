"""What is to be explained: the thesis's published estimates, or a dataset's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from jaxtyping import Bool

from bayestissue import runtime
from bayestissue.errors import InputError
from bayestissue.inference.points.fit import Method
from bayestissue.thesis.causes.design import (
    Design,
    Recorder,
    campaign_statistics,
    observed_statistics,
    published_design,
)
from bayestissue.thesis.causes.specification import CausesSpecification, Range

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset
    from bayestissue.signal import Displacements

# Simulated tissue may be this many times softer or stiffer than the dataset's median estimate.
_FOLD = 3.0
# Recordings go on to this many times the dataset's longest usual time to peak.
_REACH = 3.5
_QUIET = 0.01


FEWEST_MASSES = 3


@dataclass(frozen=True)
class Subject:
    """The observed table of estimates, and how campaigns like it are made.

    Attributes:
        title: what it is, in words.
        setting: the design of every campaign.
        observed: its statistics.
        level_known: whether K is known to be in N/m.
        input_hash: of what was read.
        description: what the report says of it.
        recording: of a dataset, ranges of its measuring chain, by their keys in a specification.
        stiffness: the same of K, N/m.
    """

    title: str
    setting: Design
    observed: Mapping[str, float]
    level_known: bool
    input_hash: str
    description: dict[str, Any]
    recording: Mapping[str, Range] = field(default_factory=dict)
    stiffness: Range | None = None

    def applicable(self, specification: CausesSpecification) -> CausesSpecification:
        """The specification with these ranges, and without centring where the method doesn't centre."""
        if self.setting.recorder is None:
            return specification
        causes = {
            name: cause
            for name, cause in specification.causes.items()
            if cause.mechanism != "centring" or self.setting.recorder.method == "dds"
        }
        tissue = specification.tissue.model_copy(update={"K_N_per_m": self.stiffness})
        recording = specification.recording.model_copy(update=self.recording)
        return specification.model_copy(update={"tissue": tissue, "recording": recording, "causes": causes})


def subject(target: str, *, method: Method, skip_bad: bool) -> Subject:
    """Read what is to be explained.

    Args:
        target: ``published``, or a dataset's folder.
        method: of a dataset's estimates.
        skip_bad: leave out a dataset's impacts that can't be used.

    Raises:
        InputError: the tables or the dataset can't be used, or its masses do not differ.
    """
    if target == "published":
        return published_subject()
    from bayestissue.dataset import read_dataset

    return dataset_subject(read_dataset(Path(target), skip_bad=skip_bad), method, target)


def published_subject() -> Subject:
    """The thesis's Tables 5.2 to 5.11."""
    from bayestissue.dataset.published import read_published

    tables = read_published()
    design, observed = published_design(tables)
    statistics, content = observed_statistics(observed, design), runtime.content_hash(tables.paths)
    words = _description("published", "the thesis's published estimates", design, design.in_rows, "dds")
    return Subject("published estimates", design, statistics, False, content, words)


def _description(
    name: str, title: str, design: Design, rows: Bool[np.ndarray, " impact"], method: Method
) -> dict[str, Any]:
    """What the report says of estimates, of which those in ``rows`` are usable."""
    return {
        "name": name,
        "title": title,
        "impacts": len(design.mass),
        "rows": int(rows.sum()),
        "subjects": design.subjects,
        "trials": design.trials,
        "method": method,
    }


def dataset_subject(dataset: Dataset, method: Method, source: str) -> Subject:
    """A dataset's own estimates, by the method named; of its people, not of phantoms of known stiffness.

    Raises:
        InputError: displacements were recorded, or there are fewer than three masses.
    """
    from bayestissue.inference.points.estimates import default_options, estimates_table
    from bayestissue.signal import displacements

    dataset = dataset.people
    impacts = dataset.impacts
    _require_masses(dataset, source)
    tables = {}
    for fit_method in dict.fromkeys((method, "exact")):
        signal = displacements(dataset, default_options(fit_method))
        tables[fit_method] = estimates_table(dataset, signal, fit_method)
    design = Design(
        mass=impacts["mass_kg"].to_numpy(float),
        velocity=impacts["velocity_m_s"].to_numpy(float),
        subject=pd.factorize(impacts["subject"])[0],
        trial=pd.factorize(impacts["trial"])[0],
        in_rows=np.ones(len(impacts), bool),
        recorder=_recorder(signal, method),
    )
    K, C = (tables[method][name].to_numpy(float)[None] for name in ("K_N_per_m", "C_N_s_per_m"))
    positive = (K > 0) & (C > 0)
    statistics = campaign_statistics(np.where(positive, K, np.nan), np.where(positive, C, np.nan), design)
    return Subject(
        dataset.name,
        design,
        {name: float(value[0]) for name, value in statistics.items() if np.isfinite(value[0])},
        True,
        dataset.input_hash,
        _description(dataset.name, f"the estimates of {dataset.name}", design, positive, method),
        _recording(dataset, signal),
        _log_range(float(np.nanmedian(tables["exact"]["K_N_per_m"])), _FOLD),
    )


def _recorder(signal: Displacements, method: Method) -> Recorder:
    shortest = float(signal.dt.min())
    samples = int(np.ceil(_REACH * float(np.quantile(signal.time_to_peak, 0.9)) / shortest))
    return Recorder(signal.dt, quiet=max(20, round(_QUIET / shortest)), samples=samples, method=method)


def _recording(dataset: Dataset, signal: Displacements) -> dict[str, Range]:
    """Ranges of the measuring chain, by the stated standard deviations of gain, zero and velocity.

    Noise is known to a factor of two from the quiet parts.
    """
    stated, peak = dataset.uncertainty, float(np.median(signal.deceleration.max(axis=1)))
    velocity = stated.velocity_sd_m_s / float(np.median(dataset.impacts["velocity_m_s"]))
    gain = 2 * stated.relative_gain_sd
    return {
        "noise_relative_to_peak": _log_range(float(np.median(signal.noise_sd)) / peak),
        "offset_relative_to_peak_sd": _log_range(stated.offset_sd / peak),
        "gain": Range(low=1 - gain, high=1 + gain),
        "relative_velocity_sd": _log_range(velocity),
    }


def _log_range(value: float, factor: float = 2.0) -> Range:
    """The range from ``value`` / ``factor`` to ``value`` ``factor``, the logarithm uniform."""
    value = max(value, 1e-6)
    return Range(low=value / factor, high=value * factor, log=True)


def _require_masses(dataset: Dataset, source: str) -> None:
    if dataset.quantity == "displacement":
        raise InputError.stated(
            "wrong-quantity.causes", source, column="signal.quantity", value=dataset.quantity
        )
    if dataset.gravity:
        gravity = f"{dataset.gravity:g} m/s²"
        raise InputError.stated("wrong-quantity.drops", source, column="signal.gravity", value=gravity)
    masses = dataset.impacts.groupby("trial")["mass_kg"].mean().round(9).nunique()
    if masses < FEWEST_MASSES:
        raise InputError.stated("one-mass", source, column="mass_kg", value=masses, fewest=FEWEST_MASSES)
