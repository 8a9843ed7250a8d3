"""Agreement of two methods on the same impacts: their ratio, and the limits that hold it for most impacts.

Of each impact d = log(a / b) with its values a and b by two methods. The ratio is exp(mean d), and its 95 %
limits of agreement are exp(mean d ± 1.96 sd d) (Bland and Altman 1999, doi:10.1177/096228029900800204, who
take logs where differences grow with the size). They are of single impacts of people and conditions as
recorded: impacts of one person are not independent, so that other people may differ from them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from bayestissue.results.tables import table_of_rows

# Standard deviations of a normal about its mean that hold 95 % of it.
SD_OF_95_PERCENT = 1.96


def agreement(values: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """The thesis's method over the posterior: ``agreement.csv``.

    Args:
        values: of K and of C a row an impact, with the columns ``dds`` and ``posterior``. What is not above 0
            has no ratio, and is left out.

    Returns:
        ``ratio`` of the one over the other and its limits ``low`` and ``high``, for ``impacts`` of them.
    """
    rows = []
    for quantity, table in values.items():
        positive = table[((table > 0) & np.isfinite(table)).all(axis=1)]
        d = np.log(positive["dds"] / positive["posterior"])
        sd = float(d.std(ddof=1)) if len(d) > 1 else np.nan
        middle = float(d.mean()) if len(d) else np.nan
        ends = np.exp([middle, middle - SD_OF_95_PERCENT * sd, middle + SD_OF_95_PERCENT * sd])
        rows.append((quantity, "dds", "posterior", len(d), len(table) - len(d), *map(float, ends)))
    return table_of_rows("agreement", rows)
