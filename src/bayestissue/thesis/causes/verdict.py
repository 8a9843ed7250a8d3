"""From simulated campaigns and what was observed to tables: one row a cause, and what a page needs."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy import stats
from scipy.spatial import KDTree

from bayestissue.thesis.causes.design import APART, LEVEL, SIZES
from bayestissue.thesis.causes.settings import SETTINGS
from bayestissue.thesis.causes.specification import CausesSpecification

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
    """Which of the causes made ``observed``: posterior probabilities, prior probabilities being equal.

    A classifier that is trained on as many campaigns of every cause as of any other estimates the posterior
    probability of each cause given the statistics (Radev et al. 2021, with neural networks). Networks are
    smooth, so that what was observed is judged by its neighbours also where few of them are; trees would take
    everything beyond their last split for the same. Networks are too sure of themselves: a multinomial
    logistic regression on the logarithms of what they say of campaigns that they have not seen makes
    probabilities of it (Dirichlet calibration; Kull et al. 2019).

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
            _probabilities(
                campaigns[part :: SETTINGS.parts],
                cause[part :: SETTINGS.parts],
                observed,
                number,
                seed + 1 + part,
            )[0]
            for part in range(SETTINGS.parts)
        ]
    score = np.mean(np.log(unseen[np.arange(len(cause)), cause]))
    error = np.hypot(np.std(parts, axis=0, ddof=1) / np.sqrt(SETTINGS.parts), between)
    return Attribution(probability, error, unseen, cause, float(score))


