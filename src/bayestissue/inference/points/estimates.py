"""Point estimates as a table: from a dataset over its displacements to `estimates.csv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from bayestissue.dataset.impacts import of_phantoms
from bayestissue.errors import Coded
from bayestissue.inference.points.fit import Column, Method, PointFit, fit_points
from bayestissue.inference.points.notes import (
    ANOTHER_PEAK,
    ARCCOS,
    AT_A_LIMIT,
    NO_ANSWER,
    NO_OSCILLATOR,
    NOISELESS,
    NOT_FILTERED,
    NOT_POSITIVE,
    NOT_WHITE,
    PHANTOM,
    STRUCTURED,
    THETA1,
    UNUSED,
)
from bayestissue.oscillator import peak_displacement
from bayestissue.signal import Displacements, SignalOptions
from bayestissue.signal.displacement import FEWEST_SAMPLES
from bayestissue.signal.quality import Finding, raised
from bayestissue.signal.quality.inspection import KINDS

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset

# Past these a trace of one loading tells K and C apart no more: one of the two forces rules alone.
ZETA_LIMITS = (0.005, 5.0)
WHITE_BY_CHANCE = 0.01
# A flag may be raised on one sound recording of a thousand, as in `bayestissue.signal.quality.inspect`.
STRUCTURED_BY_CHANCE = 0.001
# The displacement that K and C imply and the one recorded differ by a few per cent at worst if both hold.
PEAK_DISAGREES = 0.2
THICKNESS = "tissue_thickness_m"


def default_options(method: Method) -> SignalOptions:
    """How x is made unless told otherwise; "dds" integrates and centres as the thesis did."""
    if method == "dds":
        return SignalOptions(integration="trapezoidal", equilibrium="sample-mean")
    return SignalOptions()


def estimates_table(
    dataset: Dataset, signal: Displacements, method: Method, findings: Sequence[Finding] = ()
) -> pd.DataFrame:
    """The table of `bayestissue.estimate` by a fit of displacements that are at hand.

    Impacts of fewer than eight samples, with uneven times or with clipped samples have a row without numbers:
    an ARMA(2,1) is of a whole displacement at even times.

    Args:
        dataset: the recordings.
        signal: what was made of them.
        method: "exact" or "dds".
        findings: what `bayestissue.signal.quality.inspect` found; flagged.
    """
    long_enough = (signal.n_samples >= FEWEST_SAMPLES) & ~signal.uneven & ~signal.clipped.any(axis=1)
    fit = fit_points(
        signal.x[long_enough],
        signal.n_samples[long_enough],
        signal.dt[long_enough],
        signal.mass[long_enough],
        method,
        gravity=signal.gravity[long_enough],
    )
    whole = PointFit(*(in_rows(column, long_enough) for column in fit))
    mass_sd = dataset.uncertainty.relative_mass_sd
    # Where no oscillator has the coefficients C may be infinite.
    with np.errstate(invalid="ignore"):
        K_se = np.hypot(whole.K_se, whole.K_signed * mass_sd)
        C_se = np.hypot(whole.C_se, whole.C_signed * mass_sd)
    # An impact without an estimate has no interval either.
    has = np.isfinite(whole.K)
    ends = {
        "K": interval(np.where(has, whole.K_signed, np.nan), K_se, signal.n_samples),
        "C": interval(np.where(has, whole.C_signed, np.nan), C_se, signal.n_samples),
    }
    flags, notes = flagged(dataset, signal, whole, findings, method)
    return table_of(dataset, signal, whole._replace(K_se=K_se, C_se=C_se), ends, flags, notes)


def in_rows(column: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A column of some impacts among all, the others without numbers; ``rows`` are truth values."""
    whole = np.zeros(len(rows), bool) if column.dtype == bool else np.full(len(rows), np.nan)
    whole[rows] = column
    return whole


def table_of(
    dataset: Dataset,
    signal: Displacements,
    whole: PointFit,
    ends: Mapping[str, tuple[Column, Column]],
    flags: Sequence[Sequence[str]],
    notes: Sequence[Sequence[str]],
) -> pd.DataFrame:
    """The columns of `estimates.csv`.

    Args:
        dataset: the recordings.
        signal: what was made of them.
        whole: what was found, by whichever method.
        ends: of the intervals of "K" and "C".
        flags: of each impact.
        notes: of each impact.
    """
    table = dataset.impacts[["impact", "subject", "trial", "mass_kg"]].assign(
        velocity_m_s=signal.velocity,
        n_samples=signal.n_samples,
        sampling_interval_s=signal.dt,
        phi1=whole.phi1,
        phi2=whole.phi2,
        theta1=whole.theta1,
        sigma_a=whole.sigma_a,
        omega_n_rad_s=whole.omega_n,
        zeta=whole.zeta,
        K_N_per_m=whole.K,
        C_N_s_per_m=whole.C,
        peak_displacement_m=signal.peak_displacement,
        time_to_peak_s=signal.time_to_peak,
        flags=["; ".join(row) for row in flags],
        K_se_N_per_m=whole.K_se,
        K_low_N_per_m=ends["K"][0],
        K_high_N_per_m=ends["K"][1],
        C_se_N_s_per_m=whole.C_se,
        C_low_N_s_per_m=ends["C"][0],
        C_high_N_s_per_m=ends["C"][1],
        omega_n_se_rad_s=whole.omega_n_se,
        zeta_se=whole.zeta_se,
        theta1_se=whole.theta1_se,
        log_likelihood=whole.log_likelihood,
        whiteness_p=whole.whiteness_p,
        notes=["; ".join(row) for row in notes],
    )
    return table.reset_index(drop=True)


