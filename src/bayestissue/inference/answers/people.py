"""Person against person: the probability that one is stiffer, or damps more, than another.

Of persons A and B it is the share of draws with log q(A) > log q(B) at the reference mass, each with what is
the person's own in all impacts, such as sex, and without what is chosen, such as the condition.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.hierarchy.formulas.formula import group_terms
from bayestissue.hierarchy.formulas.group_terms import SUBJECT
from bayestissue.hierarchy.levels import Recorded, log_at_levels

COLUMNS = ["quantity", "person", "against", "p_greater", "ratio", "low", "high"]
MOST_PEOPLE = 60


def people_compared(draws: xr.Dataset, recorded: Recorded, responses: Sequence[str]) -> pd.DataFrame:
    """Each person against each other: `COLUMNS`, two rows a pair; none of more than `MOST_PEOPLE`.

    Args:
        draws: the group posterior.
        recorded: what was measured.
        responses: K, C and the further parameters that have a formula; those with an effect of the person
            are compared.

    Returns:
        ``p_greater`` is the probability that the person's is greater, ``ratio`` the posterior median of the
        person's over the other's, ``low`` and ``high`` the ends of its 90 % interval.
    """
    people = recorded.levels("subject")
    first, second = np.triu_indices(len(people), 1)
    tables = []
    for response in responses:
        if SUBJECT not in group_terms(recorded.formulas.get(response)) or not 2 <= len(people) <= MOST_PEOPLE:
            continue
        logs = log_at_levels(draws, recorded, response, [{"subject": name} for name in people])
        logs = logs.reshape(-1, len(people))
        ratio = logs[:, first] - logs[:, second]
        low, median, high = np.exp(np.percentile(ratio, [5, 50, 95], axis=0))
        above = (ratio > 0).mean(axis=0)
        for one, another, values in (
            (first, second, (above, median, low, high)),
            (second, first, (1 - above, 1 / median, 1 / high, 1 / low)),
        ):
            names = {"person": np.array(people)[one], "against": np.array(people)[another]}
            table = {"quantity": response} | names | dict(zip(COLUMNS[3:], values, strict=True))
            tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=COLUMNS)
