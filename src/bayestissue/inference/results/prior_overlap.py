"""How much of a posterior its prior had already: the overlap of the two.

    overlap = integral of min(p(theta | data), p(theta))

It is 1 where the data say nothing and 0 where they leave nothing of the prior (Garrett and Zeger 2000,
doi:10.1111/j.0006-341X.2000.01055.x, who compare parameters of weak models so), and the same on any scale of
theta. Of a normal posterior in the middle of a normal prior, a half is a standard deviation of a third of the
prior's.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Above it more than half of what is said of a quantity was said before the data.
MOSTLY = 0.5
_BINS = 20


def prior_overlap(posterior: Float[np.ndarray, "*draw"], prior: Float[np.ndarray, "*prior_draw"]) -> float:
    """The overlap by draws of both, in bins that have equal shares of the posterior.

    Bins see it a little too large; the scatter of n prior draws in b bins, by about (b / n)^1/2 / 4, too
    small. Infinite draws count as greatest. NaN where the posterior is one number.
    """
    ends = np.quantile(posterior, np.linspace(0, 1, _BINS + 1)[1:-1], method="higher")
    if ends[0] == ends[-1]:
        return np.nan
    shares = (
        np.bincount(np.searchsorted(ends, np.ravel(draws)), minlength=_BINS) / np.size(draws)
        for draws in (posterior, prior)
    )
    return float(np.minimum(*shares).sum())