def interval(estimate: Column, error: Column, n_samples: np.ndarray) -> tuple[Column, Column]:
    """The interval that should hold the truth with a probability of 90 %, by Student's t with n - 5 degrees.

    K and C are all but linear in phi1 and phi2, in which the residuals are exactly linear: so the interval
    is laid symmetrically around the estimate, also one below zero, and what lies below zero is cut off. Where
    nothing is left above zero there is no interval.

    Args:
        estimate: `PointFit.K_signed` or `PointFit.C_signed`.
        error: its standard error.
        n_samples: samples of each impact; two of them are given, and phi1, phi2 and theta1 are fitted.

    Returns:
        Lower and upper end, NaN where there is no interval or no standard error.
    """
    reach = stdtrit(np.maximum(n_samples - 5, 1), 0.95) * error
    high = np.where(estimate + reach > 0, estimate + reach, np.nan)
    return np.where(np.isfinite(high), np.maximum(estimate - reach, 0), np.nan), high


def flagged(
    dataset: Dataset,
    signal: Displacements,
    fit: PointFit,
    findings: Sequence[Finding],
    method: Method | Literal["impact"],
) -> tuple[list[list[Coded]], list[list[Coded]]]:
    """What is wrong with each impact, and what is only the method's or the recording's way."""
    with np.errstate(invalid="ignore", divide="ignore"):
        implied = np.asarray(peak_displacement(fit.omega_n, fit.zeta, signal.velocity, signal.gravity))
        another_peak = np.abs(implied / signal.peak_displacement - 1) > PEAK_DISAGREES
        # What is integrated from behind a low-pass has contact, and so its peak, elsewhere.
        another_peak &= method != "impact" or dataset.recorder is None
        # How deep an impact went is not recorded beyond the sensor's limit.
        another_peak &= ~signal.clipped.any(axis=1)
        failed = {
            NO_OSCILLATOR: np.isfinite(fit.phi1) & np.isnan(fit.K),
            NOT_POSITIVE: (fit.K <= 0) | (fit.C <= 0),
            AT_A_LIMIT: (fit.zeta < ZETA_LIMITS[0]) | (fit.zeta > ZETA_LIMITS[1]),
        }
        wrong = {Coded("deeper than the tissue is thick", "too-deep"): _too_deep(dataset, signal)}
        noted = {
            THETA1: fit.theta1_at_limit & ~fit.noiseless,
            ARCCOS: (fit.branch > 0) & ~fit.noiseless,
            NOISELESS: fit.noiseless,
            UNUSED: np.full(len(fit.K), bool(dataset.channels)),
            PHANTOM: of_phantoms(dataset.impacts),
        }
        if method == "impact":
            wrong[STRUCTURED] = (fit.whiteness_p < STRUCTURED_BY_CHANCE) & ~fit.noiseless
        else:
            if dataset.recorder is not None:
                noted[NOT_FILTERED] = np.ones(len(fit.K), bool)
            noted[NOT_WHITE] = fit.whiteness_p < WHITE_BY_CHANCE
    # Centred deviations have another K and C by their nature.
    (noted if method == "dds" else failed)[ANOTHER_PEAK] = another_peak
    if dataset.quantity == "displacement":
        # It happens to a third of sound ones: the method's way with a position sensor's noise.
        noted[NO_ANSWER] = np.any(list(failed.values()), axis=0)
    else:
        wrong |= failed
    spoilt = raised(findings, len(another_peak))
    flags = [[*a, *b, *c] for a, b, c in zip(spoilt, signal.flags, _by_row(wrong), strict=True)]
    # No quiet part is found where hum or drift stand in it: that is named instead.
    earlier = raised(findings, len(another_peak), notes=True)
    notes = [
        [*(n for n in a if not {KINDS["hum"].flag, KINDS["drift"].flag} & set(named)), *b, *c]
        for a, b, c, named in zip(signal.notes, earlier, _by_row(noted), spoilt, strict=True)
    ]
    return flags, notes


def _by_row(words: Mapping[Coded, np.ndarray]) -> list[list[Coded]]:
    rows = zip(*(column.astype(bool).tolist() for column in words.values()), strict=True)
    return [[text for text, up in zip(words, row, strict=True) if up] for row in rows]


def _too_deep(dataset: Dataset, signal: Displacements) -> np.ndarray:
    if THICKNESS not in dataset.impacts:
        return np.zeros(len(signal.n_samples), bool)
    thickness = pd.to_numeric(dataset.impacts[THICKNESS], errors="coerce").to_numpy(float)
    return signal.peak_displacement > thickness
