"""The density of displacements and forces, against a dense normal with the spline's own covariance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scipy.stats import multivariate_normal

from bayestissue.elements import REFERENCE_DIAMETER_M, element
from bayestissue.likelihood.driven import motion
from bayestissue.likelihood.driven.measured import DrivenRecord, MeasuredDriven, driven_record
from bayestissue.likelihood.element.noise import LENGTH

K, C = np.array([40e3, 12e3]), np.array([300.0, 150.0])
N_X, N_F = np.array([24, 18]), np.array([31, 25])
DT_X, DT_F, FIRST = np.array([1e-3, 1.2e-3]), np.array([0.7e-3, 0.8e-3]), np.array([0.2e-3, 0.3e-3])
SIGMA, SIGMA_F, ROUGH = np.array([1e-4, 5e-5]), np.array([2.0, 0.5]), np.array([4.0, 8.0])
ERRORS = np.array([[2e-4, 1.0], [0.0, 0.3]])


def grid(row: int) -> tuple[np.ndarray, np.ndarray]:
    return FIRST[row] + np.arange(N_X[row]) * DT_X[row], FIRST[row] + np.arange(N_F[row]) * DT_F[row]


def recorded(
    rng: np.random.Generator, *, discrepancy: bool, clock_sd: float = 1e-3, late: float = 0.0
) -> DrivenRecord:
    x, y = np.zeros((2, N_X.max())), np.zeros((2, N_F.max()))
    for row in range(2):
        at, then = grid(row)
        x[row, : N_X[row]] = 6e-3 * np.sin(60 * at) + 2e-3 + SIGMA[row] * rng.standard_normal(len(at))
        y[row, : N_F[row]] = 6e-3 * (K[row] * np.sin(60 * then) + C[row] * 60 * np.cos(60 * then))
        y[row, : N_F[row]] += SIGMA_F[row] * rng.standard_normal(len(then))
    return driven_record(
        (y, N_F, FIRST, DT_F),
        (x, N_X, FIRST + late, DT_X),
        ERRORS,
        clock_sd=np.full(2, clock_sd),
        discrepancy=discrepancy,
        surroundings={"diameter_m": np.full(2, REFERENCE_DIAMETER_M)},
        common_depth=np.zeros(2),
    )


def measured(
    record: DrivenRecord, log_discrepancy: float | None = None, K: np.ndarray = K, C: np.ndarray = C
) -> MeasuredDriven:
    beside = None if log_discrepancy is None else jnp.full(2, log_discrepancy)
    logs = [jnp.log(jnp.asarray(values)) for values in (SIGMA, SIGMA_F, ROUGH)]
    return MeasuredDriven(element("kelvin_voigt"), jnp.asarray([K, C]), *logs, jnp.zeros(2), beside, record)


@jax.jit
def density(
    record: DrivenRecord, log_discrepancy: float | None = None, K: np.ndarray = K, C: np.ndarray = C
) -> Array:
    return measured(record, log_discrepancy, K, C).log_density()


@jax.jit
def joint_density(
    record: DrivenRecord, log_discrepancy: float | None = None, K: np.ndarray = K, C: np.ndarray = C
) -> Array:
    return measured(record, log_discrepancy, K, C).joint_log_density()


def covariances(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of int_0^t (t - u)^2 / 2 g(u) dW(u) with itself, of its slope with it, of its slope with itself.

    By a rule that is exact to rounding: of a smooth integrand up to the earlier of both times.
    """
    node, weight = np.polynomial.legendre.leggauss(60)
    a = np.minimum(t[:, None], t)[..., None]
    u = a * (node + 1) / 2
    of_u = a * weight / 2 * (1 + u / motion.SETTLES) ** -4
    to_t, to_t_prime = t[:, None, None] - u, t[None, :, None] - u
    return (
        (of_u * to_t**2 * to_t_prime**2).sum(-1) / 4,
        (of_u * to_t * to_t_prime**2).sum(-1) / 2,
        (of_u * to_t * to_t_prime).sum(-1),
    )


