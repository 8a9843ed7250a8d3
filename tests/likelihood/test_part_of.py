from __future__ import annotations

import jax
import numpy as np

from bayestissue.model.likelihood.linear_errors import part_of

DRAWS = 40_000


def test_one_of_two_errors_given_their_sum_is_that_of_the_joint_normal() -> None:
    """Against regression on draws of both: the velocity's own 0.005 m/s beside a gain of 2 % of 1.5 m/s."""
    own, gain = 0.005, 0.03
    rng = np.random.default_rng(5)
    velocity, other = own * rng.standard_normal(DRAWS), gain * rng.standard_normal(DRAWS)
    together = velocity + other
    sd, share = np.hypot(own, gain), own**2 / (own**2 + gain**2)
    drawn = np.asarray(part_of(together, np.full(DRAWS, sd), np.full(DRAWS, share), jax.random.PRNGKey(1)))
    # Of 40,000 draws a standard deviation has a standard error of 0.35 %, a covariance one of 0.5 %.
    assert abs(drawn.std() / own - 1) < 4 * 0.0035
    assert abs(np.cov(drawn, together)[0, 1] / own**2 - 1) < 4 * sd / own / np.sqrt(DRAWS)
