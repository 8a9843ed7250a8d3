from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.dataset.chain import Uncertainty
from bayestissue.dataset.model import Dataset, Trace
from bayestissue.inference.single.estimates import estimate
from bayestissue.oscillator import impact_motion, spring_damper_inverse, time_to_peak
from bayestissue.signal import SignalOptions
from bayestissue.thesis.causes.batches import Treatment, thesis_estimates
from bayestissue.thesis.causes.campaigns import decelerations, recorded

MASS = np.array([0.375, 0.562, 0.75, 1.0, 1.333])
VELOCITY = np.array([1.75, 1.5, 1.25, 1.25, 1.5])
K = np.array([2500.0, 3000.0, 3500.0, 2000.0, 4000.0])
C = np.array([10.0, 25.0, 40.0, 15.0, 60.0])
DT = np.full(5, 4e-4)


def treatment(**changes: object) -> Treatment:
    zero = np.zeros(len(MASS))
    usual = Treatment(DT, VELOCITY, MASS, zero, zero + 1, zero + 1, zero, zero)
    return usual._replace(**{name: zero + np.asarray(value) for name, value in changes.items()})


def linear_tissue(count: int = 128) -> np.ndarray:
    zero = np.zeros(len(MASS))
    return np.asarray(decelerations("kelvin_voigt", {"K": K, "C": C}, MASS, VELOCITY, zero, DT, count))


@pytest.mark.slow
def test_the_same_estimates_as_the_command_estimate_by_dds() -> None:
    random = np.random.default_rng(1)
    d = linear_tissue() + 0.2 * random.standard_normal((len(MASS), 128))
    names = [f"i{k}" for k in range(len(MASS))]
    impacts = pd.DataFrame(
        {"impact": names, "subject": "s", "trial": names, "mass_kg": MASS, "velocity_m_s": VELOCITY}
    )
    traces = [Trace(np.arange(128) * DT[0], row) for row in d]
    dataset = Dataset(
        name="", description="", impacts=impacts, traces=traces, quantity="deceleration",
        uncertainty=Uncertainty(0, 0, 0, 0), warnings=(), left_out=(), folder=Path(), input_hash="",
    )  # fmt: skip
    options = SignalOptions(
        contact="time-zero", remove_offset=False, integration="trapezoidal", equilibrium="sample-mean"
    )
    table = estimate(dataset, method="dds", options=options)
    found = thesis_estimates(d, treatment())
    np.testing.assert_array_equal(found.n_samples, table["n_samples"])
    # Both search theta1 on the same grid, and differ by the order of sums.
    np.testing.assert_allclose(found.K, table["K_N_per_m"], rtol=1e-8)
    np.testing.assert_allclose(found.C, table["C_N_s_per_m"], rtol=1e-7)


def test_about_the_rest_position_the_estimate_is_the_truth() -> None:
    found = thesis_estimates(linear_tissue(), treatment(centred=0))
    # The trapezoidal rule errs by (omega dt)^2 / 12 in each integration; omega dt is below 0.04.
    np.testing.assert_allclose(found.K, K, rtol=1e-3)
    np.testing.assert_allclose(found.C, C, rtol=1e-2)


def test_centring_makes_one_tissue_too_stiff() -> None:
    assert np.all(np.asarray(thesis_estimates(linear_tissue(), treatment()).K) > 1.5 * K)


def test_a_window_spread_over_a_nominal_length_scales_with_its_samples() -> None:
    plain = thesis_estimates(linear_tissue(), treatment())
    spread = thesis_estimates(linear_tissue(), treatment(nominal=0.3))
    factor = DT * np.asarray(plain.n_samples) / 0.3
    np.testing.assert_allclose(spread.K, np.asarray(plain.K) * factor**2, rtol=1e-12)
    np.testing.assert_allclose(spread.C, np.asarray(plain.C) * factor, rtol=1e-12)


def test_windows_of_one_length_have_as_many_samples() -> None:
    np.testing.assert_array_equal(thesis_estimates(linear_tissue(), treatment(window=20)).n_samples, 20)


def test_the_printed_expression_in_theta1_agrees_where_theta1_is_not_near_one() -> None:
    usual = thesis_estimates(linear_tissue(), treatment(centred=0))
    printed = thesis_estimates(linear_tissue(), treatment(centred=0, by_theta1=1))
    # It differs from the arccos by terms of the order of (omega dt)^2 while theta1 is away from 1.
    np.testing.assert_allclose(printed.K, usual.K, rtol=0.02)


@pytest.mark.parametrize("first", [0.0, 2e-4])
def test_a_linear_tissue_is_the_closed_form_until_it_lets_go(first: float) -> None:
    d = np.asarray(
        decelerations("kelvin_voigt", {"K": K, "C": C}, MASS, VELOCITY, np.full(5, first), DT, 100)
    )
    omega, zeta = (np.asarray(part)[:, None] for part in spring_damper_inverse(K, C, MASS))
    time = first + np.arange(100) * DT[:, None]
    motion = np.asarray(impact_motion(time, omega, zeta, VELOCITY[:, None]).deceleration)
    loading = time < np.asarray(time_to_peak(omega, zeta))
    np.testing.assert_allclose(d[loading], motion[loading], rtol=1e-9)
    assert np.all(d >= 0)
    assert np.all(np.diff((d == 0).astype(int), axis=1) >= 0)


def test_a_recorder_multiplies_and_adds_in_units_of_the_peak() -> None:
    d = np.array([[0.0, 2.0, 4.0], [1.0, 8.0, 2.0]])
    seen = recorded(d, np.array([1.1, 1.0]), np.array([0.0, 0.01]), np.zeros((2, 3)))
    np.testing.assert_allclose(seen, [[0, 2.2, 4.4], [1.08, 8.08, 2.08]], rtol=1e-14)
