"""Point estimates by the thesis's method as a table; what every table of estimates has."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded, by_impact, codes_of
from bayestissue.base.impact_arrays import PerImpact
from bayestissue.inference.points.notes import (
    ANOTHER_PEAK,
    ARCCOS,
    AT_A_LIMIT,
    NO_OSCILLATOR,
    NOISELESS,
    NOT_FILTERED,
    NOT_POSITIVE,
    PHANTOM,
    THETA1,
    TOO_DEEP,
    UNUSED,
)
from bayestissue.inference.points.point_fit import fit_points
from bayestissue.mechanics.oscillator import peak_displacement
from bayestissue.recordings.dataset.impact_table import of_phantoms
from bayestissue.recordings.signal import Displacements
from bayestissue.recordings.signal.displacement import FEWEST_SAMPLES
from bayestissue.recordings.signal.quality import Findings, raised

if TYPE_CHECKING:
    from bayestissue.recordings.dataset import Dataset

# Past these a trace of one loading tells K and C apart no more: one of the two forces rules alone.
ZETA_LIMITS = (0.005, 5.0)
# The displacement that K and C imply and the one recorded differ by a few per cent at worst if both hold.
PEAK_DISAGREES = 0.2
THICKNESS = "tissue_thickness_m"
# By the names of columns.
_OSCILLATOR = {
    "phi1": "phi1",
    "phi2": "phi2",
    "theta1": "theta1",
    "sigma_a": "sigma_a",
    "omega_n_rad_s": "omega_n",
    "zeta": "zeta",
    "K_N_per_m": "K",
    "C_N_s_per_m": "C",
}
Masks = Mapping[Coded, np.ndarray]


class Inspected(NamedTuple):
    """Recordings with what was made of them and what was found on them.

    Attributes:
        dataset: the recordings.
        signal: what was made of them.
        findings: what `bayestissue.recordings.signal.quality.inspect` found; flagged.
    """

    dataset: Dataset
    signal: Displacements
    findings: Findings

    def table(
        self,
        oscillator: Mapping[str, PerImpact],
        wrong: Masks,
        noted: Masks,
        further: Mapping[str, PerImpact] = MappingProxyType({}),
    ) -> pd.DataFrame:
        """The columns of `estimates.csv`.

        Args:
            oscillator: its numbers by the names of `bayestissue.inference.points.point_fit.PointFit`; none
                where there are none.
            wrong: what the method says is wrong with an impact, and where.
            noted: what is only its way, and where.
            further: columns by their names.
        """
        signal, unknown = self.signal, np.full(len(self.signal.dt), np.nan)
        if self.dataset.quantity == "displacement":
            # Sound recordings come to it too: the way of a position sensor's noise.
            wrong, noted = {}, {**noted, **wrong}
        table = self.dataset.impacts[["impact", "subject", "trial", "mass_kg"]].assign(
            velocity_m_s=signal.velocity,
            n_samples=signal.n_samples,
            sampling_interval_s=signal.dt,
            **{column: oscillator.get(name, unknown) for column, name in _OSCILLATOR.items()},
            peak_displacement_m=signal.stop.x,
            time_to_peak_s=signal.time_to_peak,
            flags=["; ".join(row) for row in self.flags(wrong)],
            **further,
            notes=["; ".join(row) for row in self._notes(noted)],
        )
        return table.reset_index(drop=True)

    def flags(self, wrong: Masks = MappingProxyType({})) -> list[list[Coded]]:
        """What is wrong with each impact, by the recordings and by the method."""
        deepest, impacts = self.signal.stop.x, self.dataset.impacts
        thickness = pd.to_numeric(impacts.get(THICKNESS, np.inf), errors="coerce")
        wrong, count = {TOO_DEEP: deepest > np.asarray(thickness, float), **wrong}, len(deepest)
        parts = zip(raised(self.findings, count), self.signal.flags, by_impact(wrong, count), strict=True)
        return [[*spoilt, *computed, *fitted] for spoilt, computed, fitted in parts]

    def _notes(self, noted: Masks) -> list[list[Coded]]:
        """What is only the method's or the recording's way, of each impact."""
        count = len(self.signal.dt)
        spoilt, earlier = (raised(self.findings, count, notes=notes) for notes in (False, True))
        # No quiet part is found where hum or drift stand in it: that is named instead.
        return [
            [*(n for n in a if not {"hum", "drift"} & set(codes_of(named))), *b, *c]
            for a, b, c, named in zip(
                self.signal.notes, earlier, by_impact(noted, count), spoilt, strict=True
            )
        ]


def thesis_table(inspected: Inspected) -> pd.DataFrame:
    """The table of `bayestissue.estimate` by the method "dds".

    Impacts of fewer than eight samples, with uneven times or with clipped samples have a row without numbers:
    an ARMA(2,1) is of a whole displacement at even times.

    Args:
        inspected: with displacements as in the thesis (section 2.2) by the trapezoidal rule.
    """
    dataset, signal, _ = inspected
    rows = (signal.n_samples >= FEWEST_SAMPLES) & ~signal.uneven & ~signal.limited
    # Deviations from the mean of the window (section 2.3).
    inside = signal.inside
    mean = signal.x.sum(axis=1) / np.maximum(signal.n_samples, 1)
    x = np.where(inside, signal.x - mean[:, None], 0.0)
    fit = fit_points(x[rows], signal.n_samples[rows], signal.dt[rows], signal.mass[rows])
    values = {name: in_rows(column, rows) for name, column in fit._asdict().items()}
    K, C, noiseless, all_of_them = values["K"], values["C"], values["noiseless"], np.ones(len(rows), bool)
    with np.errstate(invalid="ignore"):
        failed = {
            NO_OSCILLATOR: np.isfinite(values["phi1"]) & np.isnan(K),
            NOT_POSITIVE: (K <= 0) | (C <= 0),
            AT_A_LIMIT: at_a_limit(values["zeta"]),
        }
        noted = {
            THETA1: values["theta1_at_limit"] & ~noiseless,
            ARCCOS: (values["branch"] > 0) & ~noiseless,
            NOISELESS: noiseless,
            **always_noted(dataset),
            **({} if dataset.recorder is None else {NOT_FILTERED: all_of_them}),
            # Centred deviations have another K and C by their nature.
            ANOTHER_PEAK: another_peak(signal, values["omega_n"], values["zeta"]),
        }
    return inspected.table(values, failed, noted)


def in_rows(column: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A column of some impacts among all, the others without numbers; ``rows`` are truth values."""
    whole = np.zeros(len(rows), bool) if column.dtype == bool else np.full(len(rows), np.nan)
    whole[rows] = column
    return whole


def at_a_limit(zeta: PerImpact) -> np.ndarray:
    """Where one of the two forces rules alone."""
    return (zeta < ZETA_LIMITS[0]) | (zeta > ZETA_LIMITS[1])


def another_peak(signal: Displacements, omega_n: PerImpact, zeta: PerImpact) -> np.ndarray:
    """Where a spring and damper goes another depth than was recorded, which needs all samples."""
    with np.errstate(invalid="ignore", divide="ignore"):
        implied = np.asarray(peak_displacement(omega_n, zeta, signal.velocity, signal.gravity))
        another = np.abs(implied / signal.stop.x - 1) > PEAK_DISAGREES
    return another & ~signal.limited


def always_noted(dataset: Dataset) -> dict[Coded, np.ndarray]:
    """What is noted of impacts whatever the method."""
    count = len(dataset.impacts)
    return {UNUSED: np.full(count, bool(dataset.channels)), PHANTOM: of_phantoms(dataset.impacts)}