def dense(
    record: DrivenRecord,
    row: int,
    rms: float = 0.0,
    K: np.ndarray = K,
    C: np.ndarray = C,
    *,
    force_alone: bool = False,
) -> float:
    """Log density by the covariance of all samples of both channels, of K x + C x' by the kernel's slopes."""
    at, then = grid(row)
    depth, force = np.asarray(record.unit)[row]
    last = max(at[-1], then[-1])
    t = np.concatenate([at, then]) / last
    k, slope, both = covariances(t)
    powers, slopes = np.stack([t, t**2]), np.stack([np.ones_like(t), 2 * t])
    wide, rough = 30.0**2 * depth**2, ROUGH[row] ** 2 * depth**2
    cov = rough * k + wide * powers.T @ powers + ERRORS[row, 0] ** 2
    cov_xv = (rough * slope.T + wide * powers.T @ slopes) / last
    cov_vv = (rough * both + wide * slopes.T @ slopes) / last**2
    n, f = len(at), slice(len(at), None)
    whole = np.empty((len(t), len(t)))
    whole[:n, :n] = cov[:n, :n] + wide + SIGMA[row] ** 2 * np.eye(n)
    whole[:n, f] = K[row] * cov[:n, f] + C[row] * cov_xv[:n, f]
    whole[f, :n] = whole[:n, f].T
    whole[f, f] = K[row] ** 2 * cov[f, f] + K[row] * C[row] * (cov_xv[f, f] + cov_xv[f, f].T)
    whole[f, f] += C[row] ** 2 * cov_vv[f, f] + ERRORS[row, 1] ** 2 + SIGMA_F[row] ** 2 * np.eye(len(then))
    if rms:
        u = (then - then[0]) / (then[-1] - then[0])
        values, vectors = np.linalg.eigh(np.exp(-((u[:, None] - u) ** 2) / (2 * LENGTH**2)))
        values, vectors = values[-6:], vectors[:, -6:]
        share = values * len(then) / values.sum()
        whole[f, f] += (rms * force) ** 2 * (vectors * share) @ vectors.T
    values = np.concatenate([np.asarray(record.x)[row, :n], np.asarray(record.y)[row, : len(then)]])
    # In units of the noise: metres and newtons in one matrix would leave it no digits.
    noise = np.concatenate([np.full(n, SIGMA[row]), np.full(len(then), SIGMA_F[row])])
    if force_alone:
        whole, values, noise = whole[f, f], values[f], noise[f]
    normal = multivariate_normal(np.zeros(len(noise)), whole / np.outer(noise, noise))
    return float(normal.logpdf(values / noise) - np.log(noise).sum())


@pytest.fixture
def many_modes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """So many functions that the sum is the integral."""
    monkeypatch.setattr(motion, "MODES", 60)
    monkeypatch.setattr(motion, "_NODES", 240)
    motion._eigenvectors.cache_clear()
    motion._table.cache_clear()
    yield
    motion._eigenvectors.cache_clear()
    motion._table.cache_clear()


@pytest.mark.parametrize("rms", [0.0, 0.05])
@pytest.mark.usefixtures("many_modes")
def test_density_is_that_of_a_dense_normal(rms: float) -> None:
    record = recorded(np.random.default_rng(1), discrepancy=rms > 0)
    log_rms = np.log(rms) if rms else None
    joint = np.array([dense(record, row, rms) for row in range(2)])
    np.testing.assert_allclose(joint_density(record, log_rms), joint, atol=0.03)
    of_law, presumed = (
        np.array([dense(record, row, rms, K=K, C=C, force_alone=True) for row in range(2)])
        for K, C in ((K, C), np.asarray(record.presumed).T)
    )
    np.testing.assert_allclose(density(record, log_rms), joint - of_law + presumed, atol=0.05)


def test_a_force_alone_says_nothing_of_the_law() -> None:
    """Nor does it beside a displacement of which hardly anything is known, whatever its prior says."""
    record = recorded(np.random.default_rng(1), discrepancy=False)

    @jax.jit
    def deaf(K: Array, C: Array) -> Array:
        # A metre of noise, where the displacement may be 0.2 m: what it adds is the square of that.
        return replace(measured(record, K=K, C=C), log_sigma=jnp.zeros(2)).log_density()

    laws = [deaf(K * f, C * g) for f, g in ((1, 1), (0.3, 1), (3, 1), (1, 0.3), (1, 3))]
    np.testing.assert_allclose(np.ptp(laws, axis=0), 0, atol=0.05)


def test_no_K_and_C_far_from_the_recordings_is_likelier_than_theirs() -> None:
    """A density whose squares cancel is what is left of their digits there, of thousands of either sign."""
    record = recorded(np.random.default_rng(1), discrepancy=False)
    at = density(record)
    for further in np.exp(np.linspace(3, 30, 10)):
        for far in (density(record, K=K * further), density(record, K=K * further, C=C * further)):
            assert (far < at).all()


def test_sixteen_functions_tell_K_and_C_as_all_do() -> None:
    """Their difference in log density does not depend on K and C."""
    record = recorded(np.random.default_rng(1), discrepancy=False)
    few = [joint_density(record, K=K * f, C=C * g) for f, g in ((1, 1), (1.03, 1), (1, 1.1))]
    whole = [dense(record, 0, K=K * f, C=C * g) for f, g in ((1, 1), (1.03, 1), (1, 1.1))]
    np.testing.assert_allclose(np.diff([f[0] for f in few]), np.diff(whole), atol=0.05)


