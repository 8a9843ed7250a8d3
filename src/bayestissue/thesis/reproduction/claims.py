"""The numbers claimed in the running text of chapters 5 to 7, recomputed one by one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import Line, Recomputed, agrees, line
from bayestissue.thesis.reproduction.conditions import QUANTITIES
from bayestissue.thesis.reproduction.covariates import NEVER_TABULATED, factors
from bayestissue.thesis.reproduction.evidence import Evidence


def claim_lines(published: PublishedTables) -> list[Line]:
    """Every claim of the text beside what the tables say; ``row`` is the number of the claim."""
    evidence: dict[str, Evidence] = {quantity: Evidence(published, quantity) for quantity in QUANTITIES}
    claims = published.claims
    found = [_recompute(claim, published, evidence) for _, claim in claims.iterrows()]
    return [
        line(
            f"section {claim['section']}",
            int(claim["claim"]),
            claim["statistic"]
            if claim["quantity"] == "design"
            else f"{claim['quantity']}: {claim['statistic']}",
            claim["value_text"],
            replace(recomputed, hint=_hint(claim, claims, recomputed)),
        )
        for (_, claim), recomputed in zip(claims.iterrows(), found, strict=True)
    ]


_STATISTICS: dict[str, Callable[[Evidence], Recomputed]] = {
    "mean": Evidence.mean,
    "variance": Evidence.variance,
    "minimum": Evidence.minimum,
    "maximum": Evidence.maximum,
    "range": Evidence.range,
    "ratio of maximum to minimum": Evidence.ratio,
    "minimum of trial averages": Evidence.minimum_of_averages,
    "maximum of trial averages": Evidence.maximum_of_averages,
    "range of trial averages": Evidence.range_of_averages,
    "ratio of trial averages": Evidence.ratio_of_averages,
    "number of variables significantly correlated": Evidence.significantly_correlated,
    "number of variables in the final stepwise model": Evidence.in_final_model,
    "highest correlations with mass as a component": Evidence.with_mass_among_highest,
}
_CORRELATION = re.compile(r"correlation (?P<averaged>of trial averages )?with (?P<name>.+)")


def _recompute(claim: pd.Series, published: PublishedTables, evidence: dict[str, Evidence]) -> Recomputed:
    statistic, quantity = claim["statistic"], claim["quantity"]
    if quantity == "design":
        return _design(statistic, published, evidence["K"].table)
    if quantity not in evidence:
        return Recomputed(None, note=NEVER_TABULATED)
    if statistic in _STATISTICS:
        return _STATISTICS[statistic](evidence[quantity])
    if matched := _CORRELATION.fullmatch(statistic):
        of = (
            evidence[quantity].averaged_correlation if matched["averaged"] else evidence[quantity].correlation
        )
        return of(matched["name"])
    return Recomputed(None, note="no rule recomputes this statistic")


def _design(statistic: str, published: PublishedTables, table: pd.DataFrame) -> Recomputed:
    left = f"{len(published.estimates)} of them remain"
    names = published.stepwise["variable"]
    known: dict[str, tuple[float, str]] = {
        "number of trials": (len(table), ""),
        "number of subjects": (published.estimates["subject"].nunique(), ""),
        "number of estimates": (table["impacts"].sum(), left),
        "number of variables available to the stepwise analysis": (
            names.map(factors).nunique(),
            f"Table 5.17 lists {names.nunique()} names, of which equal products are counted once",
        ),
    }
    if statistic not in known:
        return Recomputed(None, note="no rule recomputes this statistic")
    value, note = known[statistic]
    return Recomputed(float(value), note=note)


def _hint(claim: pd.Series, claims: pd.DataFrame, found: Recomputed) -> str:
    """Where the number may come from: another claimed statistic, or a place where the text has it right."""
    if found.value is None or agrees(claim["value_text"], found.value):
        return ""
    same = claims[claims["quantity"] == claim["quantity"]]
    # Two small counts are equal by chance; two numbers with digits after the point hardly are.
    printed = "." in claim["value_text"]
    others = same[printed & (same["value"] == claim["value"]) & (same["statistic"] != claim["statistic"])]
    hints = [f"repeats the {statistic}" for statistic in others["statistic"].unique()]
    right = same[(same["statistic"] == claim["statistic"]) & (same["value"] != claim["value"])]
    hints += [
        f"section {other['section']} prints {other['value_text']}, which agrees"
        for _, other in right.drop_duplicates("value").iterrows()
        if agrees(other["value_text"], found.value)
    ]
    return "; ".join(hints)
