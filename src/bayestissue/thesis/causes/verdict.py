"""From simulated campaigns and what was observed to tables: one row a cause, and what a page needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayestissue.thesis.causes.attribution import Attribution, attribute, confusion, reliability
from bayestissue.thesis.causes.checks import FEWEST, Calibration, JointCheck, two_sided
from bayestissue.thesis.causes.specification import CausesSpecification
from bayestissue.thesis.causes.statistics import APART, LEVEL, SIZES

# Below the first a cause is said not to have made the numbers, below the second hardly.
REFUTED, DOUBTFUL = 0.01, 0.1
LEVELS = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
_NEAREST = 0.02


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
    at = np.array([observed[name] for name in joint])
    attribution = attribute(values, campaigns["code"].to_numpy(), _scaled(at, joint), seed)
    rows = [
        _row(name, campaigns[campaigns["cause"] == name], observed, joint, specification) for name in names
    ]
    table = pd.DataFrame(rows)
    table.insert(4, "probability", attribution.probability)
    table.insert(5, "probability_error", attribution.error)
    return Verdict(
        causes=table,
        predictive=_predictive(campaigns, names, list(observed)),
        observed=pd.DataFrame(
            {
                "statistic": list(observed),
                "value": list(observed.values()),
                "compared": ["yes" if name in joint else "no" for name in observed],
            }
        ),
        confusion=_confusion(attribution, names),
        reliability=pd.DataFrame(
            reliability(attribution),
            columns=["probability", "right", "cases"],
        ),
        log_score=(attribution.log_score, -float(np.log(len(names)))),
    )


def _compared(campaigns: pd.DataFrame, joint: Sequence[str]) -> np.ndarray:
    values = _scaled(campaigns[list(joint)].to_numpy(float), joint)
    return np.where(np.isfinite(values), values, np.nan)


def _scaled(values: np.ndarray, joint: Sequence[str]) -> np.ndarray:
    """Positive sizes on a logarithmic scale; everything else as it is."""
    is_size = np.array([name in SIZES for name in joint])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(is_size, np.log(np.where(is_size, values, 1.0)), values)


def _row(
    name: str,
    campaigns: pd.DataFrame,
    observed: Mapping[str, float],
    joint: Sequence[str],
    specification: CausesSpecification,
) -> dict[str, object]:
    values = _compared(campaigns, joint)
    at = _scaled(np.array([observed[statistic] for statistic in joint]), joint)
    complete = int(np.isfinite(values).all(axis=1).sum())
    single = {
        f"p_{statistic}": two_sided(campaigns[statistic].to_numpy(float), observed[statistic])
        for statistic in observed
        if statistic not in APART
    }
    failing = [s for p, s in sorted((single[f"p_{s}"], s) for s in joint) if p < REFUTED]
    if complete > FEWEST:
        check = JointCheck(values)
        p, smallest, calibration = check.p_value(at), check.smallest_p, check.calibration()
        nearest = _nearest(campaigns, check.nearest(values, at, _NEAREST))
    else:
        # What was observed is complete, which this cause's campaigns are this seldom.
        p, smallest = (1 + complete) / (1 + len(values)), 1 / (1 + len(values))
        calibration, nearest, failing = Calibration(np.nan, np.nan, 0, np.nan), "", list(APART)
    return {
        "cause": name,
        "title": specification.causes[name].words,
        "campaigns": len(campaigns),
        "complete": complete / len(values),
        "p_joint": p,
        "smallest_p": smallest,
        **single,
        "calibration_below_10": calibration.below_10,
        "calibration_below_50": calibration.below_50,
        "calibration_campaigns": calibration.campaigns,
        "calibration_p": calibration.uniform_p,
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
    rows = []
    for name in names:
        own = campaigns[campaigns["cause"] == name]
        for statistic in statistics:
            quantiles = own[statistic].quantile(list(LEVELS))
            found = {f"q{100 * level:02.0f}": q for level, q in zip(LEVELS, quantiles, strict=True)}
            rows.append({"cause": name, "statistic": statistic, **found})
    return pd.DataFrame(rows)


def _confusion(attribution: Attribution, names: Sequence[str]) -> pd.DataFrame:
    table = pd.DataFrame(confusion(attribution), columns=list(names))
    table.insert(0, "truth", list(names))
    return table
