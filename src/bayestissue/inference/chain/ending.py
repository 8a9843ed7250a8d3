"""When a run of the chain is done: a rule that perfect draws pass in 99 of 100 runs.

R-hat below 1.01 for a thousand quantities is failed by independent draws: of R̂² = (n − 1 + B / W) / n the
ratio B / W is an F variable where nothing is wrong, and the greatest of many grows with their number. The
limit here is 1.01 or what independent draws of the same length exceed in one run of a hundred, whichever is
greater; see Vehtari et al. (2021, doi:10.1214/20-BA1221) for the statistics themselves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import f as fisher

from bayestissue.inference.samplers.sampling import (
    R_HAT_LIMIT,
    ROUGH,
    Convergence,
    Draws,
    convergence,
    let_pass,
)

# That a run of independent draws fails, all of its quantities together.
FALSE_ALARMS = 0.01
# What follows from the draws, such as a damping ratio, is judged when they are whole: they end with some
# margin, in R-hat where perfect draws allow it, and in effective numbers.
NEARER, _MORE = 1.008, 1.2


def r_hat_limit(quantities: int, chains: int, draws: int, *, least: float = R_HAT_LIMIT) -> float:
    """What the greatest rank-normalised split R-hat of so many quantities is to be below.

    Of each there are two, of the draws and of their distance from the median, and of each chain two halves.
    """
    halves, length = 2 * chains, max(draws // 2, 2)
    alone = FALSE_ALARMS / (2 * max(quantities, 1))
    ratio = float(fisher.isf(alone, halves - 1, halves * (length - 1)))
    return max(least, float(np.sqrt((length - 1 + ratio) / length)))


class LookVerdict(NamedTuple):
    """What one look at the draws says.

    Attributes:
        passed: whether they are enough.
        r_hat: the greatest of hyperparameters and effects.
        effective: the least effective number of these, in bulk or tails.
        slowest: the number of the quantity that has the greater shortage, among hyperparameters and effects,
            or behind them the impacts.
        limit: of R-hat.
    """

    passed: bool
    r_hat: float
    effective: float
    slowest: int
    limit: float


def look(population: Draws, impacts: Draws, effective: float) -> LookVerdict:
    """Whether draws are enough: of the population. An impact's own end no run, see `let_pass`.

    Args:
        population: hyperparameters and effects, [quantity, chain, draw].
        impacts: the same of the impacts' own parameters, of as many draws or fewer.
        effective: the least effective number of the population that is wanted, in bulk and tails.
    """
    of_population, of_impacts = convergence(population), convergence(impacts)
    # Of many impacts some draws are kept: as many fewer are asked for.
    share = impacts.shape[2] / population.shape[2]
    quantities = len(population) + len(impacts)
    limit = r_hat_limit(quantities, *population.shape[1:], least=NEARER)
    of_draws = r_hat_limit(quantities, *impacts.shape[1:], least=ROUGH)
    agree = (of_population.r_hat < limit).all() and let_pass(of_impacts.r_hat, of_draws).all()
    least = np.concatenate([_least(of_population), _least(of_impacts) / share])
    of_all = least[: len(population)].min()
    return LookVerdict(
        bool(agree and of_all > _MORE * effective),
        float(of_population.r_hat.max()),
        float(of_all),
        int(least.argmin()),
        limit,
    )


def _least(sizes: Convergence) -> np.ndarray:
    return np.minimum(sizes.ess_bulk, sizes.ess_tail)
