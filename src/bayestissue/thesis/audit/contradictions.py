"""The same figure given twice, or figures of one sentence that can't all be right."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from bayestissue.thesis.audit.findings import PUBLISHED, SEVERITIES, Finding, Publication, Severity
from bayestissue.thesis.reproduction.agreement import decimals, half_unit


@PUBLISHED.check(
    severity="minor",
    bearing="wording",
    reason="one of the figures must be wrong; a difference in the last digit is only a note",
)
def claims_that_contradict(publication: Publication) -> Iterator[Finding]:
    """One figure stated in several places with different values."""
    for (quantity, statistic), claims in publication.tables.claims.groupby(
        ["quantity", "statistic"], sort=False
    ):
        values = claims.drop_duplicates("value")
        if len(values) < 2:
            continue
        low, high = values["value"].min(), values["value"].max()
        finest = values["value_text"].map(half_unit).astype("float64")
        if high - low <= finest.max() + finest.min() and finest.max() > finest.min():
            continue
        said = "; ".join(
            f"{text} (section {_sections(claims, text)})" for text in values["value_text"].drop_duplicates()
        )
        implied = _recomputed(publication, claims)
        if high - low <= 2 * finest.max() + 1e-9:
            severity: Severity = "note"
            verdict = "They differ in the last digit only."
        else:
            severity = "minor"
            verdict = f"They differ by {_difference(low, high)}; at most one can be right."
        yield Finding(
            ", ".join(f"section {section}" for section in claims["section"].unique()),
            f"{quantity}: {statistic}",
            " and ".join(values["value_text"]),
            implied or "one value",
            f"For {quantity} the {statistic} is given as {said}. {verdict}"
            + (f" Recomputed from the tables it is {implied}." if implied else ""),
            severity,
        )


@PUBLISHED.check(
    severity="minor",
    bearing="wording",
    reason="the section refutes itself, whatever the data",
)
def arithmetic_of_claims(publication: Publication) -> Iterator[Finding]:
    """Range and ratio beside the smallest and largest value stated in the same section.

    A figure that the text gives with several values is left to `claims_that_contradict`, unless all of them
    disagree with the ends.
    """
    for (section, quantity), claims in publication.tables.claims.groupby(["section", "quantity"], sort=False):
        said = {str(name): rows for name, rows in claims.groupby("statistic")}
        for low_name, high_name, derived in _DERIVED:
            if low_name not in said or high_name not in said:
                continue
            low, high = said[low_name].iloc[0], said[high_name].iloc[0]
            for name, (of_ends, slack_of_ends) in derived.items():
                stated = said.get(name, pd.DataFrame(columns=claims.columns)).drop_duplicates("value")
                implied = of_ends(low["value"], high["value"])
                slack = slack_of_ends(low, high) + stated["value_text"].map(half_unit).astype("float64")
                wrong = stated[(stated["value"] - implied).abs() > slack + 1e-9]
                several = len(publication.claims(str(quantity), name)["value"].unique()) > len(stated)
                if wrong.empty or several:
                    continue
                figures = " and ".join(wrong["value_text"])
                needed = f"{high['value'] / wrong['value'].iloc[0]:.3g}" if "ratio" in name else ""
                yield Finding(
                    f"section {section}",
                    f"{name} of {quantity} against its ends",
                    figures,
                    f"{implied:.4g}",
                    f"Section {section} lets {quantity} run from {low['value_text']} to "
                    f"{high['value_text']}, which makes the {name} {implied:.4g}, and calls it {figures}."
                    + (f" That ratio needs a smallest value of {needed}." if needed else ""),
                )


def _rounding_of_ratio(low: pd.Series, high: pd.Series) -> float:
    relative = [half_unit(end["value_text"]) / abs(end["value"]) for end in (low, high)]
    return sum(relative) * high["value"] / low["value"]


# What follows from two ends, and how far their rounding may move it.
_RANGE = (
    lambda low, high: high - low,
    lambda low, high: half_unit(low["value_text"]) + half_unit(high["value_text"]),
)
_RATIO = (lambda low, high: high / low, _rounding_of_ratio)
_DERIVED = tuple(
    (f"minimum{suffix}", f"maximum{suffix}", {f"range{suffix}": _RANGE, ratio: _RATIO})
    for suffix, ratio in (
        ("", "ratio of maximum to minimum"),
        (" of trial averages", "ratio of trial averages"),
    )
)


@PUBLISHED.check(
    severity="minor",
    bearing="conclusions",
    reason="a conclusion that another chapter denies can't be quoted",
)
def statements_that_contradict(publication: Publication) -> Iterator[Finding]:
    """Two positions on one topic."""
    for topic, said in publication.statements.groupby("topic", sort=False):
        positions = said.groupby("position", sort=False)["place"].agg(list)
        if len(positions) < 2:
            continue
        words = "; ".join(
            f"{' and '.join(_location(one) for one in places)}: {position}"
            for position, places in positions.items()
        )
        first, last = said.iloc[0], said[said["position"] != said["position"].iloc[0]].iloc[0]
        yield Finding(
            ", ".join(_location(location) for location in said["place"].unique()),
            str(topic),
            " / ".join(map(str, positions.index)),
            "one of them",
            f"There are different positions on {topic} ({words}). "
            f"“{first['sentence']}” and “{last['sentence']}” can't both hold.",
            first["weight"] if first["weight"] in SEVERITIES else None,
        )


def _recomputed(publication: Publication, claims: pd.DataFrame) -> str:
    """The figure that the tables give for the first of ``claims``, with one digit more than the claim."""
    first = claims.iloc[0]
    lines = publication.reproduction
    line = lines[(lines["table"] == f"section {first['section']}") & (lines["row"] == first["claim"])]
    value = pd.to_numeric(line["reproduced"], errors="coerce").dropna()
    return "" if value.empty else f"{value.iloc[0]:.{claims['value_text'].map(decimals).max() + 1}f}"


def _location(location: str) -> str:
    return f"section {location}" if location[:1].isdigit() else location


def _sections(claims: pd.DataFrame, text: str) -> str:
    return ", ".join(claims.loc[claims["value_text"] == text, "section"].unique())


def _difference(low: float, high: float) -> str:
    """In per cent of the smaller, or as a factor where that is large."""
    if low <= 0:
        return f"{high - low:.3g}"
    return f"a factor of {high / low:.2g}" if high > 1.5 * low else f"{high / low - 1:.1%}"
