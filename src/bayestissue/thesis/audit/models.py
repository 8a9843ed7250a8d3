"""The regression equations, the list of variables and the part of the design that was used."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayestissue.thesis.audit.findings import PUBLISHED, Finding, Publication, named_rows, thickness
from bayestissue.thesis.reproduction.conditions import QUANTITIES, conditions, factors
from bayestissue.thesis.reproduction.correlations import correlation_of_impacts


@PUBLISHED.check(
    severity="minor",
    bearing="conclusions",
    reason="it makes an equation for averages of ten look like one for an impact",
)
def r_squared_of_averages(publication: Publication) -> Iterator[Finding]:
    """R² of a fit to averages, given as if it held for single impacts."""
    for quantity in QUANTITIES:
        terms = publication.tables.regressions.query("quantity == @quantity")
        table = conditions(publication.tables, quantity)
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


@PUBLISHED.check(
    severity="note",
    bearing="conclusions",
    reason="the masses used stay above it",
)
def negative_damping(publication: Publication) -> Iterator[Finding]:
    """An equation that gives a negative constant for a small mass."""
    for quantity in QUANTITIES:
        terms = publication.tables.regressions.query("quantity == @quantity")
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


_NEEDLE_M = 0.016
"""The shortest needle recommended for injections into the deltoid of an adult (of less than 60 kg).

Immunization guidelines of the U.S. Centers for Disease Control and Prevention; it is to end in muscle.
"""


@PUBLISHED.check(
    severity="minor",
    bearing="inputs",
    reason="the thickness enters the argument on the wall of bone and the regression on skin folds",
)
def thickness_of_the_deltoid(publication: Publication) -> Iterator[Finding]:
    """Skin and muscle of the shoulder too thin to take an injection."""
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


@PUBLISHED.check(
    severity="note",
    bearing="method",
    reason="a variable listed twice counts twice and can't enter twice",
)
def one_variable_under_two_names(publication: Publication) -> Iterator[Finding]:
    """Energy × velocity and velocity × energy."""
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


@PUBLISHED.check(
    severity="note",
    bearing="method",
    reason="what was offered decides what could be found",
)
def variables_offered(publication: Publication) -> Iterator[Finding]:
    """The number of variables that the stepwise analysis is said to have had, against its table."""
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


@PUBLISHED.check(
    severity="note",
    bearing="method",
    reason="it says how far the results reach",
)
def part_of_the_design(publication: Publication) -> Iterator[Finding]:
    """Numbers of the trials that betray a third factor with one level used.

    In a full design of 3 energies × 3 sizes × 3 velocities, numbered with velocity fastest, trial t has
    energy level ⌊(t − 1)/9⌋, size level ⌊(t − 1)/3⌋ mod 3 and velocity level (t − 1) mod 3.
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
