"""Which of the proposed causes made a campaign: posterior probabilities from simulated campaigns alone.

A classifier that is trained on as many campaigns of every cause as of any other estimates the posterior
probability of each cause given the statistics, at equal prior probabilities (Pudlo et al. 2016, for random
forests). Votes of trees are no probabilities: a multinomial logistic regression on their logarithms, fitted
to campaigns that the trees have not seen, makes them so (Dirichlet calibration; Kull et al. 2019).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

TREES = 200
LEAF = 3
# Parts of the campaigns on which the probabilities are found anew, to see how much they depend on the draw.
PARTS = 5

type Table = Float[np.ndarray, "campaign statistic"]
type Codes = Int[np.ndarray, " campaign"]


@dataclass(frozen=True)
class Attribution:
    """What the classifier says.

    Attributes:
        probability: [cause], of the observed campaign.
        error: [cause], Monte Carlo standard error of that.
        unseen: [campaign, cause], probabilities of the simulated campaigns by trees that have not seen them.
        log_score: mean log probability of the true cause; that of guessing is -log(causes).
    """

    probability: Float[np.ndarray, " cause"]
    error: Float[np.ndarray, " cause"]
    unseen: Float[np.ndarray, "campaign cause"]
    log_score: float


def attribute(
    campaigns: Table, cause: Codes, observed: Float[np.ndarray, " statistic"], seed: int, jobs: int = 1
) -> Attribution:
    """Posterior probabilities of the causes for ``observed``, prior probabilities being equal.

    Args:
        campaigns: [campaign, statistic]; NaN where a campaign lacks a statistic.
        cause: [campaign], numbers from 0.
        observed: [statistic].
        seed: of the trees.
        jobs: trees grown at a time; the numbers do not depend on it.
    """
    probability, unseen = _probabilities(campaigns, cause, observed, seed, jobs)
    parts = [
        _probabilities(campaigns[part::PARTS], cause[part::PARTS], observed, seed + 1 + part, jobs)[0]
        for part in range(PARTS)
    ]
    score = np.mean(np.log(unseen[np.arange(len(cause)), cause]))
    return Attribution(
        probability=probability,
        error=np.std(parts, axis=0, ddof=1) / np.sqrt(PARTS),
        unseen=unseen,
        log_score=float(score),
    )


def _probabilities(
    campaigns: Table, cause: Codes, observed: np.ndarray, seed: int, jobs: int
) -> tuple[np.ndarray, np.ndarray]:
    """Calibrated votes for the observed campaign, and for each simulated one."""
    from sklearn.linear_model import LogisticRegression

    whole, unseen = _votes(campaigns, cause, observed, seed, jobs)
    calibration = LogisticRegression(solver="newton-cholesky").fit(_logarithms(unseen), cause)
    return calibration.predict_proba(_logarithms(whole[None]))[0], calibration.predict_proba(
        _logarithms(unseen)
    )


def _logarithms(votes: np.ndarray) -> np.ndarray:
    """Of the votes and half a tree for every cause: no vote is no proof."""
    return np.log(votes + 0.5 / TREES)


def _votes(
    campaigns: Table, cause: Codes, observed: np.ndarray, seed: int, jobs: int
) -> tuple[np.ndarray, np.ndarray]:
    """Votes for the observed campaign, and for each campaign those of the trees grown without it."""
    from sklearn.ensemble import RandomForestClassifier

    forest = RandomForestClassifier(
        TREES, min_samples_leaf=LEAF, max_samples=0.6, oob_score=True, random_state=seed, n_jobs=jobs
    )
    forest.fit(campaigns, cause)
    return forest.predict_proba(observed[None])[0], np.nan_to_num(forest.oob_decision_function_)


def confusion(attribution: Attribution, cause: Codes) -> Float[np.ndarray, "truth told"]:
    """Mean probability given to each cause (columns) by campaigns of each true cause (rows)."""
    number = attribution.unseen.shape[1]
    return np.stack([attribution.unseen[cause == k].mean(axis=0) for k in range(number)])


def reliability(attribution: Attribution, cause: Codes, bins: int = 10) -> Float[np.ndarray, "bin 3"]:
    """Mean probability, share that was right, and number of cases, in the bins of probability that occur."""
    probability = attribution.unseen.ravel()
    right = (cause[:, None] == np.arange(attribution.unseen.shape[1])).ravel()
    index = np.minimum((probability * bins).astype(int), bins - 1)
    count = np.bincount(index, minlength=bins)
    kept = count > 0
    means = [np.bincount(index, weights=w, minlength=bins)[kept] / count[kept] for w in (probability, right)]
    return np.column_stack([*means, count[kept]])
