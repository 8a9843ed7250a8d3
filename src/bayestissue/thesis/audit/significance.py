"""What the text says of correlations and of significance, against the tables of correlations."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pandas as pd

from bayestissue.thesis.audit.findings import PUBLISHED, Finding, Publication, named_rows
from bayestissue.thesis.reproduction.conditions import Quantity, conditions, factors, grand_mean, has_mass
from bayestissue.thesis.reproduction.correlations import correlation_of_impacts, p_value

LEVEL = 0.05
_ALL_IMPACTS = "5.12"
_ONLY = re.compile(r"\bonly\b.*\bstatistically significant")


@PUBLISHED.check(
    severity="minor",
    bearing="conclusions",
    reason="the text draws a conclusion from it that the table beside it denies",
)
def not_significant_after_all(publication: Publication) -> Iterator[Finding]:
    """A correlation listed among the significant ones with a p-value that is not."""
    table = publication.tables.correlations.dropna(subset=["p_value"])
    for claim in named_rows(publication.tables.claims):
        name = claim.statistic.removeprefix("correlation with ")
        row = table[(table["quantity"] == claim.quantity) & (table["variable"] == name)]
        if "statistically significant" not in claim.sentence or row.empty:
            continue
        printed = row.iloc[0]
        if printed["p_value"] < LEVEL:
            continue
        weakest = table[(table["quantity"] == claim.quantity) & (table["p_value"] < LEVEL)]
        weakest = weakest.loc[weakest["correlation"].abs().idxmin()]
        yield Finding(
            f"section {claim.section}, Table {printed['table']}",
            f"significance of {name} for {claim.quantity}",
            f"r = {printed['correlation_text']} among the significant",
            f"p = {printed['p_value_text']}",
            f"Section {claim.section} lets the significant correlations with {claim.quantity} run down to "
            f"{printed['correlation_text']} for {name}, whose p-value in Table {printed['table']} is "
            f"{printed['p_value_text']}; the weakest significant one is {weakest['variable']} "
            f"({weakest['correlation_text']}).",
        )


@PUBLISHED.check(
    severity="minor",
    bearing="conclusions",
    reason="the table that would show it is lost, but its content follows from the other tables",
)
def not_the_only_one(publication: Publication) -> Iterator[Finding]:
    """A variable called the only significant one, while others are."""
    for claim in named_rows(publication.tables.claims):
        said = claim.statistic.removeprefix("correlation with ")
        if said == claim.statistic or not _ONLY.search(claim.sentence):
            continue
        recomputed = _recomputed(publication, claim.quantity)
        others = recomputed[(recomputed["p"] < LEVEL) & (recomputed.index != said)]
        if others.empty:
            continue
        words = ", ".join(f"{name} {row['r']:.3f}" for name, row in others.head(4).iterrows())
        yield Finding(
            f"section {claim.section}",
            f"variables significant for {claim.quantity}",
            f"{said} only",
            f"{len(others) + 1} of {len(recomputed)}",
            f"Section {claim.section} calls {said} the only variable significantly correlated with "
            f"{claim.quantity}. From the averages and standard deviations of the trials {len(others)} more "
            f"of {len(recomputed)} variables are significant among all "
            f"{_impacts(publication, claim.quantity)} impacts ({words}; "
            f"the largest p is {others['p'].max():.1g}).",
        )


@PUBLISHED.check(
    severity="note",
    bearing="conclusions",
    reason="mass stays the strongest; only the count is wrong",
)
def highest_correlations(publication: Publication) -> Iterator[Finding]:
    """Mass said to be in each of the n highest correlations."""
    claims = publication.tables.claims
    for claim in named_rows(claims[claims["statistic"] == "highest correlations with mass as a component"]):
        count = int(claim.value)
        for table, rows in _correlation_tables(publication, claim.quantity):
            top = rows.abs().sort_values(ascending=False).head(count)
            without = [name for name in top.index if not has_mass(name)]
            if not without:
                continue
            yield Finding(
                f"section {claim.section}, {table}",
                f"the {count} highest correlations with {claim.quantity}",
                f"all {count} have mass",
                f"{count - len(without)} of {count}",
                f"In {table} the {count} highest correlations with {claim.quantity} include "
                f"{', '.join(f'{name} ({rows[name]:.3f})' for name in without)}, which has no mass in it; "
                f"section {claim.section} says that all have.",
            )


@PUBLISHED.check(
    severity="minor",
    bearing="tables",
    reason="no data whatever have these three correlations",
)
def correlation_with_a_sum(publication: Publication) -> Iterator[Finding]:
    """Cor(y, a + b) can't be nearer to zero than both cor(y, a) and cor(y, b), if these have one sign.

    The standard deviation of a sum is at most the sum of the standard deviations, so the correlation with
    a + b is at least a weighted mean of the two.
    """
    for (table, quantity), rows in publication.tables.correlations.groupby(["table", "quantity"], sort=False):
        values = rows.set_index(rows["variable"].map(lambda name: name.lower().strip()))
        for name, row in values.iterrows():
            parts = [part.strip() for part in str(name).split("+")]
            if len(parts) != 2 or not set(parts) <= set(values.index):
                continue
            first, second = (values.loc[part] for part in parts)
            least = min(abs(first["correlation"]), abs(second["correlation"]))
            if first["correlation"] * second["correlation"] <= 0 or abs(row["correlation"]) >= least - 0.002:
                continue
            yield Finding(
                f"Table {table}",
                f"correlation of {quantity} with {row['variable']}",
                row["correlation_text"],
                f"at least {least:.3f} in size",
                f"Table {table} gives {first['correlation_text']} for {first['variable']}, "
                f"{second['correlation_text']} for {second['variable']} and {row['correlation_text']} for "
                "their sum. The correlation with a sum of two variables can't be weaker than both when "
                f"they have the same sign: it is at least {least:.3f} in size.",
            )


@PUBLISHED.check(
    severity="minor",
    bearing="conclusions",
    reason="personal factors are judged by figures that the stated averages can't give",
)
def personal_factors_of_averages(publication: Publication) -> Iterator[Finding]:
    """Correlations of averages over the same people with a property of those people."""
    correlations = publication.tables.correlations
    averaged = correlations[correlations["table"] != _ALL_IMPACTS]
    personal = averaged[~averaged["variable"].map(_is_condition)]
    people = publication.tables.estimates.groupby("trial")["subject"].agg(frozenset)
    if personal.empty or len(people.unique()) > 1:
        return
    values = ", ".join(f"{row.variable} {row.correlation_text}" for row in named_rows(personal))
    tables = " and ".join(personal["table"].unique())
    yield Finding(
        f"Tables {tables}",
        "personal factors against the trials' averages",
        values,
        "not defined",
        f"The averages are over the same {len(people.iloc[0])} people in every trial, so the average skin "
        "fold or muscle is one number for all trials and has no correlation with anything; yet Tables "
        f"{tables} print {len(personal)} such correlations, up to "
        f"{personal['correlation'].abs().max():.3f}.",
    )


@PUBLISHED.check(
    severity="minor",
    bearing="conclusions",
    reason="the sign of an effect is what the text explains",
)
def sign_of_a_personal_factor(publication: Publication) -> Iterator[Finding]:
    """A coefficient against the correlation, for a variable that the design makes independent of mass.

    Where everybody takes part in every trial, a property of the person is uncorrelated with mass, and its
    coefficient is r s_y / s_x whether mass is in the equation or not.
    """
    tables = publication.tables
    for row in named_rows(tables.regressions):
        if row.term != "SFT":
            continue
        listed = tables.correlations.query("quantity == @row.quantity and table == @_ALL_IMPACTS")
        listed = listed[listed["variable"].str.strip() == "Skin Fold"]
        if listed.empty or listed.iloc[0]["correlation"] * row.coefficient >= 0:
            continue
        r = listed.iloc[0]
        table = conditions(tables, row.quantity)
        total = _standard_deviation(table)
        needed = abs(r["correlation"]) * total / abs(row.coefficient)
        yield Finding(
            f"section 5.4, Table {r['table']}",
            f"effect of skin fold on {row.quantity}",
            f"coefficient {row.coefficient_text}",
            f"correlation {r['correlation_text']}",
            "Everybody was struck in every trial, so skin fold is independent of mass and its coefficient "
            f"in the equation of {row.quantity} must have the sign of its correlation: "
            f"{r['correlation_text']} in Table {r['table']}, but {row.coefficient_text} in the equation, "
            "which the text explains as an increase. Their sizes agree only if skin folds varied by "
            f"{needed:.0f} units (standard deviation).",
        )


def _recomputed(publication: Publication, quantity: Quantity) -> pd.DataFrame:
    """R and p of all impacts with the variables of Table 5.12 that energy, velocity and mass make."""
    table = conditions(publication.tables, quantity)
    listed = publication.tables.correlations
    names = listed.loc[listed["table"] == _ALL_IMPACTS, "variable"]
    correlations = {name: correlation_of_impacts(name, table).value for name in names}
    r = pd.Series({name: value for name, value in correlations.items() if value is not None}, dtype="float64")
    count = float(table["impacts"].sum())
    frame = pd.DataFrame({"r": r, "p": [p_value(value, count) for value in r]})
    return frame.loc[r.abs().sort_values(ascending=False).index]


def _correlation_tables(publication: Publication, quantity: Quantity) -> Iterator[tuple[str, pd.Series]]:
    printed = publication.tables.correlations.query("quantity == @quantity")
    for table, rows in printed.groupby("table", sort=False):
        yield f"Table {table}", rows.drop_duplicates("variable").set_index("variable")["correlation"]
    if _ALL_IMPACTS not in set(printed["table"]):
        yield "the recomputed Table 5.13", _recomputed(publication, quantity)["r"]


def _is_condition(name: str) -> bool:
    return all(factor in ("energy", "velocity", "mass") for factor in factors(name))


def _standard_deviation(table: pd.DataFrame) -> float:
    """Over all impacts, from averages and standard deviations of the conditions."""
    n = table["impacts"]
    squares = (n * (table["average"] - grand_mean(table)) ** 2 + (n - 1) * table["sd"] ** 2).sum()
    return float(np.sqrt(squares / (n.sum() - 1)))


def _impacts(publication: Publication, quantity: Quantity) -> int:
    return int(conditions(publication.tables, quantity)["impacts"].sum())