def _probabilities(
    campaigns: Table, cause: Codes, observed: np.ndarray, number: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Calibrated probabilities of the observed campaign and of each simulated one.

    Last the standard error of the first that the networks' disagreement leaves in their mean.
    """
    from sklearn.linear_model import LogisticRegression

    middle, spread = _robust_scale(campaigns, 1.0)
    inside, at = (campaigns - middle) / spread, (observed[None] - middle) / spread
    unseen, said = np.zeros((len(cause), number)), np.zeros((SETTINGS.folds * SETTINGS.networks, number))
    # Neighbours in the table are of different causes, so every fold has all of them.
    fold = np.arange(len(cause)) // number % SETTINGS.folds
    for k in range(SETTINGS.folds * SETTINGS.networks):
        mine = fold == k % SETTINGS.folds
        network = _fitted_network(inside[~mine], cause[~mine], seed * SETTINGS.folds * SETTINGS.networks + k)
        classes = network.classes_
        unseen[np.ix_(mine, classes)] += network.predict_proba(inside[mine]) / SETTINGS.networks
        said[k, classes] = network.predict_proba(at)[0]
    calibration = LogisticRegression(solver="newton-cholesky").fit(
        np.log(unseen + SETTINGS.least_probability), cause
    )
    calibrated = np.zeros((len(cause) + 1, number))
    calibrated[:, calibration.classes_] = calibration.predict_proba(
        np.log(np.vstack([said.mean(axis=0), unseen]) + SETTINGS.least_probability)
    )
    return calibrated[0], calibrated[1:], np.std(said, axis=0, ddof=1) / np.sqrt(len(said))


def _fitted_network(campaigns: Table, cause: Codes, seed: int) -> Any:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPClassifier

    network = MLPClassifier(
        SETTINGS.hidden, activation="tanh", alpha=1e-2, batch_size=256, learning_rate_init=2e-3,
        max_iter=SETTINGS.passes, n_iter_no_change=SETTINGS.passes, random_state=seed % 2**32,
    )  # fmt: skip
    with warnings.catch_warnings():
        # A fixed number of passes is meant, and a batch of all where there are few.
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.filterwarnings("ignore", message="Got `batch_size`")
        return network.fit(campaigns, cause)


def _robust_scale(campaigns: Table, otherwise: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians of the statistics, and their median absolute deviations as a normal's standard deviations."""
    middle = np.median(campaigns, axis=0)
    spread = np.median(np.abs(campaigns - middle), axis=0) / 0.6745
    return middle, np.where(spread > 0, spread, otherwise)


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


CALIBRATION = ("calibration_below_10", "calibration_below_50", "calibration_campaigns", "calibration_p")
_UNTRIED = (np.nan, np.nan, 0, np.nan)


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
        self._middle, self._scale = _robust_scale(campaigns, np.std(campaigns, axis=0) + 1e-9)
        standard = np.clip(self._standard(campaigns), -SETTINGS.farthest, SETTINGS.farthest)
        values, vectors = np.linalg.eigh(np.cov(standard, rowvar=False) + 1e-3 * np.eye(campaigns.shape[1]))
        self._rotation = vectors / np.sqrt(values)

    def __call__(self, campaigns: Table) -> Table:
        """``campaigns`` in these coordinates."""
        return self._standard(campaigns) @ self._rotation

    def _standard(self, campaigns: Table) -> Table:
        return (campaigns - self._middle) / self._scale


class JointCheck:
    """How strange a campaign is among a cause's campaigns, over all statistics at once.

    The strangeness is the mean distance to the nearest `neighbours` campaigns of one half, in whitened
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
        if len(known) <= SETTINGS.fewest_complete:
            raise ValueError(
                f"a joint check needs more than {SETTINGS.fewest_complete} campaigns with all statistics"
            )
        self._whitening = Whitening(known[::2])
        self._tree = KDTree(self._whitening(known[::2]))
        self._others = self._strangeness(known[1::2])

    def _strangeness(self, campaigns: Table) -> Float[np.ndarray, " campaign"]:
        distances, _ = self._tree.query(self._whitening(campaigns), k=SETTINGS.neighbours)
        return distances.mean(axis=1)

    def p_value(self, observed: Float[np.ndarray, " statistic"]) -> float:
        """Share of the cause's campaigns at least as strange as ``observed``, which counts itself."""
        strangeness = self._strangeness(observed[None])[0]
        return float((1 + np.sum(self._others >= strangeness)) / (len(self._others) + 1))

    @property
    def smallest_p(self) -> float:
        """The smallest p-value that so many campaigns can give."""
        return 1 / (len(self._others) + 1)

    def nearest(
        self, campaigns: Table, observed: Float[np.ndarray, " statistic"], share: float
    ) -> Int[np.ndarray, " near"]:
        """Rows of the ``share`` of ``campaigns`` nearest to ``observed``; incomplete ones come last."""
        distance = np.linalg.norm(self._whitening(campaigns) - self._whitening(observed[None]), axis=1)
        return np.argsort(np.where(np.isfinite(distance), distance, np.inf))[
            : max(1, round(share * len(campaigns)))
        ]

    def calibration(self) -> dict[str, float]:
        """How p-values behave on campaigns of the cause itself, where they must be uniform.

        Shares of p-values at most 0.1 and 0.5, of half of the ranked campaigns among the other half; how many
        campaigns were tried; and the p-value of Kolmogorov and Smirnov's test that both halves are alike,
        which is what makes the p-values uniform.
        """
        ranked, tried = np.sort(self._others[::2]), self._others[1::2]
        p = (1 + len(ranked) - np.searchsorted(ranked, tried, side="left")) / (len(ranked) + 1)
        values = (np.mean(p <= 0.1), np.mean(p <= 0.5), len(p), stats.ks_2samp(ranked, tried).pvalue)
        return dict(zip(CALIBRATION, values, strict=True))


# Below the first a cause is said not to have made the numbers, below the second hardly.
REFUTED, DOUBTFUL = 0.01, 0.1
LEVELS = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)


@dataclass(frozen=True)
class Verdict:
    """The tables of a run.

    Attributes:
        causes: one row per cause: p-values, posterior probability, calibration, the strength that comes
            nearest, and words.
        predictive: quantiles of each statistic under each cause.
        observed: the observed value of each statistic, and whether it is part of the joint comparison.
        confusion: mean probability given to each cause by campaigns of each cause.
        reliability: probabilities given against how often they were right, on campaigns not used for them.
        log_score: of the probabilities, and that of guessing.
    """

    causes: pd.DataFrame
    predictive: pd.DataFrame
    observed: pd.DataFrame
    confusion: pd.DataFrame
    reliability: pd.DataFrame
    log_score: tuple[float, float]


