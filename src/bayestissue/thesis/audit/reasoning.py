"""What the text concludes, from correlations, regressions and the design, against the tables."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pandas as pd

from bayestissue.thesis.audit.findings import PUBLISHED, Finding, Publication, named_rows, thickness
from bayestissue.thesis.reproduction.conditions import (
    QUANTITIES,
    Quantity,
    between_sum_of_squares,
    conditions,
    factors,
    has_mass,
    within_sum_of_squares,
)
from bayestissue.thesis.reproduction.relations import (
    ALPHA,
    correlation_of_impacts,
    correlations_of_impacts,
    p_value,
)

_ALL_IMPACTS = "5.12"
_ONLY = re.compile(r"\bonly\b.*\bstatistically significant")
# The shortest needle recommended for injections into the deltoid of an adult (of less than 60 kg), which is
# to end in muscle: immunization guidelines of the U.S. Centers for Disease Control and Prevention.
_NEEDLE_M = 0.016


@PUBLISHED.check("minor", "conclusions")
def r_squared_of_averages(publication: Publication) -> Iterator[Finding]:
    """R² of a fit to averages, given as if it held for single impacts.

    Minor: it makes an equation for averages of ten look like one for an impact.
    """
    for quantity in QUANTITIES:
        terms, table = publication.equation(quantity)
        r = correlation_of_impacts("Mass", table).value
        printed = terms.iloc[0]
        if r is None or abs(printed["r_squared"] - r**2) < 0.05:
            continue
        averages = float(np.corrcoef(table["mass_kg"], table["average"])[0, 1])
        yield Finding(
            "section 5.4",
            f"R² of the equation of {quantity}",
            printed["r_squared_text"],
            f"{r**2:.2f} for single impacts",
            f"R² = {printed['r_squared_text']} for {quantity} is that of the {len(table)} trial averages "
            f"(where r² = {averages**2:.2f}); of the variance between single impacts mass explains "
            f"{r**2:.0%} (r = {r:.3f}), so the equation predicts averages of "
            f"{table['impacts'].iloc[0]:.0f} people and not an impact.",
        )


@PUBLISHED.check("note", "conclusions")
def negative_damping(publication: Publication) -> Iterator[Finding]:
    """An equation that gives a negative constant for a small mass.

    Note: the masses used stay above it.
    """
    for quantity in QUANTITIES:
        terms, _ = publication.equation(quantity)
        coefficient = terms.set_index("term")["coefficient"]
        if not {"constant", "Mass"} <= set(coefficient.index) or coefficient["constant"] >= 0:
            continue
        root = -coefficient["constant"] / coefficient["Mass"]
        lightest = publication.tables.averages["mass_kg"].min()
        yield Finding(
            "section 5.4",
            f"equation of {quantity} at small masses",
            f"{quantity} = {coefficient['constant']:g} + {coefficient['Mass']:g} M",
            f"below zero for M < {root:.2f} kg",
            f"The equation makes {quantity} negative below {root:.2f} kg, {root / lightest:.0%} of the "
            "lightest mass used; a straight line in mass can't be the law of a damper.",
        )


@PUBLISHED.check("minor", "inputs")
def thickness_of_the_deltoid(publication: Publication) -> Iterator[Finding]:
    """Skin and muscle of the shoulder too thin to take an injection.

    Minor: the thickness enters the argument on the wall of bone and the regression on skin folds.
    """
    thickest, layers = thickness(publication.tables.claims)
    if layers.empty or thickest >= _NEEDLE_M:
        return
    yield Finding(
        f"section {layers['section'].iloc[0]}",
        "thickness of skin and muscle",
        " and ".join(f"up to {text} mm" for text in layers["value_text"]),
        f"more than {_NEEDLE_M * 1000:.0f} mm",
        f"Skin and muscle of the thickest shoulder are given as {thickest * 1000:g} mm together; even the "
        f"shortest needle recommended for injections into an adult's deltoid, {_NEEDLE_M * 1000:.0f} mm, "
        "would end in bone. The figures may be centimetres.",
    )


@PUBLISHED.check("note", "method")
def one_variable_under_two_names(publication: Publication) -> Iterator[Finding]:
    """Energy × velocity and velocity × energy.

    Note: a variable listed twice counts twice and can't enter twice.
    """
    for frame in (publication.tables.correlations, publication.tables.stepwise):
        for (table, quantity), rows in frame.groupby(["table", "quantity"], sort=False):
            keys = rows["variable"].map(factors)
            twice = rows.loc[keys.duplicated(keep=False), "variable"]
            if twice.empty:
                continue
            yield Finding(
                f"Table {table}",
                f"variables for {quantity}",
                f"{len(rows)} listed",
                f"{keys.nunique()} different",
                f"Table {table} lists {' and '.join(twice)} for {quantity} as two variables; they are the "
                f"same, so that {len(rows)} names stand for {keys.nunique()} variables.",
            )


@PUBLISHED.check("note", "method")
def variables_offered(publication: Publication) -> Iterator[Finding]:
    """The number of variables that the stepwise analysis is said to have had, against its table.

    Note: what was offered decides what could be found.
    """
    claims = publication.claims("design", "number of variables available to the stepwise analysis")
    for claim in named_rows(claims):
        listed = {
            str(quantity): set(rows["variable"].map(factors))
            for quantity, rows in publication.tables.stepwise.groupby("quantity", sort=False)
        }
        counts = {quantity: len(names) for quantity, names in listed.items()}
        if set(counts.values()) == {claim.value}:
            continue
        all_names = set().union(*listed.values())
        missing = {
            quantity: ", ".join(sorted(" × ".join(key) for key in all_names - names))
            for quantity, names in listed.items()
            if all_names - names
        }
        words = "; ".join(f"{names} is missing for {quantity}" for quantity, names in missing.items())
        yield Finding(
            f"section {claim.section}, Table {publication.tables.stepwise['table'].iloc[0]}",
            "variables offered to the stepwise regression",
            claim.value_text,
            ", ".join(f"{count} for {quantity}" for quantity, count in counts.items()),
            f"Section {claim.section} speaks of {claim.value_text} variables; the table has "
            f"{', '.join(f'{count} different ones for {quantity}' for quantity, count in counts.items())}"
            f"{f' ({words})' if words else ''}.",
        )


@PUBLISHED.check("note", "method")
def part_of_the_design(publication: Publication) -> Iterator[Finding]:
    """Numbers of the trials that betray a third factor with one level used.

    In a full design of 3 energies × 3 sizes × 3 velocities, numbered with velocity fastest, trial t has
    energy level ⌊(t − 1)/9⌋, size level ⌊(t − 1)/3⌋ mod 3 and velocity level (t − 1) mod 3.

    Note: it says how far the results reach.
    """
    trials = publication.tables.averages.drop_duplicates("trial").set_index("trial")
    number = trials.index.to_numpy() - 1
    energy = trials["energy_J"].rank(method="dense").to_numpy() - 1
    velocity = trials["velocity_m_s"].rank(method="dense").to_numpy() - 1
    size = number // 3 % 3
    if (
        len(number) != 9
        or (number // 9 != energy).any()
        or (number % 3 != velocity).any()
        or len(set(size)) > 1
    ):
        return
    yield Finding(
        "Tables 5.10 and 5.11",
        "numbers of the trials",
        ", ".join(map(str, trials.index)),
        f"level {size[0] + 1} of 3 of a third factor",
        f"The trials are numbered {', '.join(map(str, trials.index))}: in a design of 27 with velocity "
        f"running fastest and energy slowest these are the {len(number)} cells with the third factor, the "
        f"size of the ball, at level {size[0] + 1}. One of the three sizes of section 2.1 was used, as "
        "section 8.1 says, and nothing here tells of the others.",
    )


@PUBLISHED.check("minor", "conclusions")
def not_significant_after_all(publication: Publication) -> Iterator[Finding]:
    """A correlation listed among the significant ones with a p-value that is not.

    Minor: the text draws a conclusion from it that the table beside it denies.
    """
    table = publication.tables.correlations.dropna(subset=["p_value"])
    for claim in named_rows(publication.tables.claims):
        name = claim.statistic.removeprefix("correlation with ")
        row = table[(table["quantity"] == claim.quantity) & (table["variable"] == name)]
        if "statistically significant" not in claim.sentence or row.empty:
            continue
        printed = row.iloc[0]
        if printed["p_value"] < ALPHA:
            continue
        weakest = table[(table["quantity"] == claim.quantity) & (table["p_value"] < ALPHA)]
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


@PUBLISHED.check("minor", "conclusions")
def not_the_only_one(publication: Publication) -> Iterator[Finding]:
    """A variable called the only significant one, while others are.

    Minor: the table that would show it is lost, but its content follows from the other tables.
    """
    for claim in named_rows(publication.tables.claims):
        said = claim.statistic.removeprefix("correlation with ")
        if said == claim.statistic or not _ONLY.search(claim.sentence):
            continue
        recomputed = _recomputed(publication, claim.quantity)
        others = recomputed[(recomputed["p"] < ALPHA) & (recomputed.index != said)]
        if others.empty:
            continue
        words = ", ".join(f"{name} {row['r']:.3f}" for name, row in others.head(4).iterrows())
        count = int(conditions(publication.tables, claim.quantity)["impacts"].sum())
        yield Finding(
            f"section {claim.section}",
            f"variables significant for {claim.quantity}",
            f"{said} only",
            f"{len(others) + 1} of {len(recomputed)}",
            f"Section {claim.section} calls {said} the only variable significantly correlated with "
            f"{claim.quantity}. From the averages and standard deviations of the trials {len(others)} more "
            f"of {len(recomputed)} variables are significant among all "
            f"{count} impacts ({words}; "
            f"the largest p is {others['p'].max():.1g}).",
        )


@PUBLISHED.check("note", "conclusions")
def highest_correlations(publication: Publication) -> Iterator[Finding]:
    """Mass said to be in each of the n highest correlations.

    Note: mass stays the strongest; only the count is wrong.
    """
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


@PUBLISHED.check("minor", "tables")
def correlation_with_a_sum(publication: Publication) -> Iterator[Finding]:
    """Cor(y, a + b) can't be nearer to zero than both cor(y, a) and cor(y, b), if these have one sign.

    The standard deviation of a sum is at most the sum of the standard deviations, so the correlation with
    a + b is at least a weighted mean of the two.

    Minor: no data whatever have these three correlations.
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