def test_slopes_are_those_of_the_functions() -> None:
    # Values are rounded to 1e-12, and third derivatives are some tens.
    t, step = np.linspace(0.05, 0.95, 7)[None], 1e-5
    forth, back = (motion.functions(t + side * step)[0] for side in (1, -1))
    np.testing.assert_allclose(motion.functions(t)[1], (forth - back) / (2 * step), atol=1e-7)


def test_kernel_is_the_integral_over_what_went_before() -> None:
    t = np.linspace(0, 1, 21)
    k, slope, _ = covariances(t)
    value, of_value = motion.kernel(t[:, None], t)
    np.testing.assert_allclose(value, k, atol=1e-14)
    np.testing.assert_allclose(of_value, slope, atol=1e-13)


def test_interpolated_functions_are_the_functions() -> None:
    t = np.random.default_rng(0).uniform(-0.5, 1.5, (1, 200))
    np.testing.assert_allclose(motion.interpolated(jnp.asarray(t)), motion.functions(t)[0], atol=1e-8)


def test_functions_have_the_covariance_of_the_integral() -> None:
    t = np.linspace(0, 1, 21)[None]
    f = motion.functions(t)[0][0, :, motion.POWERS :]
    # The sum of what is left out falls as the fifth power of the number of modes.
    np.testing.assert_allclose(f @ f.T, motion.kernel(t[0][:, None], t[0])[0], atol=1e-9)


@pytest.mark.parametrize("late", [-2e-3, 0.5e-3, 2e-3])
def test_a_force_that_is_late_is_one_of_displacements_later(
    late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A function of time that is interpolated errs by 1e-8 of the motion, and its noise is a hundredth."""
    # Displacements end before, so that the window is the force's.
    monkeypatch.setitem(globals(), "N_X", N_X - 6)
    of_late = recorded(np.random.default_rng(4), discrepancy=True)
    shifted = recorded(np.random.default_rng(4), discrepancy=True, late=late)
    assert all(grid(row)[1][-1] > grid(row)[0][-1] + late for row in range(2))

    @jax.jit
    def joint(record: DrivenRecord, clock: float) -> Array:
        return replace(measured(record, -3.0), clock=jnp.full(2, clock)).joint_log_density()

    np.testing.assert_allclose(joint(of_late, late / 1e-3), joint(shifted, 0.0), atol=1e-4)


def test_both_clocks_are_one_where_none_is_late() -> None:
    """Of what depends on a parameter the functions are interpolated: see the test of a force that is late."""
    record = recorded(np.random.default_rng(6), discrepancy=True)

    @jax.jit
    def joint(record: DrivenRecord) -> Array:
        return replace(measured(record, -3.0), clock=None).joint_log_density()

    np.testing.assert_allclose(joint(record), joint_density(record, -3.0), atol=1e-4)


def test_a_clock_is_a_direction_of_the_displacements() -> None:
    record = recorded(np.random.default_rng(5), discrepancy=False)
    event, step = replace(measured(record), clock=jnp.array([0.3, -0.8])), 1e-4
    weights = event.weights()
    forth, back = (replace(event, clock=event.clock + side * step).displacement(weights) for side in (1, -1))
    expected = (forth - back) / (2 * step) / SIGMA[:, None]
    np.testing.assert_allclose(event.slopes()[:, N_F.max() :, -1], expected, atol=1e-5)


def test_padding_changes_nothing() -> None:
    record = recorded(np.random.default_rng(2), discrepancy=True)
    found, padded = (density(one, -3.0) for one in (record, record.padded()))
    np.testing.assert_allclose(found, padded, rtol=1e-12)


def test_draws_have_the_moments_of_the_weights() -> None:
    record = recorded(np.random.default_rng(3), discrepancy=True)

    @jax.jit
    def drawn(record: DrivenRecord) -> tuple[Array, Array, Array]:
        event = measured(record, -3.0)
        draws = jax.vmap(event.weights)(jax.random.split(jax.random.PRNGKey(0), 4000))
        return draws, event.weights(), record.y - event.force(event.weights())

    draws, mean, residual = map(np.asarray, drawn(record))
    sd = draws.std(0)
    moved = np.abs(draws.mean(0) - mean) / np.where(sd > 0, sd, 1.0)
    assert moved.max() < 5 / np.sqrt(4000)
    assert np.abs(residual).max() < 5 * SIGMA_F.max()
