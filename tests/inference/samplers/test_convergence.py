"""R-hat and effective sample sizes of many quantities at once, against ArviZ's of one after the other."""

from __future__ import annotations

import arviz as az
import numpy as np
import pytest
import xarray as xr

from bayestissue.inference.samplers.sampling import TAILS, convergence, effective_size, elements_of

pytestmark = pytest.mark.slow


def draws(chains: int, length: int) -> np.ndarray:
    """Quantities that differ in how the chains moved, more of them than are worked on at once."""
    rng = np.random.default_rng(0)
    made = rng.standard_normal((80, chains, length))
    for place, correlation in enumerate((-0.95, -0.5, 0.3, 0.9, 0.99)):
        for t in range(1, length):
            made[place, :, t] += correlation * made[place, :, t - 1]
    made[5] = np.cumsum(made[5], axis=-1)
    made[6] = np.round(made[6], 1)
    made[7] = np.repeat(made[7], 5, axis=-1)[:, :length]
    made[8, 0] += 3.0
    made[9] = 1.0
    made[10, 0, -1] = np.nan
    return made


@pytest.mark.parametrize(("chains", "length"), [(4, 1000), (4, 501), (1, 100), (2, 5), (3, 4), (4, 3)])
def test_every_number_is_arviz_s_of_the_quantity_alone(chains: int, length: int) -> None:
    made = draws(chains, length)
    array = xr.DataArray(np.moveaxis(made, 0, 2), dims=("chain", "draw", "quantity"))
    found = convergence(elements_of(array))
    # ArviZ divides by the variance of what is the same in every draw.
    with np.errstate(invalid="ignore", divide="ignore"):
        expected = {
            "r_hat": az.rhat(array),
            "ess_bulk": az.ess(array, method="bulk"),
            "ess_tail": az.ess(array, method="tail", prob=TAILS),
            "ess_mean": az.ess(array, method="mean"),
        }
    for name, values in expected.items():
        # Sums of thousands of draws in another order.
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-10, err_msg=name)
    np.testing.assert_array_equal(effective_size(made), found.ess_mean)
