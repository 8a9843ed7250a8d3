"""What the text concludes, from correlations, regressions and the design, against the tables."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pandas as pd

from bayestissue.thesis.audit.findings import PUBLISHED, Numbers, Publication, named_rows, thickness
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


@PUBLISHED.check
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


@PUBLISHED.check
def negative_damping(publication: Publication) -> Iterator[Numbers]:
    """An equation that gives a negative constant for a small mass.

    Note: the masses used stay above it.
    """
    for quantity in QUANTITIES:
        terms, _ = publication.equation(quantity)
        coefficient = terms.set_index("term")["coefficient"]
        if not {"constant", "Mass"} <= set(coefficient.index) or coefficient["constant"] >= 0:
            continue
        root = -coefficient["constant"] / coefficient["Mass"]
        share = root / publication.tables.averages["mass_kg"].min()
        yield {"quantity": quantity, "coefficient": coefficient, "root": root, "share": share}


@PUBLISHED.check
def thickness_of_the_deltoid(publication: Publication) -> Iterator[Numbers]:
    """Skin and muscle of the shoulder too thin to take an injection.

    Minor: the thickness enters the argument on the wall of bone and the regression on skin folds.
    """
    thickest, layers = thickness(publication.tables.claims)
    if not layers.empty and thickest < _NEEDLE_M:
        words = " and ".join(f"up to {text} mm" for text in layers["value_text"])
        sizes = {"needle_mm": 1000 * _NEEDLE_M, "thickest_mm": 1000 * thickest}
        yield {"section": layers["section"].iloc[0], "layers": words, **sizes}


@PUBLISHED.check
def one_variable_under_two_names(publication: Publication) -> Iterator[Numbers]:
    """Energy × velocity and velocity × energy.

    Note: a variable listed twice counts twice and can't enter twice.
    """
    for frame in (publication.tables.correlations, publication.tables.stepwise):
        for _, rows in frame.groupby(["table", "quantity"], sort=False):
            keys = rows["variable"].map(factors)
            twice = " and ".join(rows.loc[keys.duplicated(keep=False), "variable"])
            if twice:
                counts = {"names": len(rows), "different": keys.nunique()}
                yield {"row": rows.iloc[0], "twice": twice, **counts}


@PUBLISHED.check
def variables_offered(publication: Publication) -> Iterator[Numbers]:
    """The number of variables that the stepwise analysis is said to have had, against its table.

    Note: what was offered decides what could be found.
    """
    claims = publication.claims("design", "number of variables available to the stepwise analysis")
    stepwise = publication.tables.stepwise
    listed = stepwise["variable"].map(factors).groupby(stepwise["quantity"], sort=False).agg(set)
    counts, different, missing = [], [], []
    for quantity, names in listed.items():
        counts.append(f"{len(names)} for {quantity}")
        different.append(f"{len(names)} different ones for {quantity}")
        if lacking := sorted(" × ".join(key) for key in set().union(*listed) - names):
            missing.append(f"{', '.join(lacking)} is missing for {quantity}")
    words = {"counts": ", ".join(counts), "different": ", ".join(different)}
    words["missing"] = f" ({'; '.join(missing)})" if missing else ""
    for claim in named_rows(claims):
        if set(listed.map(len)) != {claim.value}:
            yield {"claim": claim, "table": stepwise["table"].iloc[0], **words}


@PUBLISHED.check
def part_of_the_design(publication: Publication) -> Iterator[Numbers]:
    """Numbers of the trials that betray a third factor with one level used.

    In a full design of 3 energies × 3 sizes × 3 velocities, numbered with velocity fastest, trial t has
    energy level ⌊(t − 1)/9⌋, size level ⌊(t − 1)/3⌋ mod 3 and velocity level (t − 1) mod 3.

    Note: it says how far the results reach.
    """
    trials = publication.tables.averages.drop_duplicates("trial").set_index("trial")
    number = trials.index.to_numpy() - 1
    energy, velocity = (
        trials[name].rank(method="dense").to_numpy() - 1 for name in ("energy_J", "velocity_m_s")
    )
    size = number // 3 % 3
    fits = (number // 9 == energy).all() and (number % 3 == velocity).all() and len(set(size)) == 1
    if len(number) == 9 and fits:
        numbers = ", ".join(map(str, trials.index))
        yield {"numbers": numbers, "level": size[0] + 1, "count": len(number)}


@PUBLISHED.check
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


@PUBLISHED.check
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


@PUBLISHED.check
def highest_correlations(publication: Publication) -> Iterator[Numbers]:
    """Mass said to be in each of the n highest correlations.

    Note: mass stays the strongest; only the count is wrong.
    """
    claims = publication.tables.claims
    for claim in named_rows(claims[claims["statistic"] == "highest correlations with mass as a component"]):
        count = int(claim.value)
        for table, rows in _correlation_tables(publication, claim.quantity):
            top = rows.abs().sort_values(ascending=False).head(count)
            without = [f"{name} ({rows[name]:.3f})" for name in top.index if not has_mass(name)]
            if without:
                counts = {"count": count, "with_mass": count - len(without)}
                yield {"claim": claim, "table": table, "without": ", ".join(without), **counts}


@PUBLISHED.check
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


@PUBLISHED.check
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


@PUBLISHED.check
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
        squares = between_sum_of_squares(table) + within_sum_of_squares(table)
        total = float(np.sqrt(squares / (table["impacts"].sum() - 1)))
        yield {"row": row, "r": r, "needed": abs(r["correlation"]) * total / abs(row.coefficient)}


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
