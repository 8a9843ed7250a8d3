"""Decelerations on a spring and damper side by side against dense normals."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayestissue.mechanics.elements import element
from bayestissue.mechanics.elements.element import GRAVITY as ALONG
from bayestissue.mechanics.oscillator import impact_motion
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord

RNG = np.random.default_rng(11)
LENGTHS = np.array([50, 3, 31, 22, 40])
DT = np.array([5e-4, 2e-3, 1e-3, 1e-3, 4e-4])
FIRST = np.array([0.0, 3e-4, 9e-4, 2e-4, 1e-4])
VELOCITY = np.array([1.5, 1.2, 2.0, 0.7, 1.0])
# Complex roots, equal roots, real ones far apart.
OMEGA_N = np.array([60.0, 150.0, 90.0, 120.0, 80.0])
ZETA = np.array([0.3, 1.0, 2.5, 0.999, 0.0])
GRAVITY = np.array([9.80665, 0.0, 9.80665, -3.0, 0.0])
LOG_SIGMA = np.log(np.array([0.5, 1.0, 0.2, 2.0, 1.0]))
ERROR_SD = np.array(
    [[0.02, 0.5, 1e-4], [0.05, 0.0, 2e-4], [0.0, 0.0, 0.0], [0.01, 1.0, 0.0], [0.1, 0.2, 1e-5]]
)
UNIFORM = np.array([False, True, False, False, True])
WIDTH = 50


def expected(i: int, omega_n: float, zeta: float) -> tuple[np.ndarray, np.ndarray]:
    """The trace, and what velocity, offset and contact time in error by one add to it, [error, sample]."""
    time = FIRST[i] + np.arange(LENGTHS[i]) * DT[i]

    def deceleration(t: np.ndarray, velocity: float) -> np.ndarray:
        return np.asarray(impact_motion(t, omega_n, zeta, velocity, GRAVITY[i]).deceleration)

    # The motion's formulas hold before contact too, where a step back may end.
    step = 1e-4 / omega_n
    later, earlier = deceleration(time + 2 * step, VELOCITY[i]), deceleration(time + step, VELOCITY[i])
    now = deceleration(time, VELOCITY[i])
    jerk = (-later + 4 * earlier - 3 * now) / (2 * step)
    faster = deceleration(time, VELOCITY[i] + 1) - now
    return now, np.stack([faster, np.ones_like(time), -jerk])


def record() -> DecelerationRecord:
    d = RNG.normal(size=(5, WIDTH))
    for i in range(5):
        d[i, : LENGTHS[i]] += expected(i, OMEGA_N[i], ZETA[i])[0]
    return recorded(d)


def recorded(d: np.ndarray) -> DecelerationRecord:
    surroundings = {"diameter_m": np.full(5, 0.03), ALONG: GRAVITY}
    chain = (VELOCITY, ERROR_SD, np.ones(5), surroundings, Contact.known(UNIFORM))
    return DecelerationRecord.from_arrays(d, LENGTHS, FIRST, DT, *chain)


RECORD = record()


AT = tuple(map(jnp.asarray, (OMEGA_N, ZETA, LOG_SIGMA)))


TISSUE = element("kelvin_voigt")


def spring_and_damper(omega_n: jax.Array, zeta: jax.Array) -> jax.Array:
    """K and C for a mass of 1 kg."""
    return jnp.stack([omega_n**2, 2 * zeta * omega_n])


def measured(*parts: jax.Array, record: DecelerationRecord = RECORD) -> MeasuredImpact:
    """At omega_n, zeta and log sigma; those of the record unless given."""
    omega_n, zeta, log_sigma = parts or AT
    return MeasuredImpact(TISSUE, spring_and_damper(omega_n, zeta), NoiseParameters(log_sigma), record)


@jax.jit
def densities(*parts: jax.Array) -> jax.Array:
    return measured(*parts).log_density()


slopes_of = jax.jit(jax.grad(lambda *parts: densities(*parts).sum(), argnums=(0, 1, 2)))


@jax.jit
def density_of(value: jax.Array) -> jax.Array:
    """Of any traces."""
    return measured(record=RECORD.with_traces(value)).log_density()


def dense_log_density(value: np.ndarray) -> list[float]:
    return [
        log_density(i, value[i, : LENGTHS[i]], *expected(i, OMEGA_N[i], ZETA[i])) for i in range(len(LENGTHS))
    ]


def log_density(i: int, value: np.ndarray, mean: np.ndarray, columns: np.ndarray) -> float:
    """Of one trace, by a dense covariance; a uniform last error by Gauss-Legendre quadrature."""
    normal = columns[:-1] if UNIFORM[i] else columns
    covariance = np.exp(2 * LOG_SIGMA[i]) * np.eye(LENGTHS[i])
    covariance += normal.T @ np.diag(ERROR_SD[i, : len(normal)] ** 2) @ normal
    density = multivariate_normal(mean, covariance)
    if not UNIFORM[i]:
        return density.logpdf(value)
    places, weights = np.polynomial.legendre.leggauss(60)
    errors = np.sqrt(3) * ERROR_SD[i, -1] * places
    return logsumexp(density.logpdf(value - errors[:, None] * columns[-1]), b=weights / 2)


@pytest.mark.slow
def test_density_is_that_of_the_dense_normal() -> None:
    # The oracle's jerk is a one-sided difference, right to the square of its step, 1e-8.
    assert_allclose(densities(*AT), dense_log_density(np.asarray(RECORD.d)), rtol=1e-6)
    other = 1.1 * np.asarray(RECORD.d)
    assert_allclose(density_of(other), dense_log_density(other), rtol=1e-6)


def test_density_by_the_motion_itself() -> None:
    exact = densities(*AT)
    time = FIRST[:, None] + np.arange(WIDTH) * DT[:, None]
    at = OMEGA_N[:, None], ZETA[:, None]
    motion, unit = (
        impact_motion(time, *at, VELOCITY[:, None], GRAVITY[:, None]),
        impact_motion(time, *at, 1.0),
    )
    d, v, h = (np.asarray(part) for part in (motion.deceleration, motion.velocity, unit.deceleration))
    jerk = OMEGA_N[:, None] ** 2 * v + 2 * (ZETA * OMEGA_N)[:, None] * (GRAVITY[:, None] - d)
    for i in range(5):
        inside = slice(LENGTHS[i])
        columns = np.stack([h[i, inside], np.ones(LENGTHS[i]), -jerk[i, inside]])
        direct = log_density(i, np.asarray(RECORD.d)[i, inside], d[i, inside], columns)
        # Rounding alone: exp, sin and cos of up to some tens of radians.
        assert_allclose(exact[i], direct, rtol=1e-11)


def test_what_lies_past_an_impacts_end_counts_nothing() -> None:
    inside = np.arange(WIDTH) < LENGTHS[:, None]
    value = np.where(inside, RECORD.d, 7.0)
    assert_allclose(density_of(value), density_of(np.asarray(RECORD.d)), rtol=1e-12)
    assert_allclose(recorded(value).d, RECORD.d, atol=0)


@pytest.mark.slow
def test_slopes_are_central_differences() -> None:
    at, slopes = AT, slopes_of(*AT)
    forward = jax.jit(lambda *at: jax.jvp(densities, at, tuple(map(jnp.ones_like, at)))[1])(*at)
    assert_allclose(forward, sum(slopes), rtol=1e-9, atol=1e-8)
    for k, slope in enumerate(slopes):
        step = 1e-5 * np.maximum(np.abs(at[k]), 0.1)
        ahead, behind = (
            np.asarray(densities(*[p + sign * step if a == k else p for a, p in enumerate(at)]))
            for sign in (1, -1)
        )
        # Third derivatives times step squared, and rounding of a density of some hundreds over the step.
        assert_allclose(slope, (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-13 * 500 / step.min())


@pytest.mark.slow
def test_chains_side_by_side_are_the_chains_one_by_one() -> None:
    def total(shift: jax.Array) -> jax.Array:
        return densities(shift * OMEGA_N, jnp.asarray(ZETA), jnp.asarray(LOG_SIGMA)).sum()

    both, shifts = jax.value_and_grad(total), jnp.array([0.9, 1.0, 1.2])
    values, slopes = jax.jit(jax.vmap(both))(shifts)
    for shift, value, slope in zip(shifts, values, slopes, strict=True):
        # The same sums in another order.
        assert_allclose((value, slope), jax.jit(both)(shift), rtol=1e-10)


@pytest.mark.slow
def test_curvature_is_the_difference_of_slopes() -> None:
    at = np.stack(AT)
    total = lambda p: densities(*p).sum()  # noqa: E731
    curvature = np.asarray(jax.jit(jax.hessian(total))(at))

    def slopes(at: np.ndarray) -> np.ndarray:
        return np.stack(slopes_of(*at))

    for k in range(3):
        for i in range(5):
            step = np.zeros(at.shape)
            step[k, i] = 1e-5 * max(abs(at[k, i]), 0.1)
            found = (slopes(at + step) - slopes(at - step)) / (2 * step[k, i])
            scale = np.abs(curvature[k, i]).max()
            assert_allclose(curvature[k, i], found, rtol=1e-5, atol=1e-6 * scale)


def test_samples_have_the_dense_mean_and_covariance() -> None:
    number = 4000
    d = np.asarray(jax.jit(lambda key: measured().sample(key, (number,)))(jax.random.key(5)))
    for i in range(5):
        mean, columns = expected(i, OMEGA_N[i], ZETA[i])
        covariance = np.exp(2 * LOG_SIGMA[i]) * np.eye(LENGTHS[i])
        covariance += columns.T @ np.diag(ERROR_SD[i] ** 2) @ columns
        drawn, sd = d[:, i, : LENGTHS[i]], np.sqrt(np.diag(covariance))
        # Standard errors of means and of covariances; 5 of them for some thousand numbers.
        assert (np.abs(drawn.mean(0) - mean) < 5 * sd / np.sqrt(number)).all()
        error = np.sqrt((np.outer(sd, sd) ** 2 + covariance**2) / number)
        assert (np.abs(np.cov(drawn.T) - covariance) < 5 * error).all()
        assert not d[:, i, LENGTHS[i] :].any()
