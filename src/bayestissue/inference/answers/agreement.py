"""Agreement of methods on the same impacts: their ratio, and the limits that hold it for most impacts.

Of each impact d = log(a / b) with its values a and b by two methods. The ratio is exp(mean d), and its 95 %
limits of agreement are exp(mean d ± 1.96 sd d) (Bland and Altman 1999, doi:10.1177/096228029900800204, who
take logs where differences grow with the size). They are of single impacts of people and conditions as
recorded: impacts of one person are not independent, so that other people may differ from them.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pandas as pd

from bayestissue.results.tables import table_of_rows

METHODS = {"dds": "thesis's method", "exact": "exact point fit", "posterior": "posterior median"}
# Standard deviations of a normal about its mean that hold 95 % of it.
SD_OF_95_PERCENT = 1.96


def agreement(values: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Each method against each later one, a row each: ``agreement.csv``.

    Args:
        values: of K and of C a row an impact, with a column for each of `METHODS`. What is not above 0 has no
            ratio, and is left out.

    Returns:
        ``ratio`` of ``method`` over ``against`` and its limits ``low`` and ``high``, for ``impacts`` of them.
    """
    rows = []
    for quantity, table in values.items():
        for method, against in combinations(METHODS, 2):
            d = log_ratios(table, method, against)
            sd = float(d.std(ddof=1)) if len(d) > 1 else np.nan
            middle = float(d.mean()) if len(d) else np.nan
            ends = np.exp([middle, middle - SD_OF_95_PERCENT * sd, middle + SD_OF_95_PERCENT * sd])
            rows.append((quantity, method, against, len(d), len(table) - len(d), *map(float, ends)))
    return table_of_rows("agreement", rows)


def log_ratios(table: pd.DataFrame, method: str, against: str) -> pd.Series:
    """The log of one method's value over another's, of the impacts that have both."""
    positive = table[[method, against]]
    positive = positive[(positive > 0).all(axis=1) & np.isfinite(positive).all(axis=1)]
    return pd.Series(np.log(positive[method] / positive[against]), positive.index)
