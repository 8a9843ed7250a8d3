from __future__ import annotations

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from bayestissue.cli import main
from bayestissue.dataset import write_dataset
from bayestissue.inference.points.estimates import interval
from bayestissue.inference.points.fit import PointFit, fit_points
from bayestissue.likelihood.arma.arma21 import arma21_series
from bayestissue.oscillator import impact_motion, spring_damper_inverse, time_to_peak, to_differences

COUNT, MASS, VELOCITY, DT = 500, 0.7, 1.5, 1e-4
# Of the longest recording.
WIDTH = 640
# A share of nine in ten among 500, give or take: three binomial standard errors.
TOLERANCE = 3 * np.sqrt(0.09 / COUNT)


def tissues() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    return 3000 * np.exp(0.2 * random.normal(size=COUNT)), 25 * np.exp(0.2 * random.normal(size=COUNT))


def driven(K: np.ndarray, C: np.ndarray, sigma: float | None, past: float = 1.0) -> tuple:
    """Displacements that shocks drive as the fit assumes, and their lengths, to ``past`` times to peak.

    Without ``sigma`` the shocks are 0.5 % of the peak deceleration, times the interval squared.
    """
    omega_n, zeta = map(np.asarray, spring_damper_inverse(K, C, MASS))
    n = np.floor(past * np.asarray(time_to_peak(omega_n, zeta)) / DT).astype(int) + 1
    return np.asarray(_driven(omega_n, zeta, n, sigma, WIDTH))[:, : n.max()], n


@partial(jax.jit, static_argnames="width")
def _driven(omega_n: jax.Array, zeta: jax.Array, n: jax.Array, sigma: float | None, width: int) -> jax.Array:
    motion = impact_motion(DT * jnp.arange(width), omega_n[:, None], zeta[:, None], VELOCITY)
    if sigma is None:
        sigma = 0.005 * motion.deceleration.max(1) * DT**2
    shocks = sigma * jax.random.normal(jax.random.key(1), (width + 1, len(n)))
    x = arma21_series(motion.displacement[:, :2], shocks[2:], *to_differences(omega_n, zeta, DT))
    return jnp.where(jnp.arange(width) < n[:, None], x, 0.0)


def written(folder: Path, K: np.ndarray, C: np.ndarray) -> None:
    """A dataset of recorded displacements whose noise is the one that `estimate` assumes."""
    x, n = driven(K, C, None, past=1.3)
    inside = np.arange(x.shape[1]) < n[:, None]
    row, sample = np.nonzero(inside)
    names = np.array([f"i{i}" for i in range(COUNT)])
    write_dataset(
        folder,
        settings={"name": "as assumed", "signal": {"quantity": "displacement", "unit": "m"}},
        impacts=pd.DataFrame(
            {"impact": names, "subject": "s", "trial": "t", "mass_kg": MASS, "velocity_m_s": VELOCITY}
        ),
        traces=pd.DataFrame({"impact": names[row], "time_s": sample * DT, "value": x[inside]}),
        trace_file="traces.parquet",
    )


@pytest.mark.slow
def test_nine_in_ten_intervals_of_the_table_hold_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    K, C = tissues()
    written(tmp_path / "data", K, C)
    command = ["bayestissue", "estimate", str(tmp_path / "data"), "--out", str(tmp_path / "out"), "--quiet"]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert not stopped.value.code
    table = pd.read_csv(tmp_path / "out" / "estimates.csv")
    assert np.median(np.abs(table["K_N_per_m"] / K - 1)) < 0.01
    for name, truth in (("K_{}_N_per_m", K), ("C_{}_N_s_per_m", C)):
        held = (table[name.format("low")] <= truth) & (truth <= table[name.format("high")])
        assert held.mean() == pytest.approx(0.9, abs=TOLERANCE)


def fitted(sigma: float) -> tuple[PointFit, np.ndarray, np.ndarray, np.ndarray]:
    K, C = tissues()
    x, n = driven(K, C, sigma)
    return fit_points(x, n, np.full(COUNT, DT), np.full(COUNT, MASS)), n, K, C


@pytest.mark.slow
def test_noise_too_large_for_an_estimate_still_leaves_an_interval() -> None:
    fit, n, K, C = fitted(2e-6)
    lost = np.isnan(fit.K)
    assert lost.any()
    assert (fit.K_signed[lost] < 0).all()
    np.testing.assert_allclose(fit.K_signed[~lost], fit.K[~lost], rtol=1e-12)
    np.testing.assert_allclose(fit.C_signed[~lost], fit.C[~lost], rtol=1e-9)
    for estimate, error, truth in ((fit.K_signed, fit.K_se, K), (fit.C_signed, fit.C_se, C)):
        low, high = interval(estimate, error, n)
        assert not (low < 0).any()
        assert np.mean((low <= truth) & (truth <= high)) == pytest.approx(0.9, abs=TOLERANCE)


def test_what_lies_around_no_stiffness_changes_smoothly() -> None:
    # the coefficient c2, nearly K, is carried through zero by a steady push on the data
    K, C = tissues()
    x, n = driven(K[:1], C[:1], 1e-9)
    push = np.linspace(0, 1.6, 9)[:, None] * (np.arange(x.shape[1]) * DT) ** 2 / 2 * K[0] / MASS * x.mean()
    fit = fit_points(x + push, np.full(9, n[0]), np.full(9, DT), np.full(9, MASS))
    assert fit.K_signed[0] > 0 > fit.K_signed[-1]
    steps = np.diff(fit.K_signed)
    assert (steps < 0).all()
    assert np.isfinite(fit.K_se).all()


def test_an_interval_is_cut_at_zero_and_needs_an_error_and_something_above_zero() -> None:
    estimates, errors = np.array([1.0, -1.0, -9.0, 5.0]), np.array([1.0, 1.0, 1.0, np.nan])
    low, high = interval(estimates, errors, np.full(4, 10_000))
    np.testing.assert_allclose(low, [0, 0, np.nan, np.nan])
    # Student's t with so many degrees of freedom is the normal distribution
    np.testing.assert_allclose(high, [1 + 1.645, -1 + 1.645, np.nan, np.nan], rtol=1e-3)
