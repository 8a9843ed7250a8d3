"""Whether a cause could have made what was observed: predictive p-values, and their calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import stats
from scipy.spatial import KDTree

NEIGHBOURS = 10
FEWEST = 2 * NEIGHBOURS
_CLIP = 6.0

type Table = Float[np.ndarray, "campaign statistic"]


@dataclass(frozen=True)
class Calibration:
    """How p-values behave on campaigns of the cause itself, where they must be uniform.

    Attributes:
        below_10, below_50: share of p-values at most 0.1 and 0.5.
        campaigns: how many were tried.
        uniform_p: p-value of Kolmogorov and Smirnov's test that both halves are alike, which is what makes
            the p-values uniform.
    """

    below_10: float
    below_50: float
    campaigns: int
    uniform_p: float


def two_sided(simulated: Float[np.ndarray, " campaign"], observed: float) -> float:
    """2 min(P(s <= o), P(s >= o)) with the observed counted among the simulated; never 0.

    Campaigns without the statistic are left out: what was observed has it.
    """
    known = simulated[np.isfinite(simulated)]
    beyond = min(np.sum(known <= observed), np.sum(known >= observed))
    return float(min(1.0, 2 * (1 + beyond) / (len(known) + 1)))


class Whitening:
    """Coordinates in which the statistics of one cause's campaigns are uncorrelated and of one size.

    Medians and median absolute deviations set the scale, so that campaigns far out do not hide the rest.
    """

    def __init__(self, campaigns: Table) -> None:
        self._middle = np.median(campaigns, axis=0)
        spread = np.median(np.abs(campaigns - self._middle), axis=0) / 0.6745
        self._scale = np.where(spread > 0, spread, np.std(campaigns, axis=0) + 1e-9)
        standard = np.clip(self._standard(campaigns), -_CLIP, _CLIP)
        values, vectors = np.linalg.eigh(np.cov(standard, rowvar=False) + 1e-3 * np.eye(campaigns.shape[1]))
        self._rotation = vectors / np.sqrt(values)

    def __call__(self, campaigns: Table) -> Table:
        """``campaigns`` in these coordinates."""
        return self._standard(campaigns) @ self._rotation

    def _standard(self, campaigns: Table) -> Table:
        return (campaigns - self._middle) / self._scale


class JointCheck:
    """How strange a campaign is among a cause's campaigns, over all statistics at once.

    The strangeness is the mean distance to the nearest `NEIGHBOURS` campaigns of one half, in whitened
    coordinates; its p-value is the rank among the campaigns of the other half. Since an observed campaign
    of the cause is exchangeable with these, the p-value is uniform under it whatever the distances are
    (conformal prediction; Vovk, Gammerman & Shafer 2005).

    Args:
        campaigns: [campaign, statistic] of one cause, in random order; those without all statistics are left
            out, since what was observed has them all.

    Raises:
        ValueError: too few campaigns have all statistics.
    """

    def __init__(self, campaigns: Table) -> None:
        known = campaigns[np.isfinite(campaigns).all(axis=1)]
        if len(known) <= FEWEST:
            raise ValueError(f"a joint check needs more than {FEWEST} campaigns with all statistics")
        self._whitening = Whitening(known[::2])
        self._tree = KDTree(self._whitening(known[::2]))
        self._others = self._strangeness(known[1::2])

    def _strangeness(self, campaigns: Table) -> Float[np.ndarray, " campaign"]:
        distances, _ = self._tree.query(self._whitening(campaigns), k=NEIGHBOURS)
        return distances.mean(axis=1)

    def p_value(self, observed: Float[np.ndarray, " statistic"]) -> float:
        """Share of the cause's campaigns at least as strange as ``observed``, which counts itself."""
        own = self._strangeness(observed[None])[0]
        return float((1 + np.sum(self._others >= own)) / (len(self._others) + 1))

    @property
    def smallest_p(self) -> float:
        """The smallest p-value that so many campaigns can give."""
        return 1 / (len(self._others) + 1)

    def nearest(
        self, campaigns: Table, observed: Float[np.ndarray, " statistic"], share: float
    ) -> Int[np.ndarray, " near"]:
        """Rows of the ``share`` of ``campaigns`` nearest to ``observed``; incomplete ones come last."""
        away = np.linalg.norm(self._whitening(campaigns) - self._whitening(observed[None]), axis=1)
        return np.argsort(np.where(np.isfinite(away), away, np.inf))[: max(1, round(share * len(campaigns)))]

    def calibration(self) -> Calibration:
        """p-values of half of the ranked campaigns among the other half."""
        ranked, tried = np.sort(self._others[::2]), self._others[1::2]
        p = (1 + len(ranked) - np.searchsorted(ranked, tried, side="left")) / (len(ranked) + 1)
        same = stats.ks_2samp(ranked, tried).pvalue
        return Calibration(float(np.mean(p <= 0.1)), float(np.mean(p <= 0.5)), len(p), float(same))