@PUBLISHED.check("minor", "conclusions")
def personal_factors_of_averages(publication: Publication) -> Iterator[Finding]:
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


@PUBLISHED.check("minor", "conclusions")
def sign_of_a_personal_factor(publication: Publication) -> Iterator[Finding]:
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
        r = listed.iloc[0]
        table = conditions(tables, row.quantity)
        squares = between_sum_of_squares(table) + within_sum_of_squares(table)
        total = float(np.sqrt(squares / (table["impacts"].sum() - 1)))
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
    r = pd.Series(correlations_of_impacts(publication.tables, table), dtype="float64")
    count = float(table["impacts"].sum())
    frame = pd.DataFrame({"r": r, "p": [p_value(value, count) for value in r]})
    return frame.loc[r.abs().sort_values(ascending=False).index]


def _correlation_tables(publication: Publication, quantity: Quantity) -> Iterator[tuple[str, pd.Series]]:
    printed = publication.tables.correlations.query("quantity == @quantity")
    for table, rows in printed.groupby("table", sort=False):
        yield f"Table {table}", rows.drop_duplicates("variable").set_index("variable")["correlation"]
    if _ALL_IMPACTS not in set(printed["table"]):
        yield "the recomputed Table 5.13", _recomputed(publication, quantity)["r"]
