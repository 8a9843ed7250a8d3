"""The audit: the program finds what does not hold together, and says why.

A check is a function that yields the numbers of everything it does not believe; ``inconsistencies.toml`` has
what is said of them.
"""

from __future__ import annotations

import pandas as pd

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.audit import people, plausibility, printed, reasoning
from bayestissue.thesis.audit.inconsistencies import (
    AuditedImpacts,
    Check,
    Publication,
    as_table,
    findings,
    published_impacts,
)

# Of the estimates by themselves, and of the publication: its tables against each other and against its text.
CHECKS_OF_IMPACTS: tuple[Check[AuditedImpacts], ...] = (
    plausibility.constant_natural_frequency,
    plausibility.frequency_and_damping_on_one_curve,
    plausibility.equal_masses_at_other_energies,
    plausibility.frequency_of_the_window,
    plausibility.implied_penetration,
    plausibility.kinetic_energy,
    people.people_not_told_apart,
    people.damping_without_bounds,
    people.unequal_scatter,
    people.rows_that_stand_twice,
    people.estimates_in_two_trials,
)
CHECKS_OF_PUBLICATION: tuple[Check[Publication], ...] = (
    printed.claims_that_contradict,
    printed.arithmetic_of_claims,
    printed.figures_that_do_not_follow,
    printed.masses_behind_the_regression,
    printed.impossible_spread,
    reasoning.r_squared_of_averages,
    reasoning.not_significant_after_all,
    reasoning.not_the_only_one,
    reasoning.correlation_with_a_sum,
    reasoning.personal_factors_of_averages,
    reasoning.sign_of_a_personal_factor,
)


def audit_published(published: PublishedTables) -> pd.DataFrame:
    """What does not hold together in the published tables and the text about them, worst first.

    Returns:
        columns where, what, published, implied, severity ("major", "minor", "note") and explanation.
    """
    names = published.estimates["table"].unique()
    of_impacts = findings(
        CHECKS_OF_IMPACTS, published_impacts(published), f"Tables {names[0]} to {names[-1]}"
    )
    return as_table([*of_impacts, *findings(CHECKS_OF_PUBLICATION, Publication(published))])
