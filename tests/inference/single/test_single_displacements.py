"""Each displacement by itself: against direct integration, the truth, and what the table promises."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from by_grid import quantiles_by_grid

import bayestissue as bt
from bayestissue.base.resources import shared
from bayestissue.inference.points.notes import UNTOLD
from bayestissue.inference.single.impact_posterior import single_posteriors
from bayestissue.mechanics.oscillator import (
    impact_motion,
    spring_damper_inverse,
    time_to_peak,
    to_differences,
)
from bayestissue.model.hierarchy.specification import Formulas, read_specification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.model.likelihood.arma21 import arma21_series
from bayestissue.recordings.dataset import Dataset
from campaigns import COLUMNS, holds

pytestmark = pytest.mark.slow

COUNT, MASS, VELOCITY, DT = 200, 0.7, 1.5, 5e-4
# Of the longest recording.
WIDTH = 128


def tissues() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    return 3000 * np.exp(0.2 * random.normal(size=COUNT)), 25 * np.exp(0.2 * random.normal(size=COUNT))


@partial(jax.jit, static_argnames="width")
def driven(omega_n: jax.Array, zeta: jax.Array, share: float, width: int) -> jax.Array:
    """Displacements that shocks drive, ``share`` of the peak deceleration times the interval squared."""
    motion = impact_motion(DT * jnp.arange(width), omega_n[:, None], zeta[:, None], VELOCITY)
    sigma = share * motion.deceleration.max(1) * DT**2
    shocks = sigma * jax.random.normal(jax.random.key(1), (width + 1, len(omega_n)))
    return arma21_series(motion.displacement[:, :2], shocks[2:], *to_differences(omega_n, zeta, DT))


def recorded(share: float) -> Dataset:
    """To 1.3 times the time to peak, with the noise that an ARMA(2,1) assumes."""
    omega_n, zeta = (np.asarray(part) for part in spring_damper_inverse(*tissues(), MASS))
    lengths = np.floor(1.3 * np.asarray(time_to_peak(omega_n, zeta)) / DT).astype(int) + 1
    x = np.asarray(driven(omega_n, zeta, share, WIDTH))
    impacts = pd.DataFrame({"impact": [f"i{i}" for i in range(COUNT)], "subject": "s", "trial": "t"})
    impacts = impacts.assign(mass_kg=MASS, velocity_m_s=VELOCITY)
    traces = [(DT * np.arange(n), row[:n]) for row, n in zip(x, lengths, strict=True)]
    return bt.dataset(impacts, traces, quantity="displacement", unit="m")


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return bt.estimate(recorded(0.005))


def test_nine_in_ten_intervals_hold_the_truth(table: pd.DataFrame) -> None:
    truth = pd.DataFrame(dict(zip(COLUMNS.values(), tissues(), strict=True)))
    holds(table, truth)
    assert (np.abs(table[[*truth]] / truth - 1).median() < 0.02).all()


def test_what_a_displacement_does_not_tell_is_empty_and_noted() -> None:
    table = bt.estimate(recorded(0.5))
    untold = table["C_N_s_per_m"].isna()
    assert untold.any()
    assert (table.loc[untold, "C_low_N_s_per_m"] == 0).all()
    assert np.isfinite(table["C_high_N_s_per_m"]).all()
    assert (table["flags"] == "").all()
    assert table.loc[untold, "notes"].str.contains(UNTOLD["C"]).all()


def test_medians_and_intervals_are_those_of_direct_integration() -> None:
    """Over a grid of log K, log C, log noise and artanh theta1."""
    specification = read_specification(shared("models", "arma.toml"))
    alone = specification.model_copy(update={"formula": Formulas(K="1", C="1")})
    case = prepare(recorded(0.02).select(slice(1)), alone, source="test")
    found = single_posteriors(case)
    of_tissue = (found.quantities[name] for name in "KC")
    reach = [*(6 * np.log1p(one["sd"][0] / one["median"][0]) for one in of_tissue), 0.7, 2.0]
    for name, expected in quantiles_by_grid(case, found.parameters[0], reach, 25).items():
        *ends, sd = (found.quantities[name][which][0] for which in ("low", "median", "high", "sd"))
        np.testing.assert_allclose(ends, expected, atol=0.15 * sd)
