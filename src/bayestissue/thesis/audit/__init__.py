"""The audit: the program finds what does not hold together, and says why.

A check is a function that yields the numbers of everything it does not believe; ``findings.toml`` has what is
said of them. It is registered with ``@GENERAL.check`` if it needs no more than a table of estimates, with
``@PUBLISHED.check`` if it is about a publication, in a module that is imported below.
"""

from __future__ import annotations

import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.audit import (  # noqa: F401 - importing a module registers its checks
    estimates,
    people,
    printed,
    reasoning,
)
from bayestissue.thesis.audit.findings import (
    GENERAL,
    PUBLISHED,
    as_table,
    read_impacts,
    read_publication,
    thickness,
)
from bayestissue.thesis.reproduction.agreement import decimals

__all__ = ["GENERAL", "PUBLISHED", "audit_estimates", "audit_published"]


def audit_estimates(frame: pd.DataFrame) -> pd.DataFrame:
    """What does not hold together in a table of estimates, worst first.

    Args:
        frame: one row per impact: subject, trial, mass_kg, velocity_m_s, K (N/m; or K_N_per_m) and
            C (N s/m; or C_N_s_per_m); optional energy_J, peak_displacement_m, time_to_peak_s. The
            `estimates.csv` of a run of the program will do.

    Returns:
        columns where, what, published, implied, severity ("major", "minor", "note") and explanation.

    Raises:
        InputError: a column is missing, or fewer than two rows are usable.
    """
    return as_table(GENERAL.run(read_impacts(frame)))


def audit_published(published: PublishedTables) -> pd.DataFrame:
    """What does not hold together in the published tables and the text about them, worst first.

    Returns:
        columns as `audit_estimates`.
    """
    names = list(published.estimates["table"].unique())
    impacts = read_impacts(
        published.estimates,
        conditions=published.averages.drop_duplicates("trial").set_index("trial"),
        where=f"Tables {names[0]} to {names[-1]}" if len(names) > 1 else f"Table {names[0]}",
        tissue_m=thickness(published.claims)[0] or None,
        digits=int(published.estimates["K_text"].map(decimals).max()),
    )
    return as_table([*GENERAL.run(impacts), *PUBLISHED.run(read_publication(published))])
