"""The likelihood of ringing after a tap, against integration and dense algebra."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayestissue.hierarchy.specification import read_specification
from bayestissue.hierarchy.trace_data import Prepared, prepare
from bayestissue.likelihood.tapped.measured import CLOCK, IMPULSE, ZERO, MeasuredTap, TapRecord
from bayestissue.oscillator import spring_damper_inverse
from bayestissue.resources import shared
from bayestissue.simulation import Simulation, simulate

K, MASSES = 4000.0, (0.8, 2.0)


def prepared_taps(zeta: float = 0.05, *, rate: float = 5000.0, **recording: Any) -> tuple[Prepared, Any]:
    """Two people's taps on two masses, and the truth."""
    content = {
        "name": "taps",
        "seed": 8,
        "design": {
            "subjects": 2,
            "conditions": [{"trial": f"{m:g} kg", "mass_kg": m, "impulse_N_s": 0.4} for m in MASSES],
        },
        "tissue": {"K_N_per_m": K, "C_N_s_per_m": 2 * zeta * np.sqrt(K), "reference_mass_kg": 1.0},
        "tap": {"duration_s": 0.006},
        "recording": {
            "sampling_rate_hz": rate,
            "force": {"place": "hammer", "noise_sd_N": 1e-9},
            **recording,
        },
    }
    made = simulate(Simulation.model_validate(content))
    specification = read_specification(shared("models", "tapped.toml"))
    return prepare(made.dataset("taps"), specification, source="tapped"), made.truth


def at_truth(prepared: Prepared, truth: Any, log_sigma: float = -3.0) -> MeasuredTap:
    """The likelihood at the true K, C and mass."""
    columns = ("K_N_per_m", "C_N_s_per_m", "mass_kg")
    known = spring_damper_inverse(*(truth[name].to_numpy() for name in columns))
    omega_n, zeta = (jnp.asarray(part) for part in known)
    ratio = jnp.asarray(np.log(truth["mass_kg"].to_numpy() / prepared.signal.mass))
    record = cast(TapRecord, prepared.data.record)
    return MeasuredTap(omega_n, zeta, jnp.full(len(truth), log_sigma), ratio, record)


@pytest.mark.parametrize("zeta", [0.01, 0.3, 0.999, 1.001])
@pytest.mark.parametrize("rate", [2_000.0, 20_000.0])
def test_the_ringing_is_that_of_the_simulation(zeta: float, rate: float) -> None:
    # Simulated in closed form by numpy alone: see `bayestissue.simulation.tap`.
    prepared, truth = prepared_taps(zeta, rate=rate, noise_sd_m_s2=1e-9)
    tap = at_truth(prepared, truth)
    left, record = np.asarray(tap.record.y - tap.expected()), tap.record
    of_impulse = np.asarray(record.error_sd)[:, IMPULSE, None] * np.abs(np.asarray(tap.columns())[IMPULSE])
    # The sum over the force's samples errs by the standard deviation that it is given, or less; the means of
    # rows by terms of fourth order in the sampling interval.
    step = np.asarray(tap.omega_n)[:, None] / rate
    size = np.abs(np.asarray(record.y)).max(axis=1, keepdims=True)
    middle = np.asarray(tap.columns())[CLOCK] * 0.1 / rate
    assert (
        np.abs(left) <= 1.5 * of_impulse.max(axis=1, keepdims=True) + step**4 * size + np.abs(middle)
    ).all()


def test_the_density_is_that_of_a_dense_normal() -> None:
    prepared, truth = prepared_taps(noise_sd_m_s2=0.05, offset_sd_m_s2=0.1)
    record = cast(TapRecord, prepared.data.record)
    record = record._replace(error_sd=jnp.asarray([[0.01, 0.02, 1e-4]] * len(truth)))
    tap = replace(at_truth(prepared, truth), record=record)
    density, scatter = np.asarray(tap.log_density()), np.asarray(tap.scatter)
    columns, expected = np.asarray(tap.columns()), np.asarray(tap.expected())
    for i, n in enumerate(np.asarray(record.n_samples)):
        added = columns[:, i, :n].T * np.asarray(record.error_sd)[i]
        covariance = scatter[i] ** 2 * np.eye(n) + added @ added.T
        dense = multivariate_normal(expected[i, :n], covariance).logpdf(np.asarray(record.y)[i, :n])
        assert density[i] == pytest.approx(dense, rel=1e-9)


