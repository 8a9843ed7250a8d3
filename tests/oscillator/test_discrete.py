from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayestissue.mechanics.oscillator import (
    arccos_branch,
    from_differences,
    to_continuous,
    to_differences,
    to_discrete,
)


def autocovariance_a2(lag: np.ndarray | float, omega_n: float, zeta: float) -> np.ndarray:
    """gamma(0) e^(-a) (cos z + a sin(z) / z), a = zeta omega_n |s|, z = omega_d |s|; its forcing is 1."""
    a = zeta * omega_n * np.abs(lag)
    z = omega_n * np.abs(lag) * np.sqrt(1 - zeta**2 + 0j)
    return np.exp(-a) * (np.cos(z) + a * np.sinc(z / np.pi)).real / (4 * zeta * omega_n**3)


RADIANS_PER_SAMPLE = st.floats(-4, 0.4).map(lambda exponent: 10.0**exponent)
DAMPING = st.floats(-2.5, 1.3).map(lambda exponent: 10.0**exponent)


@jax.jit
def there_and_back(omega_n: float, zeta: float, dt: float) -> tuple[jax.Array, jax.Array]:
    return from_differences(*to_differences(omega_n, zeta, dt), dt)


@jax.jit
def printed_there_and_back(omega_n: float, zeta: float, dt: float) -> tuple[jax.Array, jax.Array]:
    return to_continuous(*to_discrete(omega_n, zeta, dt), dt)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(w=RADIANS_PER_SAMPLE, zeta=DAMPING, dt=st.sampled_from([2e-5, 1e-4, 5e-4]))
def test_differences_make_a_round_trip(w: float, zeta: float, dt: float) -> None:
    if zeta * w > 8:
        return  # e^-16: phi2 has lost its digits beside 1
    omega_n, back = there_and_back(w / dt, zeta, dt)
    # log1p near -1 loses the digits that exp(-2 a) has lost
    tolerance = 1e-13 * np.exp(2 * w * (zeta + max(zeta**2 - 1, 0) ** 0.5)) * max(1, w**2)
    np.testing.assert_allclose([omega_n * dt, back], [w, zeta], rtol=min(tolerance + 1e-12, 1e-3))


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(w=st.floats(0.01, 2.5), zeta=st.floats(0.01, 2.0))
def test_coefficients_make_a_round_trip(w: float, zeta: float) -> None:
    omega_n, back = printed_there_and_back(w / 1e-4, zeta, 1e-4)
    # phi1 and phi2 are rounded at 1e-16, of which omega_n^2 dt^2 and zeta omega_n dt are the remainder
    tolerance = 1e-14 / w**2 + 1e-14 * np.exp(8 * w * zeta)
    np.testing.assert_allclose([omega_n * 1e-4, back], [w, zeta], rtol=tolerance)


@pytest.mark.parametrize("zeta", [0.02, 0.3, 1.0, 1.001, 5.0])
@pytest.mark.parametrize("w", [0.3, 1.0, 3.0])
def test_theta1_gives_the_autocovariance_of_the_sampled_process(w: float, zeta: float) -> None:
    phi1, phi2, theta1 = to_discrete(w, zeta, 1.0)
    polynomial = np.array([1.0, -phi1, -phi2])
    distance = np.subtract.outer(np.arange(3), np.arange(3))

    def moment(shift: int) -> float:
        """Autocovariance of the filtered process, straight from the definition."""
        return float(polynomial @ autocovariance_a2(distance + shift, w, zeta) @ polynomial)

    rounding = 4e-14 * float(autocovariance_a2(0, w, zeta))
    assert moment(2) == pytest.approx(0.0, abs=rounding)
    expected = float(-theta1 / (1 + theta1**2))
    assert moment(1) / moment(0) == pytest.approx(expected, abs=rounding / moment(0))


def test_quadrature_and_autocovariance_agree_where_they_meet() -> None:
    zeta = jnp.array([0.3, 0.9, 1.0, 1.5])
    below, above = (
        to_discrete((12 * side) / jnp.maximum(zeta, 1.0), zeta, 1.0)[2] for side in (1 - 1e-9, 1 + 1e-9)
    )
    np.testing.assert_allclose(below, above, rtol=1e-6, atol=1e-12)


def test_theta1_picks_the_branch_of_arccos() -> None:
    # omega_d = 471 rad/s at 10 ms, where arccos answers 157.3
    omega_n, zeta, dt = 471.3, 0.05, 0.01
    coefficients = to_discrete(omega_n, zeta, dt)
    assert int(arccos_branch(*coefficients)) == 1
    np.testing.assert_allclose(to_continuous(*coefficients, dt), (omega_n, zeta), rtol=1e-9)


@pytest.mark.parametrize("w", [4.0, 7.0, 20.0])
@pytest.mark.parametrize("zeta", [0.02, 0.2])
def test_higher_branches_make_a_round_trip(w: float, zeta: float) -> None:
    np.testing.assert_allclose(to_continuous(*to_discrete(w, zeta, 1.0), 1.0), (w, zeta), rtol=1e-8)


def test_noise_like_theta1_leaves_the_main_branch_when_sampling_is_fine() -> None:
    phi1, phi2, _ = to_discrete(100.0, jnp.array([0.05, 0.5, 0.95]), 1e-4)
    for theta1 in (-1.0, -0.9, 0.0, 0.9):
        assert not np.asarray(arccos_branch(phi1, phi2, theta1)).any()


def test_coefficients_of_no_oscillator_give_nan() -> None:
    assert np.isnan(to_continuous(0.5, 0.2, 0.0, 1.0)).all()
    assert np.isnan(to_continuous(-1.5, -0.5, 0.0, 1.0)).all()
