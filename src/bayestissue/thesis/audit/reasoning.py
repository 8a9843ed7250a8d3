"""What the text concludes, from correlations, regressions and the design, against the tables."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pandas as pd

from bayestissue.thesis.audit.inconsistencies import Numbers, Publication, named_rows
from bayestissue.thesis.reproduction.conditions import (
    QUANTITIES,
    Quantity,
    conditions,
    factors,
    sum_of_squares,
)
from bayestissue.thesis.reproduction.relations import (
    ALPHA,
    correlation_of_impacts,
    correlations_of_impacts,
    p_value,
)

_ALL_IMPACTS = "5.12"
_ONLY = re.compile(r"\bonly\b.*\bstatistically significant")


def r_squared_of_averages(publication: Publication) -> Iterator[Numbers]:
    """R² of a fit to averages, given as if it held for single impacts.

    Minor: it makes an equation for averages of ten look like one for an impact.
    """
    for quantity in QUANTITIES:
        terms, table = publication.equation(quantity)
        r, printed = correlation_of_impacts("Mass", table).value, terms.iloc[0]
        if r is not None and abs(printed["r_squared"] - r**2) >= 0.05:
            of_averages = np.corrcoef(table["mass_kg"], table["average"])[0, 1] ** 2
            squares = {"of_impacts": r**2, "of_averages": of_averages}
            counts = {"trials": len(table), "people": table["impacts"].iloc[0]}
            yield {"printed": printed, "r": r, **squares, **counts}


def not_significant_after_all(publication: Publication) -> Iterator[Numbers]:
    """A correlation listed among the significant ones with a p-value that is not.

    Minor: the text draws a conclusion from it that the table beside it denies.
    """
    table = publication.tables.correlations.dropna(subset=["p_value"])
    for claim in named_rows(publication.tables.claims):
        name = claim.statistic.removeprefix("correlation with ")
        row = table[(table["quantity"] == claim.quantity) & (table["variable"] == name)]
        if "statistically significant" not in claim.sentence or row.empty or row.iloc[0]["p_value"] < ALPHA:
            continue
        significant = table[(table["quantity"] == claim.quantity) & (table["p_value"] < ALPHA)]
        weakest = significant.loc[significant["correlation"].abs().idxmin()]
        yield {"claim": claim, "name": name, "printed": row.iloc[0], "weakest": weakest}


def not_the_only_one(publication: Publication) -> Iterator[Numbers]:
    """A variable called the only significant one, while others are.

    Minor: the table that would show it is lost, but its content follows from the other tables.
    """
    for claim in named_rows(publication.tables.claims):
        said = claim.statistic.removeprefix("correlation with ")
        if said == claim.statistic or not _ONLY.search(claim.sentence):
            continue
        recomputed = _recomputed(publication, claim.quantity)
        others = recomputed[(recomputed["p"] < ALPHA) & (recomputed.index != said)]
        if not others.empty:
            counts = {"significant": len(others) + 1, "others": len(others), "variables": len(recomputed)}
            impacts = conditions(publication.tables, claim.quantity)["impacts"].sum()
            words = ", ".join(f"{name} {r:.3f}" for name, r in others["r"].head(4).items())
            yield {
                "claim": claim,
                "said": said,
                "impacts": impacts,
                "words": words,
                "p": others["p"].max(),
                **counts,
            }


def correlation_with_a_sum(publication: Publication) -> Iterator[Numbers]:
    """Cor(y, a + b) can't be nearer to zero than both cor(y, a) and cor(y, b), if these have one sign.

    The standard deviation of a sum is at most the sum of the standard deviations, so the correlation with
    a + b is at least a weighted mean of the two.

    Minor: no data whatever have these three correlations.
    """
    for _, rows in publication.tables.correlations.groupby(["table", "quantity"], sort=False):
        values = rows.set_index(rows["variable"].map(lambda name: name.lower().strip()))
        for name, row in values.iterrows():
            parts = [part.strip() for part in str(name).split("+")]
            if len(parts) != 2 or not set(parts) <= set(values.index):
                continue
            first, second = (values.loc[part] for part in parts)
            least = min(abs(first["correlation"]), abs(second["correlation"]))
            one_sign = first["correlation"] * second["correlation"] > 0
            if one_sign and abs(row["correlation"]) < least - 0.002:
                yield {"row": row, "first": first, "second": second, "least": least}


def personal_factors_of_averages(publication: Publication) -> Iterator[Numbers]:
    """Correlations of averages over the same people with a property of those people.

    Minor: personal factors are judged by figures that the stated averages can't give.
    """
    correlations = publication.tables.correlations
    averaged = correlations[correlations["table"] != _ALL_IMPACTS]
    of_design = averaged["variable"].map(lambda name: set(factors(name)) <= {"energy", "velocity", "mass"})
    personal = averaged[~of_design]
    people = publication.tables.estimates.groupby("trial")["subject"].agg(frozenset)
    if personal.empty or len(people.unique()) > 1:
        return
    yield {
        "tables": " and ".join(personal["table"].unique()),
        "values": ", ".join(f"{row.variable} {row.correlation_text}" for row in named_rows(personal)),
        "people": len(people.iloc[0]),
        "count": len(personal),
        "greatest": personal["correlation"].abs().max(),
    }


def sign_of_a_personal_factor(publication: Publication) -> Iterator[Numbers]:
    """A coefficient against the correlation, for a variable that the design makes independent of mass.

    Where everybody takes part in every trial, a property of the person is uncorrelated with mass, and its
    coefficient is r s_y / s_x whether mass is in the equation or not.

    Minor: the sign of an effect is what the text explains.
    """
    tables = publication.tables
    for row in named_rows(tables.regressions):
        if row.term != "SFT":
            continue
        listed = tables.correlations.query("quantity == @row.quantity and table == @_ALL_IMPACTS")
        listed = listed[listed["variable"].str.strip() == "Skin Fold"]
        if listed.empty or listed.iloc[0]["correlation"] * row.coefficient >= 0:
            continue
        r, table = listed.iloc[0], conditions(tables, row.quantity)
        squares = sum_of_squares(table)
        total = float(np.sqrt(squares / (table["impacts"].sum() - 1)))
        yield {"row": row, "r": r, "needed": abs(r["correlation"]) * total / abs(row.coefficient)}


def _recomputed(publication: Publication, quantity: Quantity) -> pd.DataFrame:
    """R and p of all impacts with the variables of Table 5.12 that energy, velocity and mass make."""
    table = conditions(publication.tables, quantity)
    r = pd.Series(correlations_of_impacts(publication.tables, table), dtype="float64")
    count = float(table["impacts"].sum())
    frame = pd.DataFrame({"r": r, "p": [p_value(value, count) for value in r]})
    return frame.loc[r.abs().sort_values(ascending=False).index]
