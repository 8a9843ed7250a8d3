"""What a dataset tells of its recorder and its tissue, in place of priors for what a thesis did not print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayestissue.thesis.causes.design import Recorder
from bayestissue.thesis.causes.specification import CausesSpecification, Range

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset
    from bayestissue.inference.points.fit import Method
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
    def of(
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
        kept = {
            name: cause
            for name, cause in specification.causes.items()
            if cause.mechanism != "centring" or self.recorder.method == "dds"
        }
        tissue = specification.tissue.model_copy(update={"K_N_per_m": self.K_N_per_m})
        return specification.model_copy(update={"tissue": tissue, "recording": recording, "causes": kept})
