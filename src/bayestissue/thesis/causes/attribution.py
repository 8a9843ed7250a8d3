"""Which of the proposed causes made a campaign: posterior probabilities from simulated campaigns alone.

A classifier that is trained on as many campaigns of every cause as of any other estimates the posterior
probability of each cause given the statistics, at equal prior probabilities (Radev et al. 2021, with neural
networks). Networks are smooth, so that what was observed is judged by its neighbours also where few of them
are; trees would take everything beyond their last split for the same. Networks are too sure of themselves: a
multinomial logistic regression on the logarithms of what they say of campaigns that they have not seen makes
probabilities of it (Dirichlet calibration; Kull et al. 2019).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

FOLDS = 5
# Networks of one fold; each has its own start, which matters where few campaigns are.
_NETWORKS = 3
# Parts of the campaigns on which the probabilities are found anew, to see how much they depend on the draw.
PARTS = 5
_HIDDEN = (64, 64)
_PASSES = 60
# No finite number of campaigns tells a probability from 0.
_LEAST = 1e-4

type Table = Float[np.ndarray, "campaign statistic"]
type Codes = Int[np.ndarray, " campaign"]


@dataclass(frozen=True)
class Attribution:
    """What the classifier says.

    Attributes:
        probability: [cause], of the observed campaign.
        error: [cause], Monte Carlo standard error of that.
        unseen: [campaign, cause], probabilities of simulated campaigns by networks that have not seen them.
        cause: [campaign], who made these.
        log_score: mean log probability of the true cause; that of guessing is -log(causes).
    """

    probability: Float[np.ndarray, " cause"]
    error: Float[np.ndarray, " cause"]
    unseen: Float[np.ndarray, "campaign cause"]
    cause: Codes
    log_score: float


def attribute(
    campaigns: Table, cause: Codes, observed: Float[np.ndarray, " statistic"], seed: int
) -> Attribution:
    """Posterior probabilities of the causes for ``observed``, prior probabilities being equal.

    Campaigns without all statistics are left out, as the observed one has them all: a cause of which few
    are left has the less of the probability.

    Args:
        campaigns: [campaign, statistic], the causes interleaved; NaN where a campaign lacks a statistic.
        cause: [campaign], numbers from 0.
        observed: [statistic].
        seed: of the networks.
    """
    from threadpoolctl import threadpool_limits

    known = np.isfinite(campaigns).all(axis=1)
    number = int(cause.max()) + 1
    campaigns, cause = campaigns[known], cause[known]
    # One thread adds in one order, whatever the machine has.
    with threadpool_limits(1):
        probability, unseen, between = _probabilities(campaigns, cause, observed, number, seed)
        parts = [
            _probabilities(campaigns[part::PARTS], cause[part::PARTS], observed, number, seed + 1 + part)[0]
            for part in range(PARTS)
        ]
    score = np.mean(np.log(unseen[np.arange(len(cause)), cause]))
    error = np.hypot(np.std(parts, axis=0, ddof=1) / np.sqrt(PARTS), between)
    return Attribution(probability, error, unseen, cause, float(score))


def _probabilities(
    campaigns: Table, cause: Codes, observed: np.ndarray, number: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Calibrated probabilities of the observed campaign and of each simulated one.

    Last the standard error of the first that the networks' disagreement leaves in their mean.
    """
    from sklearn.linear_model import LogisticRegression

    middle = np.median(campaigns, axis=0)
    spread = np.median(np.abs(campaigns - middle), axis=0) / 0.6745
    spread = np.where(spread > 0, spread, 1.0)
    inside, at = (campaigns - middle) / spread, (observed[None] - middle) / spread
    unseen, said = np.zeros((len(cause), number)), np.zeros((FOLDS * _NETWORKS, number))
    # Neighbours in the table are of different causes, so every fold has all of them.
    fold = np.arange(len(cause)) // number % FOLDS
    for k in range(FOLDS * _NETWORKS):
        mine = fold == k % FOLDS
        network = _network(seed * FOLDS * _NETWORKS + k)
        _fit(network, inside[~mine], cause[~mine])
        classes = network.classes_
        unseen[np.ix_(mine, classes)] += network.predict_proba(inside[mine]) / _NETWORKS
        said[k, classes] = network.predict_proba(at)[0]
    calibration = LogisticRegression(solver="newton-cholesky").fit(np.log(unseen + _LEAST), cause)
    calibrated = np.zeros((len(cause) + 1, number))
    calibrated[:, calibration.classes_] = calibration.predict_proba(
        np.log(np.vstack([said.mean(axis=0), unseen]) + _LEAST)
    )
    return calibrated[0], calibrated[1:], np.std(said, axis=0, ddof=1) / np.sqrt(len(said))


def _network(seed: int) -> Any:
    from sklearn.neural_network import MLPClassifier

    return MLPClassifier(
        _HIDDEN, activation="tanh", alpha=1e-2, batch_size=256, learning_rate_init=2e-3,
        max_iter=_PASSES, n_iter_no_change=_PASSES, random_state=seed % 2**32,
    )  # fmt: skip


def _fit(network: Any, campaigns: Table, cause: Codes) -> None:
    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        # A fixed number of passes is meant, and a batch of all where there are few.
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.filterwarnings("ignore", message="Got `batch_size`")
        network.fit(campaigns, cause)


def confusion(attribution: Attribution) -> Float[np.ndarray, "truth told"]:
    """Mean probability given to each cause (columns) by campaigns of each true cause (rows)."""
    number = attribution.unseen.shape[1]
    member = (attribution.cause[:, None] == np.arange(number)).astype(float)
    return member.T @ attribution.unseen / np.maximum(member.sum(axis=0), 1)[:, None]


def reliability(attribution: Attribution, bins: int = 10) -> Float[np.ndarray, "bin 3"]:
    """Mean probability, share that was right, and number of cases, in the bins of probability that occur."""
    probability = attribution.unseen.ravel()
    right = (attribution.cause[:, None] == np.arange(attribution.unseen.shape[1])).ravel()
    index = np.minimum((probability * bins).astype(int), bins - 1)
    count = np.bincount(index, minlength=bins)
    used = count > 0
    means = [np.bincount(index, weights=w, minlength=bins)[used] / count[used] for w in (probability, right)]
    return np.column_stack([*means, count[used]])
