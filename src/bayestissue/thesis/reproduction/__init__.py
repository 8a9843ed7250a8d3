"""The published results: every number of chapters 5 to 7 beside the recomputed one."""

from __future__ import annotations

import pandas as pd

from bayestissue.base.results.tables import table_of_rows
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.claims import claim_lines
from bayestissue.thesis.reproduction.conditions import summary_lines
from bayestissue.thesis.reproduction.relations import correlation_lines, regression_lines, stepwise_lines


def reproduce_published(published: PublishedTables) -> pd.DataFrame:
    """Recompute what chapters 5 to 7 print from what is left of their tables.

    Returns one row per printed number, with the columns of ``reproduction.csv``:
    ``table`` (or section) and ``row`` (in it; for a section, the number of the claim or of the term),
    ``quantity`` in words, ``published`` as printed (empty where the cell is lost), ``reproduced`` to eight
    digits (empty where it doesn't follow from what is left), ``agrees`` (boolean; missing where either is
    empty; true if rounding ``reproduced`` to the printed digits gives ``published``), and ``note``, which
    says what a disagreement is or why a number can't be derived.
    """
    lines = [
        *summary_lines(published),
        *correlation_lines(published),
        *stepwise_lines(published),
        *regression_lines(published),
        *claim_lines(published),
    ]
    return table_of_rows("reproduction", lines).astype({"row": "int64", "agrees": "boolean"})
