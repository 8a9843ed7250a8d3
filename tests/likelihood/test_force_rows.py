"""A force beside the deceleration against the dense normal of all rows of both."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal

from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.recorder_noise import filtered_noise, low_pass_of
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord, ForceRows
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import autocorrelation, on_even_grid

K, C, MASS, VELOCITY = 3000.0, 25.0, 0.8, 1.4
# Velocity, gain, the force's zero, its clock, the deceleration's zero, the time of contact.
SD = (0.03, 0.02, 0.1, 5e-5, 0.2, 4e-5)
SIGMA, FORCE_SIGMA, RATIO, TIP = 0.4, 0.9, 0.07, 0.1
SAMPLES, DT, FIRST = 40, 5e-4, 2e-4
ROWS, FORCE_DT, FORCE_FIRST = 25, 7e-4, 3e-4


def deceleration(t: np.ndarray, velocity: float = VELOCITY) -> np.ndarray:
    """Of a spring and damper met at this velocity, by the closed form."""
    omega, zeta = np.sqrt(K / MASS), C / (2 * np.sqrt(K * MASS))
    damped = omega * np.sqrt(1 - zeta**2)
    x = velocity * np.exp(-zeta * omega * t) * np.sin(damped * t) / damped
    v = (
        velocity
        * np.exp(-zeta * omega * t)
        * (np.cos(damped * t) - zeta * omega / damped * np.sin(damped * t))
    )
    return (K * x + C * v) / MASS


def jerk(t: np.ndarray, step: float = 1e-7) -> np.ndarray:
    return (deceleration(t + step) - deceleration(t - step)) / (2 * step)


def recorded() -> tuple[DecelerationRecord, np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    t, s = FIRST + DT * np.arange(SAMPLES), FORCE_FIRST + FORCE_DT * np.arange(ROWS)
    d = deceleration(t) + random.normal(0, SIGMA, SAMPLES)
    y = (np.exp(RATIO) - TIP) * deceleration(s) + random.normal(0, FORCE_SIGMA, ROWS)
    one = np.ones(1)
    record = DecelerationRecord.from_arrays(
        d[None],
        np.array([SAMPLES]),
        FIRST * one,
        DT * one,
        VELOCITY * one,
        np.array([SD]),
        MASS * one,
        {},
        Contact.known(np.zeros(1, bool)),
    )
    # Of a row that is longer than the trace, what is behind its end says nothing.
    rows = ForceRows(
        jnp.asarray(np.append(y, 9.0)[None]),
        jnp.array([ROWS]),
        jnp.array([FORCE_FIRST]),
        jnp.array([FORCE_DT]),
        jnp.array([TIP]),
    )
    return record._replace(force=rows), d, y


def likelihood(record: DecelerationRecord) -> MeasuredImpact:
    parameters = jnp.array([[K], [C]])
    noise = NoiseParameters(
        jnp.log(jnp.array([SIGMA])), None, jnp.log(jnp.array([FORCE_SIGMA])), jnp.array([RATIO])
    )
    return MeasuredImpact(element("kelvin_voigt"), parameters, noise, record)


@jax.jit
def log_density(record: DecelerationRecord) -> Array:
    return likelihood(record).log_density()[0]


def dense() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and covariance of all rows, and the columns of the errors."""
    t, s = FIRST + DT * np.arange(SAMPLES), FORCE_FIRST + FORCE_DT * np.arange(ROWS)
    share = np.exp(RATIO) - TIP
    none_d, none_y = np.zeros(SAMPLES), np.zeros(ROWS)
    columns = np.array(
        [
            [*(deceleration(t) / VELOCITY), *(share * deceleration(s) / VELOCITY)],
            [*deceleration(t), *none_y],
            [*none_d, *np.ones(ROWS)],
            [*none_d, *(-share * jerk(s))],
            [*np.ones(SAMPLES), *none_y],
            [*(-jerk(t)), *(-share * jerk(s))],
        ]
    )
    mean = np.concatenate([deceleration(t), share * deceleration(s)])
    noise = np.diag(np.concatenate([np.full(SAMPLES, SIGMA**2), np.full(ROWS, FORCE_SIGMA**2)]))
    return mean, noise + columns.T @ np.diag(np.square(SD)) @ columns, columns


