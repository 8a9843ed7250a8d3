"""The one factor by which all recorded masses are wrong, as springs and phantoms of known stiffness have it.

A recording tells K over the mass. With declared masses M and true ones f M an impact of a phantom has the
estimate K_i = K_r / f but for its errors, so that

    log K_r - log K_i = log f + r + c + e_i,    log f ~ N(0, s^2),

with s the declared relative error of the mass, r ~ N(0, (sd_r / K_r)^2) the error of the stated stiffness,
one of all impacts of a phantom, c ~ N(0, v_c) what the error of the gain makes of K, one of all, since
one recorder has one gain, and e_i ~ N(0, v_i + t^2) the rest, t being what phantoms scatter beyond v_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from bayestissue.base.impact_arrays import IndexPerImpact, PerImpact

# Standard deviations of a normal distribution from the middle of its 90 % interval to either end.
HALF_WIDTH = float(norm.ppf(0.95))


@dataclass(frozen=True)
class Reference:
    """What phantoms say of the masses: log f is N(log_mean, log_sd^2).

    Attributes:
        log_mean: posterior mean of log f.
        log_sd: its posterior standard deviation.
        mass_sd: of log f, as declared.
        by_phantoms: log f by the phantoms alone, with its standard deviation.
        table: a row an impact: ``impact``, K at the recorded mass with its 90 % interval, the known stiffness
            and its standard deviation.
    """

    log_mean: float
    log_sd: float
    mass_sd: float
    by_phantoms: tuple[float, float]
    table: pd.DataFrame


def mass_factor(
    log_ratio: PerImpact, variance: PerImpact, common: float, reference_sd: PerImpact, phantom: IndexPerImpact
) -> tuple[float, float]:
    """Log f by generalised least squares, and its standard deviation, the declared error of mass left out.

    Args:
        log_ratio: log K_r - log K_i.
        variance: v_i.
        common: v_c.
        reference_sd: sd_r / K_r.
        phantom: which one was hit.
    """
    beyond = scatter(log_ratio, variance, phantom)
    same = phantom[:, None] == phantom
    covariance = np.diag(variance + beyond) + common + same * np.outer(reference_sd, reference_sd)
    weights = np.linalg.solve(covariance, np.ones(len(log_ratio)))
    return float(weights @ log_ratio / weights.sum()), float(weights.sum() ** -0.5)


def scatter(log_ratio: PerImpact, variance: PerImpact, phantom: IndexPerImpact) -> float:
    """t^2, by the moments of DerSimonian and Laird (1986), within phantoms; 0 where none was hit twice."""
    weight = 1 / variance
    sums = np.bincount(phantom, weight)
    mean = np.bincount(phantom, weight * log_ratio) / sums
    freedom = len(log_ratio) - (sums > 0).sum()
    if freedom == 0:
        return 0.0
    excess = weight @ (log_ratio - mean[phantom]) ** 2 - freedom
    return float(max(0.0, excess / (weight.sum() - (np.bincount(phantom, weight**2) / sums).sum())))


def with_declared(by_phantoms: tuple[float, float], mass_sd: float, table: pd.DataFrame) -> Reference:
    """Posterior of log f: what phantoms say of it times its prior N(0, mass_sd^2)."""
    mean, sd = by_phantoms
    precision = sd**-2 + mass_sd**-2
    return Reference(mean * sd**-2 / precision, precision**-0.5, mass_sd, by_phantoms, table)