def judge(
    campaigns: pd.DataFrame,
    observed: Mapping[str, float],
    specification: CausesSpecification,
    *,
    level_known: bool,
    seed: int,
) -> Verdict:
    """Compare every cause's campaigns with what was observed.

    Args:
        campaigns: one row per campaign, as `run_batch` returns them.
        observed: the statistics of the observed table.
        specification: of the causes, in whose order they are told.
        level_known: whether the size of K/M belongs to the joint comparison.
        seed: of the classifier.
    """
    names = list(specification.causes)
    joint = [name for name in observed if name not in APART and (level_known or name != LEVEL)]
    order = campaigns["cause"].map({name: k for k, name in enumerate(names)})
    # Interleaved, so that any part of the table holds all causes alike.
    campaigns = campaigns.assign(code=order).sort_values(["batch", "campaign", "code"], kind="stable")
    values = _compared(campaigns, joint)
    at = _compared(pd.DataFrame([observed]), joint)[0]
    attribution = attribute(values, campaigns["code"].to_numpy(), at, seed)
    tables = [campaigns[campaigns["cause"] == name] for name in names]
    causes = pd.DataFrame([_row(table, observed, joint, specification) for table in tables])
    causes.insert(4, "probability", attribution.probability)
    causes.insert(5, "probability_error", attribution.error)
    compared = ["yes" if name in joint else "no" for name in observed]
    mean_probability = pd.DataFrame(confusion(attribution), columns=names)
    mean_probability.insert(0, "truth", names)
    return Verdict(
        causes=causes,
        predictive=_predictive(campaigns, names, list(observed)),
        observed=pd.DataFrame(
            {"statistic": list(observed), "value": list(observed.values()), "compared": compared}
        ),
        confusion=mean_probability,
        reliability=pd.DataFrame(reliability(attribution), columns=["probability", "right", "cases"]),
        log_score=(attribution.log_score, -float(np.log(len(names)))),
    )


def _compared(campaigns: pd.DataFrame, joint: Sequence[str]) -> np.ndarray:
    """The statistics ``joint``: positive sizes on a logarithmic scale, and NaN for what has no number."""
    values, is_size = campaigns[list(joint)].to_numpy(float), np.array([name in SIZES for name in joint])
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(is_size, np.log(np.where(is_size, values, 1.0)), values)
    return np.where(np.isfinite(values), values, np.nan)


def _row(
    campaigns: pd.DataFrame,
    observed: Mapping[str, float],
    joint: Sequence[str],
    specification: CausesSpecification,
) -> dict[str, object]:
    """What the campaigns of one cause say of it."""
    name = campaigns["cause"].iloc[0]
    values, at = _compared(campaigns, joint), _compared(pd.DataFrame([observed]), joint)[0]
    complete = int(np.isfinite(values).all(axis=1).sum())
    single = {
        f"p_{statistic}": two_sided(campaigns[statistic].to_numpy(float), observed[statistic])
        for statistic in observed
        if statistic not in APART
    }
    failing = [s for p, s in sorted((single[f"p_{s}"], s) for s in joint) if p < REFUTED]
    if complete > SETTINGS.fewest_complete:
        check = JointCheck(values)
        p, smallest, calibration = check.p_value(at), check.smallest_p, check.calibration()
        nearest = _nearest(campaigns, check.nearest(values, at, SETTINGS.nearest))
    else:
        # What was observed is complete, which this cause's campaigns are this seldom.
        p, smallest = (1 + complete) / (1 + len(values)), 1 / (1 + len(values))
        calibration, nearest, failing = dict(zip(CALIBRATION, _UNTRIED, strict=True)), "", list(APART)
    return {
        "cause": name,
        "title": specification.causes[name].words,
        "campaigns": len(campaigns),
        "complete": complete / len(values),
        "p_joint": p,
        "smallest_p": smallest,
        **single,
        **calibration,
        "nearest": nearest,
        "fails": ", ".join(failing),
        "verdict": "refuted" if p < REFUTED else "doubtful" if p < DOUBTFUL else "possible",
    }


def _nearest(campaigns: pd.DataFrame, near: np.ndarray) -> str:
    """Strengths of the campaigns nearest to what was observed: median and range, in words."""
    strengths = campaigns.filter(like="strength_").dropna(axis=1, how="all").iloc[near]
    return "; ".join(
        f"{str(name).removeprefix('strength_')} {values.median():.2g} "
        f"({values.min():.2g} to {values.max():.2g})"
        for name, values in strengths.items()
    )


def _predictive(campaigns: pd.DataFrame, names: Sequence[str], statistics: Sequence[str]) -> pd.DataFrame:
    points = [f"q{100 * level:02.0f}" for level in LEVELS]
    rows = []
    for name in names:
        simulated = campaigns[campaigns["cause"] == name]
        rows += [(name, statistic, *simulated[statistic].quantile(list(LEVELS))) for statistic in statistics]
    return pd.DataFrame(rows, columns=["cause", "statistic", *points])