def test_the_log_density_is_that_of_the_dense_normal() -> None:
    record, d, y = recorded()
    mean, covariance, _ = dense()
    expected = multivariate_normal(mean, covariance).logpdf(np.concatenate([d, y]))
    assert float(log_density(record)) == pytest.approx(expected, rel=1e-7)


def test_below_the_tissue_it_is_the_tissues_own_force() -> None:
    """Where 0.3 kg moves along, (M + m) / M times M d: it moves as M / (M + m) of K, C and V does."""
    record, d, y = recorded()
    assert record.force is not None
    moves, given = 0.3, likelihood(record)
    heavier = (MASS + moves) / MASS
    below = record._replace(
        velocity=record.velocity * heavier,
        error_sd=record.error_sd.at[:, 0].multiply(heavier),
        force=record.force._replace(tip=None),
    )
    parameters = jnp.array([[K * heavier], [C * heavier], [moves]])
    # The force's ratio less what the mass accounts for, so that all rows are those of the test above.
    ratio = jnp.log(jnp.array([(np.exp(RATIO) - TIP) / heavier]))
    noise = given.noise_parameters._replace(log_force_ratio=ratio)
    density = jax.jit(lambda p, r: MeasuredImpact(element("moving_mass"), p, noise, r).log_density()[0])
    found = density(parameters, below)
    mean, covariance, _ = dense()
    expected = multivariate_normal(mean, covariance).logpdf(np.concatenate([d, y]))
    assert float(found) == pytest.approx(expected, rel=1e-7)


FINER = 400
LATER = 3


@pytest.mark.parametrize(
    ("recorder", "share", "first"),
    [
        (LowPassFilter(low_pass_hz=300.0), 1.0, FORCE_FIRST),
        pytest.param(
            LowPassFilter(low_pass_hz=300.0, order=4, kind="bessel"), 0.3, FORCE_FIRST, marks=pytest.mark.slow
        ),
        (LowPassFilter(low_pass_hz=150.0, order=2, zero_phase=True, applied="analog"), 0.3, FORCE_FIRST),
        pytest.param(
            LowPassFilter(low_pass_hz=200.0, applied="digital"), 0.3, FORCE_FIRST, marks=pytest.mark.slow
        ),
        # Samples since contact before the first that counts are behind the filter too.
        (LowPassFilter(low_pass_hz=200.0, applied="digital"), 1.0, FORCE_FIRST + 2 * FORCE_DT),
    ],
)
def test_behind_a_low_pass_it_is_the_dense_normal_of_what_passes(
    recorder: LowPassFilter, share: float, first: float
) -> None:
    record, d, _ = recorded()
    assert record.force is not None
    dt, random = np.array([FORCE_DT]), np.random.default_rng(5)

    def passed(late: float, velocity: float = VELOCITY) -> np.ndarray:
        """By filtering a grid from before contact on, much finer unless the filter is one of samples."""
        finer = 1 if recorder.digital else FINER
        step, before = FORCE_DT / finer, 200 * finer
        grid = first + (np.arange(before + 200 * finer) - before) * step - late
        whole = np.where(grid >= 0, deceleration(np.maximum(grid, 0.0), velocity), 0.0)
        whole = np.where(np.cumprod((whole > 0) | (grid < 0)) > 0, whole, 0.0)
        return on_even_grid(whole[None], 1 / step, recorder)[0, before::finer][:ROWS]

    ratio, kept = np.exp(RATIO) - TIP, np.arange(ROWS) >= LATER
    small = 1e-6
    # A filter of samples knows nothing between two: what it makes of a later contact is its slope's.
    late = (passed(small) - passed(-small)) / (2 * small)
    mean_y = ratio * passed(0.0)
    correlation = (1 - share) * autocorrelation(recorder, np.arange(ROWS), FORCE_DT)
    correlation[0] = 1.0
    y = mean_y + np.linalg.cholesky(FORCE_SIGMA**2 * toeplitz(correlation)) @ random.normal(size=ROWS)
    noise = {} if share == 1 else filtered_noise_of(recorder, share, dt)
    stride = noise["colour"].stride if noise else 1
    usable = np.append(kept, False)
    kept &= np.arange(ROWS) % stride == 0
    rows = record.force._replace(
        y=jnp.asarray(np.append(y, 0.0)[None]),
        first_time=jnp.array([first]),
        usable=jnp.asarray(usable[None]),
        low_pass=low_pass_of(recorder, dt)._replace(phase=jnp.full(1, 0.5)),
        **noise,
    )
    mean, covariance, columns = dense()
    mean[SAMPLES:] = mean_y
    columns[0, SAMPLES:] = ratio * passed(0.0) / VELOCITY
    columns[3, SAMPLES:] = columns[5, SAMPLES:] = ratio * late
    covariance = columns.T @ np.diag(np.square(SD)) @ columns
    covariance[:SAMPLES, :SAMPLES] += SIGMA**2 * np.eye(SAMPLES)
    covariance[SAMPLES:, SAMPLES:] += FORCE_SIGMA**2 * toeplitz(correlation)
    asked = np.concatenate([np.ones(SAMPLES, bool), kept])
    expected = multivariate_normal(mean[asked], covariance[np.ix_(asked, asked)])
    found = float(log_density(record._replace(force=rows)))
    # The filtered grid is off by its step.
    assert found == pytest.approx(expected.logpdf(np.concatenate([d, y])[asked]), abs=0.02)


