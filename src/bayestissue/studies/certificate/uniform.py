"""Whether ranks are uniform, by the farthest point of their empirical distribution.

The distance at a place is the binomial tail of the count of ranks below it; that of the whole curve is the
smallest of these, whose distribution is simulated (Säilynoja, Bürkner and Vehtari 2022,
doi:10.1007/s11222-022-10090-6).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float, Int
from scipy.special import bdtr
from scipy.stats import binom

# A rank is among so many draws: one of a hundred places.
DRAWS = 99
_SIMULATED = 20_000


def p_of_uniform(ranks: Int[np.ndarray, " refit"]) -> float:
    """How often uniform ranks have an empirical distribution as far from the diagonal as these."""
    simulated = _smallest_tails(len(ranks))
    return float((1 + (simulated <= _smallest_tail(ranks[None])[0]).sum()) / (1 + len(simulated)))


def half_band(refits: int) -> float:
    """How far the share of ranks in the lower half may be off 0.5, within an envelope of 95 % of curves."""
    end = np.quantile(_smallest_tails(refits), 0.05)
    return 0.5 - float(binom.ppf(end, refits, 0.5)) / refits


@cache
def _smallest_tails(refits: int) -> Float[np.ndarray, " simulated"]:
    rng = np.random.default_rng(refits)
    return _smallest_tail(rng.integers(0, DRAWS + 1, (_SIMULATED, refits)))


def _smallest_tail(ranks: Int[np.ndarray, "sample refit"]) -> Float[np.ndarray, " sample"]:
    """The smallest binomial tail of the counts up to each rank."""
    count, places = ranks.shape[1], np.arange(1, DRAWS + 1) / (DRAWS + 1)
    samples = np.repeat(np.arange(len(ranks)), count)
    by_rank = np.zeros((len(ranks), DRAWS + 1))
    np.add.at(by_rank, (samples, ranks.ravel()), 1)
    below = by_rank.cumsum(axis=1)[:, :-1]
    lower, upper = bdtr(below, count, places), 1 - np.where(below > 0, bdtr(below - 1, count, places), 0.0)
    return np.minimum(lower, upper).min(axis=1)
