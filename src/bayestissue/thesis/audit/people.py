"""Whether people can be told apart by their estimates, and whether rows look copied."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import comb

import numpy as np
import pandas as pd
from scipy import stats

from bayestissue.thesis.audit.plausibility import AuditedImpacts, Numbers

_TELLING = 0.5
"""An intraclass correlation that may be as high as this is not refuted by a table with few people."""


@dataclass(frozen=True)
class Agreement:
    """How alike the same person's estimates are in different conditions.

    Attributes:
        correlation: intraclass correlation (one person, any two conditions) of the logarithms, condition
            means removed; ICC(C,1) of McGraw and Wong (1996).
        high: its upper 95 % limit, from the F distribution.
        p_value: of the hypothesis that there are no differences between people (F test).
        rank_correlation: mean Spearman correlation between two conditions.
        people, conditions: size of the complete table that was used.
    """

    correlation: float
    high: float
    p_value: float
    rank_correlation: float
    people: int
    conditions: int


def agreement(impacts: AuditedImpacts, quantity: str) -> Agreement:
    """Two-way analysis of variance of log ``quantity``."""
    logs = impacts.rows.assign(value=np.log(impacts.rows[quantity]))
    table = logs.pivot_table(index="subject", columns="trial", values="value").dropna(axis=1)
    n, k = table.shape
    centred = table - table.mean()
    people = k * centred.mean(axis=1).pow(2).sum() / (n - 1)
    residual = centred.sub(centred.mean(axis=1), axis=0).pow(2).to_numpy().sum() / ((n - 1) * (k - 1))
    ratio = people / residual
    degrees = (n - 1, (n - 1) * (k - 1))
    upper = ratio * stats.f.ppf(0.975, degrees[1], degrees[0])
    ranks = np.corrcoef(table.rank().to_numpy().T)
    return Agreement(
        correlation=float((ratio - 1) / (ratio + k - 1)),
        high=float((upper - 1) / (upper + k - 1)),
        p_value=float(stats.f.sf(ratio, *degrees)),
        rank_correlation=float(ranks[np.triu_indices(k, 1)].mean()),
        people=n,
        conditions=k,
    )


def people_not_told_apart(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """The same people, struck again, do not come out in the same order.

    Major: a property of a person's tissue must show in the same person twice.
    """
    agreements = {quantity: agreement(impacts, quantity) for quantity in ("K", "C")}
    indistinct = {name: one for name, one in agreements.items() if one.p_value > 0.05 and one.high < _TELLING}
    if not indistinct:
        return
    yield {
        "names": " or ".join(indistinct),
        "size": next(iter(indistinct.values())),
        "correlations": "; ".join(
            f"{name}: intraclass correlation {one.correlation:.2f}, at most {one.high:.2f}"
            for name, one in indistinct.items()
        ),
        "figures": "; ".join(
            f"{name}: mean rank correlation between trials {one.rank_correlation:.2f}, p = {one.p_value:.2f}"
            for name, one in indistinct.items()
        ),
    }


def damping_without_bounds(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """C that differs many times over within one condition while K hardly differs.

    Minor: a damper that differs so much between shoulders of one age and stiffness is not credible.
    """
    ends = impacts.rows.groupby("trial")[["K", "C"]].agg(["min", "max"])
    times = pd.DataFrame({name: ends[name]["max"] / ends[name]["min"] for name in ("K", "C")})
    wide = times[(times["C"] > 4) & (np.log(times["C"]) > 5 * np.log(times["K"]))]
    if wide.empty:
        return
    worst = wide.loc[wide["C"].idxmax()]
    counts = {"most": wide["K"].max() - 1, "wide": len(wide), "trials": len(ends)}
    yield {"worst": worst, "C": ends["C"].loc[worst.name], **counts}


def unequal_scatter(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """Scatter within conditions that differs by more than chance (Brown and Forsythe's test).

    Note: correlation and regression took the scatter to be the same in every condition.
    """
    for quantity in ("K", "C"):
        logs = {trial: np.log(rows[quantity].to_numpy()) for trial, rows in impacts.rows.groupby("trial")}
        p = stats.levene(*logs.values(), center="median").pvalue
        if p < 0.01:
            spread = pd.Series({trial: float(np.std(values, ddof=1)) for trial, values in logs.items()})
            least = {"least": spread.min(), "quietest": spread.idxmin()}
            yield {"quantity": quantity, "most": spread.max(), "noisiest": spread.idxmax(), "p": p, **least}


def rows_that_stand_twice(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """Two people with the same K and the same C in one trial.

    By chance two would print alike only as often as normal values of that trial do.

    Minor: one impact less changes the averages of its trial, not the conclusions.
    """
    again = impacts.rows[impacts.rows.duplicated(["trial", "K", "C"], keep=False)]
    for (trial, K, C), rows in again.groupby(["trial", "K", "C"]):
        of_trial = impacts.rows[impacts.rows["trial"] == trial]
        # The difference of two normals has density 1/(2 s √π) at zero, times the width of the last digit.
        sd = of_trial[["K", "C"]].std(ddof=1)
        chances = 10.0**-impacts.digits * stats.norm.pdf(0) / (np.sqrt(2) * sd)
        likely = comb(len(of_trial), 2) * chances.clip(upper=1).prod()
        frequency = (
            f"once in {float(f'{1 / likely:.1e}'):,.0f} such trials" if likely > 1e-6 else "practically never"
        )
        people = " and ".join(map(str, rows["subject"]))
        numbers = {"trial": trial, "people": people, "K": K, "C": C}
        yield {"likely": likely, "frequency": frequency, **numbers}


def estimates_in_two_trials(impacts: AuditedImpacts) -> Iterator[Numbers]:
    """The same K and the same C in trials of different mass.

    Minor: a row copied from another trial belongs to another mass.
    """
    again = impacts.rows[impacts.rows.duplicated(["K", "C"], keep=False)]
    across = again.groupby(["K", "C"]).filter(lambda rows: len(rows["trial"].unique()) > 1)
    if not across.empty:
        yield {"rows": len(across), "trials": ", ".join(str(trial) for trial in across["trial"].unique())}
