"""What is to be explained: the thesis's published estimates, or a dataset's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayestissue import runtime
from bayestissue.errors import refusal
from bayestissue.inference.points.fit import Method
from bayestissue.thesis.causes.design import Design, Recorder, published_design
from bayestissue.thesis.causes.specification import CausesSpecification, Range
from bayestissue.thesis.causes.statistics import campaign_statistics, observed_statistics

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset
    from bayestissue.signal import Displacements

# Simulated tissue may be this many times softer or stiffer than the dataset's median estimate.
_FOLD = 3.0
# Recordings go on to this many times the dataset's longest usual time to peak.
_REACH = 3.5
_QUIET = 0.01


@dataclass(frozen=True)
class KnownRecorder:
    """The recorder of a dataset, and the ranges that follow from it and from its estimates."""

    recorder: Recorder
    K_N_per_m: Range
    noise: Range
    offset: Range
    gain: Range
    velocity: Range

    @classmethod
    def from_dataset(
        cls, dataset: Dataset, signal: Displacements, estimates: pd.DataFrame, method: Method
    ) -> KnownRecorder:
        """Read off a dataset, its displacements and its exact estimates.

        The stated standard deviations of gain and velocity set their ranges; noise is known to a factor of
        two from the quiet parts; K lies within a factor of three of the median exact estimate.
        """
        peak = float(np.median(signal.deceleration.max(axis=1)))
        stiffness = float(np.nanmedian(estimates["K_N_per_m"]))
        noise = max(float(np.median(signal.noise_sd)) / peak, 1e-6)
        offset = max(dataset.uncertainty.offset_sd / peak, 1e-6)
        velocity = max(
            dataset.uncertainty.velocity_sd_m_s / float(np.median(dataset.impacts["velocity_m_s"])), 1e-6
        )
        gain = 2 * dataset.uncertainty.relative_gain_sd
        longest = float(np.quantile(signal.time_to_peak, 0.9))
        shortest = float(signal.dt.min())
        return cls(
            Recorder(
                dt=signal.dt,
                quiet=max(20, round(_QUIET / shortest)),
                samples=int(np.ceil(_REACH * longest / shortest)),
                method=method,
            ),
            K_N_per_m=Range(low=stiffness / _FOLD, high=stiffness * _FOLD, log=True),
            noise=Range(low=noise / 2, high=noise * 2, log=True),
            offset=Range(low=offset / 2, high=offset * 2, log=True),
            gain=Range(low=1 - gain, high=1 + gain),
            velocity=Range(low=velocity / 2, high=velocity * 2, log=True),
        )

    def informed(self, specification: CausesSpecification) -> CausesSpecification:
        """The specification with these ranges, and without centring where the method doesn't centre."""
        recording = specification.recording.model_copy(
            update={
                "noise_relative_to_peak": self.noise,
                "offset_relative_to_peak_sd": self.offset,
                "gain": self.gain,
                "relative_velocity_sd": self.velocity,
            }
        )
        causes = {
            name: cause
            for name, cause in specification.causes.items()
            if cause.mechanism != "centring" or self.recorder.method == "dds"
        }
        tissue = specification.tissue.model_copy(update={"K_N_per_m": self.K_N_per_m})
        return specification.model_copy(update={"tissue": tissue, "recording": recording, "causes": causes})


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
        known: what a dataset tells of its recorder and tissue; None for published estimates.
    """

    title: str
    setting: Design
    observed: Mapping[str, float]
    level_known: bool
    input_hash: str
    description: dict[str, Any]
    known: KnownRecorder | None = None

    def applicable(self, specification: CausesSpecification) -> CausesSpecification:
        """The specification with what is known of the recorder, and without causes that can't act here."""
        return self.known.informed(specification) if self.known else specification


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
    return Subject(
        "published estimates",
        design,
        observed_statistics(observed, design),
        observed.unit_known,
        runtime.content_hash(tables.paths),
        {
            "name": "published",
            "title": "the thesis's published estimates",
            "impacts": len(design.mass),
            "rows": int(design.in_rows.sum()),
            "subjects": design.subjects,
            "trials": design.trials,
            "method": "dds",
        },
    )


def dataset_subject(dataset: Dataset, method: Method, source: str) -> Subject:
    """A dataset's own estimates, by the method named.

    Raises:
        InputError: displacements were recorded, or there are fewer than three masses.
    """
    from bayestissue.inference.points.estimates import default_options, estimates_table
    from bayestissue.signal import displacements

    impacts = dataset.impacts
    _require_masses(dataset, source)
    tables = {}
    for fit_method in {method, "exact"}:
        signal = displacements(dataset, default_options(fit_method))
        tables[fit_method] = estimates_table(dataset, signal, fit_method)
    table = tables[method]
    known = KnownRecorder.from_dataset(dataset, signal, tables["exact"], method)
    design = Design(
        mass=impacts["mass_kg"].to_numpy(float),
        velocity=impacts["velocity_m_s"].to_numpy(float),
        subject=pd.factorize(impacts["subject"])[0],
        trial=pd.factorize(impacts["trial"])[0],
        in_rows=np.ones(len(impacts), bool),
        recorder=known.recorder,
    )
    K, C = (table[name].to_numpy(float)[None] for name in ("K_N_per_m", "C_N_s_per_m"))
    positive = (K > 0) & (C > 0)
    statistics = campaign_statistics(np.where(positive, K, np.nan), np.where(positive, C, np.nan), design)
    return Subject(
        dataset.name,
        design,
        {name: float(value[0]) for name, value in statistics.items() if np.isfinite(value[0])},
        True,
        dataset.input_hash,
        {
            "name": dataset.name,
            "title": f"the estimates of {dataset.name}",
            "impacts": len(impacts),
            "rows": int(positive.sum()),
            "subjects": design.subjects,
            "trials": design.trials,
            "method": method,
        },
        known,
    )


def _require_masses(dataset: Dataset, source: str) -> None:
    if dataset.quantity == "displacement":
        raise refusal(
            source,
            "recorded decelerations or accelerations",
            "The causes are simulated as decelerations; a dataset of displacements can't be compared.",
            column="signal.quantity",
            value=dataset.quantity,
            code="wrong-quantity",
        )
    if dataset.gravity:
        raise refusal(
            source,
            "impacts across gravity, as the thesis's pendulum made them",
            "The causes are simulated without gravity; a dataset of drops can't be compared.",
            column="signal.gravity",
            value=f"{dataset.gravity:g} m/s²",
            code="wrong-quantity",
        )
    masses = dataset.impacts.groupby("trial")["mass_kg"].mean().round(9).nunique()
    if masses < FEWEST_MASSES:
        raise refusal(
            source,
            f"conditions of at least {FEWEST_MASSES} masses",
            "Where the mass does not vary there is no dependence on it to explain.",
            column="mass_kg",
            value=masses,
            code="one-mass",
        )
