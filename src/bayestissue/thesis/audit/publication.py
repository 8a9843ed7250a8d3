"""Printed figures against each other and what they are made of, and what the text concludes from them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.audit.plausibility import Numbers, number_list
from bayestissue.thesis.reproduction.agreement import agrees, decimals, half_unit, ratio
from bayestissue.thesis.reproduction.claims import DERIVED
from bayestissue.thesis.reproduction.conditions import (
    QUANTITIES,
    Quantity,
    conditions,
    factors,
    sum_of_squares,
    unrounded_mass,
)
from bayestissue.thesis.reproduction.relations import (
    ALPHA,
    correlation_of_impacts,
    correlations_of_impacts,
    straight_line,
)

# Of a figure: a difference that is a note.
_SMALL = 0.01
_ALL_IMPACTS = "5.12"
_ONLY = re.compile(r"\bonly\b.*\bstatistically significant")


@dataclass(frozen=True)
class Publication:
    """The published tables, claims of the text among them, and what follows from them.

    Attributes:
        tables: what was published.
        reproduction: every printed number beside the recomputed one, as of `reproduce_published`.
    """

    tables: PublishedTables
    reproduction: pd.DataFrame

    def equation(self, quantity: Quantity) -> tuple[pd.DataFrame, pd.DataFrame]:
        """The printed terms of the equation of K or C, and the conditions that it was fitted to."""
        terms = self.tables.regressions.query("quantity == @quantity")
        return terms, conditions(self.tables, quantity)


def named_rows(frame: pd.DataFrame) -> Iterator[Any]:
    """The rows of ``frame`` as named tuples, whose fields no type checker knows."""
    return iter(frame.itertuples())


def claims_that_contradict(publication: Publication) -> Iterator[Numbers]:
    """One figure stated in several places with different values.

    Minor: one of the figures must be wrong; a difference in the last digit is only a note.
    """
    by_figure = publication.tables.claims.groupby(["quantity", "statistic"], sort=False)
    for (quantity, statistic), claims in by_figure:
        values = claims.drop_duplicates("value")
        if len(values) < 2:
            continue
        low, high = values["value"].min(), values["value"].max()
        finest = values["value_text"].map(half_unit).astype("float64")
        if high - low <= finest.max() + finest.min() and finest.max() > finest.min():
            continue
        sections = claims.groupby("value_text", sort=False)["section"].unique().map(", ".join)
        implied = _recomputed(publication, claims)
        differ = f"by {_difference(low, high)}; at most one can be right."
        last_digit = high - low <= 2 * finest.max() + 1e-9
        yield {
            "sections": ", ".join(f"section {section}" for section in claims["section"].unique()),
            "quantity": quantity,
            "statistic": statistic,
            "texts": " and ".join(values["value_text"]),
            "one_value": implied or "one value",
            "said": "; ".join(f"{text} (section {sections[text]})" for text in values["value_text"]),
            "differ": "in the last digit only." if last_digit else differ,
            "recomputed": f" Recomputed from the tables it is {implied}." if implied else "",
            "severity": "note" if last_digit else "minor",
        }


def arithmetic_of_claims(publication: Publication) -> Iterator[Numbers]:
    """Range and ratio beside the smallest and largest value stated in the same section.

    A figure that the text gives with several values is left to `claims_that_contradict`, unless all of them
    disagree with the ends.

    Minor: the section refutes itself, whatever the data.
    """
    claims = publication.tables.claims
    values = dict(claims.groupby(["quantity", "statistic"])["value"].nunique())
    for (_, quantity), of_section in claims.groupby(["section", "quantity"], sort=False):
        said = {str(name): rows for name, rows in of_section.groupby("statistic")}
        for name, (low_name, high_name, rule) in DERIVED.items():
            if not {name, low_name, high_name} <= set(said):
                continue
            low, high = said[low_name].iloc[0], said[high_name].iloc[0]
            implied, rounding = rule(*((end["value"], half_unit(end["value_text"])) for end in (low, high)))
            stated = said[name].drop_duplicates("value")
            slack = rounding + stated["value_text"].map(half_unit).astype("float64")
            wrong = stated[(stated["value"] - implied).abs() > slack + 1e-9]
            if wrong.empty or values[quantity, name] > len(stated):
                continue
            least = high["value"] / wrong["value"].iloc[0]
            needed = f" That ratio needs a smallest value of {least:.3g}." if rule is ratio else ""
            figures = {"figures": " and ".join(wrong["value_text"]), "implied": implied, "needed": needed}
            yield {"name": name, "low": low, "high": high, **figures}


def _recomputed(publication: Publication, claims: pd.DataFrame) -> str:
    """The figure that the tables give for the first of ``claims``, with one digit more than the claim."""
    first = claims.iloc[0]
    lines = publication.reproduction
    line = lines[(lines["table"] == f"section {first['section']}") & (lines["row"] == first["claim"])]
    value = pd.to_numeric(line["reproduced"], errors="coerce").dropna()
    return "" if value.empty else f"{value.iloc[0]:.{claims['value_text'].map(decimals).max() + 1}f}"


def _difference(low: float, high: float) -> str:
    """In per cent of the smaller, or as a factor where that is large."""
    if low <= 0:
        return f"{high - low:.3g}"
    return f"a factor of {high / low:.2g}" if high > 1.5 * low else f"{high / low - 1:.1%}"


def figures_that_do_not_follow(publication: Publication) -> Iterator[Numbers]:
    """Figures that differ from the recomputed ones by more than one unit of the last digit.

    Masses are left to `kinetic_energy`, figures of the running text to `claims_that_contradict` where it
    gives several values; counts of variables are left out.

    Minor: the figure does not follow from its rows, though no conclusion rests on it; under 1 % is a
    note.
    """
    lines, claims = publication.reproduction, publication.tables.claims
    lines = lines[lines["agrees"].eq(False).fillna(False) & ~lines["quantity"].str.startswith("mass, trial")]
    lines = lines.assign(
        printed=pd.to_numeric(lines["published"], errors="coerce"),
        value=pd.to_numeric(lines["reproduced"], errors="coerce"),
    ).dropna(subset=["printed", "value"])
    unit = 2 * lines["published"].map(half_unit).astype("float64")
    last_digit = (lines["printed"] - lines["value"]).abs() <= unit + 1e-9
    several = claims.groupby(["quantity", "statistic"])["value"].transform("nunique") > 1
    elsewhere = claims.loc[several | claims["statistic"].str.startswith("number of"), "claim"]
    of_text = lines["table"].str.startswith("section")
    for row in named_rows(lines[~last_digit & ~(of_text & lines["row"].isin(elsewhere))]):
        words = {"place": _table_words(row.table), "hint": _hint(row.note)}
        implied = f"{row.value:.{decimals(row.published) + 1}f}"
        words["difference"] = _difference_words(row.printed, row.value)
        severity = "note" if abs(row.printed - row.value) < _SMALL * abs(row.value) else "minor"
        yield {"row": row, "implied": implied, "severity": severity, **words}


def masses_behind_the_regression(publication: Publication) -> Iterator[Numbers]:
    """An equation that follows from E = ½MV² at higher velocities, not from the printed masses.

    Minor: it shows which masses the calculations were made with.
    """
    for quantity in QUANTITIES:
        terms, table = publication.equation(quantity)
        exact = unrounded_mass(table)
        printed, unrounded = (straight_line(table, mass).params["const"] for mass in (None, exact))
        text = terms[terms["term"] == "constant"].iloc[0]["coefficient_text"]
        if not agrees(text, printed) and agrees(text, unrounded):
            velocity = np.unique(np.sqrt(2 * table["energy_J"] / exact).round(6))
            constant = {"text": text, "printed": printed, "unrounded": unrounded}
            yield {"quantity": quantity, "velocities": number_list(velocity), **constant}


def impossible_spread(publication: Publication) -> Iterator[Numbers]:
    """A standard deviation that does not fit the range beside it, where the rows are lost.

    For n numbers of range R the standard deviation (with n − 1) lies between R/√(2(n − 1)) and
    R √(n/(n − 1))/2 (von Szőkefalvi Nagy 1918; Popoviciu 1935).

    Minor: no ten numbers have such a range and standard deviation.
    """
    for quantity in QUANTITIES:
        table = conditions(publication.tables, quantity)
        for _, row in table[~table["from_rows"]].iterrows():
            n = row["impacts"]
            slack = half_unit(row["sd_text"]) + half_unit(row["range_text"])
            low, high = row["range"] / (2 * (n - 1)) ** 0.5, row["range"] / 2 * (n / (n - 1)) ** 0.5
            if not low - slack <= row["sd"] <= high + slack:
                yield {"place": _table_words(row["table"]), "row": row, "low": low, "high": high}


def _table_words(table: str) -> str:
    """Where ``table`` of the reproduction stands, in words."""
    if table.startswith("equation"):
        return f"the {table}"
    return table if table.startswith("section") else f"Table {table}"


def _difference_words(printed: float, value: float) -> str:
    if value and not 0.5 < printed / value < 2:
        return f"{printed / value:.3g} times that"
    return f"{abs(printed - value):.3g} off" + (f" ({abs(printed / value - 1):.2%})" if value else "")


def _hint(note: str) -> str:
    hint = note.split(";")[0].strip()
    if hint.startswith("repeats"):
        return f" (it {hint})"
    return f" ({hint})" if "not cut" in hint else ""


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
        table = conditions(publication.tables, claim.quantity)
        recomputed = correlations_of_impacts(publication.tables, table)
        others = recomputed[(recomputed["p"] < ALPHA) & (recomputed.index != said)]
        if not others.empty:
            counts = {"significant": len(others) + 1, "others": len(others), "variables": len(recomputed)}
            words = ", ".join(f"{name} {r:.3f}" for name, r in others["r"].head(4).items())
            yield {
                "claim": claim,
                "said": said,
                "impacts": table["impacts"].sum(),
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