def filtered_noise_of(recorder: LowPassFilter, share: float, dt: np.ndarray) -> dict[str, Any]:
    colour, rate, _ = filtered_noise(recorder, share, ROWS, dt)
    return {"colour": colour, "rate": jnp.asarray(rate)}


def test_a_replicate_of_the_force_has_the_moments_of_the_dense_normal() -> None:
    record, *_ = recorded()
    mean, covariance, _ = dense()
    mean, sd = MASS * mean[SAMPLES:], MASS * np.sqrt(np.diag(covariance)[SAMPLES:])
    keys = jax.random.split(jax.random.PRNGKey(0), number := 2000)
    drawn = np.asarray(jax.jit(jax.vmap(likelihood(record).replicate))(keys)["force"])[:, 0]
    assert np.isnan(drawn[:, ROWS:]).all()
    assert (np.abs(drawn[:, :ROWS].mean(0) - mean) < 5 * sd / np.sqrt(number)).all()
    assert drawn[:, :ROWS].std(0) == pytest.approx(sd, rel=5 / np.sqrt(2 * number))


def test_errors_given_both_channels_are_those_of_the_dense_normal() -> None:
    record, d, y = recorded()
    mean, covariance, columns = dense()
    gain = np.diag(np.square(SD)) @ columns @ np.linalg.inv(covariance)
    expected = gain @ (np.concatenate([d, y]) - mean)
    spread = np.sqrt(np.diag(np.diag(np.square(SD)) - gain @ columns.T @ np.diag(np.square(SD))))
    event, number = likelihood(record), 2000
    keys = jax.random.split(jax.random.PRNGKey(0), number)
    drawn = np.asarray(jax.jit(jax.vmap(event.draw_errors))(keys))[:, 0]
    # Five standard errors of a mean of so many draws, and of a standard deviation.
    assert (np.abs(drawn.mean(0) - expected) < 5 * spread / np.sqrt(number)).all()
    assert drawn.std(0) == pytest.approx(spread, rel=5 / np.sqrt(2 * number))


def test_its_slopes_are_those_of_differences() -> None:
    record, *_ = recorded()

    @jax.jit
    @jax.value_and_grad
    def both(p: Array) -> Array:
        noise = NoiseParameters(p[2:3], None, p[3:4], p[4:5])
        return MeasuredImpact(element("kelvin_voigt"), jnp.exp(p[:2, None]), noise, record).log_density()[0]

    at = jnp.array([np.log(K), np.log(C), np.log(SIGMA), np.log(FORCE_SIGMA), RATIO])
    step = 1e-5
    differences = [
        (both(at.at[i].add(step))[0] - both(at.at[i].add(-step))[0]) / (2 * step) for i in range(len(at))
    ]
    np.testing.assert_allclose(both(at)[1], differences, rtol=1e-5, atol=1e-4)