def test_errors_given_a_recording_are_those_of_a_dense_normal() -> None:
    prepared, truth = prepared_taps(noise_sd_m_s2=0.05, offset_sd_m_s2=0.1)
    sd = np.array([0.01, 0.02, 1e-4])
    record = cast(TapRecord, prepared.data.record)._replace(error_sd=jnp.asarray([sd] * len(truth)))
    tap = replace(at_truth(prepared, truth), record=record)
    keys = jax.random.split(jax.random.PRNGKey(0), 4000)
    drawn = np.asarray(jax.jit(jax.vmap(tap.draw_errors))(keys))[:, 0]
    n = int(np.asarray(record.n_samples)[0])
    A = np.asarray(tap.columns())[:, 0, :n].T / np.asarray(tap.scatter)[0]
    left = np.asarray(record.y - tap.expected())[0, :n] / np.asarray(tap.scatter)[0]
    covariance = np.linalg.inv(np.diag(sd**-2.0) + A.T @ A)
    z = (drawn.mean(0) - covariance @ A.T @ left) / np.sqrt(np.diag(covariance) / len(drawn))
    # Three of 4,000 draws; the standard deviation is known to 1.1 %.
    assert np.abs(z).max() < 4
    assert drawn.std(0) == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.05)


def test_columns_are_what_errors_add() -> None:
    prepared, truth = prepared_taps(noise_sd_m_s2=0.05)
    tap = at_truth(prepared, truth)
    columns, inside = np.asarray(tap.columns()), np.asarray(tap.record.inside())
    assert (columns[ZERO] == inside).all()
    step = 1e-7
    ends = [np.asarray(tap.expected(jnp.full(len(truth), side * step))) for side in (1, -1)]
    by_difference = (ends[0] - ends[1]) / (2 * step)
    # But for terms of second order in the sampling interval.
    least = float((np.asarray(tap.omega_n).max() / 5000) ** 2 * np.abs(by_difference).max())
    assert columns[CLOCK][:, 1:] == pytest.approx(by_difference[:, 1:], abs=least)
    # A greater impulse rings higher in proportion, but for when it came.
    heavier = replace(tap, record=tap.record._replace(push=1.01 * tap.record.push))
    higher = np.asarray(heavier.expected() - tap.expected())
    total = 0.01 * np.asarray(tap.record.push).sum(1)[:, None]
    late = np.asarray(tap.omega_n)[:, None] * np.asarray(tap.record.end)[:, None]
    assert higher == pytest.approx(total * columns[IMPULSE], abs=float((late**2 * np.abs(higher)).max()))


def test_slopes_are_derivatives() -> None:
    prepared, truth = prepared_taps(noise_sd_m_s2=0.05)
    tap, step = at_truth(prepared, truth), 1e-5
    slopes = np.asarray(tap.slopes())

    def moved(number: int, by: float) -> np.ndarray:
        log_K, log_C, a = (by * (i == number) for i in range(3))
        omega_n, zeta = tap.omega_n * np.exp(log_K / 2), tap.zeta * np.exp(log_C - log_K / 2)
        there = replace(tap, omega_n=omega_n, zeta=zeta, log_ratio=tap.log_ratio + a)
        return np.asarray(there.expected() / tap.scatter[:, None])

    for number in range(3):
        by_difference = (moved(number, step) - moved(number, -step)) / (2 * step)
        assert slopes[..., number] == pytest.approx(by_difference, abs=1e-6 * np.abs(by_difference).max())


@pytest.mark.parametrize("zeta", [1e-3, 1.0, 30.0])
def test_the_density_has_slopes_at_any_damping(zeta: float) -> None:
    prepared, truth = prepared_taps(noise_sd_m_s2=0.05)
    tap = at_truth(prepared, truth)

    def density(log_zeta: Any) -> Any:
        return replace(tap, zeta=jnp.full(len(truth), jnp.exp(log_zeta))).log_density().sum()

    value, slope = jax.value_and_grad(density)(np.log(zeta))
    assert np.isfinite([value, slope]).all()
