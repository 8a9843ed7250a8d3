"""Clipped samples: the density of the others times the probability that these lie beyond the limit."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayestissue.mechanics.elements import element
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.noise import discrepancy_modes
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord, UnevenTimes

MASS, VELOCITY, DT, FIRST, COUNT = 0.5, 1.5, 5e-4, 2e-4, 44
K, C, SIGMA, LOG_RMS = 2500.0, 12.0, 1.2, np.log(0.8)
SEPARATE = np.array([0.02, 0.01, 0.5, 1e-4])
TIME = FIRST + DT * np.arange(COUNT)
# The share of the peak at the limit: a plateau of about a third, and one of two samples.
SHARES = (0.8, 0.995)


def deceleration(velocity: float, time: np.ndarray) -> np.ndarray:
    root = np.sqrt(complex((C / MASS) ** 2 / 4 - K / MASS))
    slow, fast = -C / MASS / 2 + root, -C / MASS / 2 - root
    x = (np.exp(slow * time) - np.exp(fast * time)) / (slow - fast)
    v = (slow * np.exp(slow * time) - fast * np.exp(fast * time)) / (slow - fast)
    return np.asarray(velocity * (K * x + C * v).real / MASS)


def traces(error_sd: np.ndarray, *, sign: float, uneven: bool = False) -> DecelerationRecord:
    """An impact cut at each share of its peak, downwards where ``sign`` is -1."""
    d = deceleration(0.99 * VELOCITY, TIME) + 0.3 + SIGMA * np.random.default_rng(4).standard_normal(COUNT)
    limit = np.array(SHARES)[:, None] * d.max()
    cut = np.broadcast_to(d, (2, COUNT)) >= limit
    both = np.ones(2)
    made = DecelerationRecord.from_arrays(
        sign * np.where(cut, limit, d), np.full(2, COUNT), FIRST * both, DT * both, sign * VELOCITY * both,
        np.tile(error_sd, (2, 1)), MASS * both, {"diameter_m": 0.03 * both}, Contact.known(both < 0),
    )  # fmt: skip
    times = UnevenTimes(jnp.asarray(np.tile(TIME - FIRST, (2, 1))), jnp.zeros((2, 0)))
    return made._replace(clipped=jnp.asarray(sign * cut), uneven=times if uneven else None)


@jax.jit
def log_density(record: DecelerationRecord) -> jax.Array:
    return measured(record).log_density()


def measured(record: DecelerationRecord) -> MeasuredImpact:
    wide = jnp.full(2, LOG_RMS) if record.discrepancy.basis.shape[1] else None
    noise = NoiseParameters(jnp.full(2, np.log(SIGMA)), wide)
    return MeasuredImpact(element("kelvin_voigt"), jnp.array([[K, K], [C, C]]), noise, record)


def expected(record: DecelerationRecord, error_sd: np.ndarray, row: int, sign: float) -> float:
    """By a dense normal and the distribution function of many dimensions."""
    clean, step = deceleration(VELOCITY, TIME), 1e-6
    late = (deceleration(VELOCITY, TIME - step) - deceleration(VELOCITY, TIME + step)) / (2 * step)
    gain = [clean] if len(error_sd) == 4 else []
    columns = np.stack([clean / VELOCITY, *gain, sign * np.ones(COUNT), late])
    covariance = SIGMA**2 * np.eye(COUNT) + (columns.T * error_sd**2) @ columns
    basis, share = (np.asarray(part)[row] for part in record.discrepancy)
    covariance += (basis.T * np.exp(2 * LOG_RMS) * share) @ basis
    d, cut = sign * np.asarray(record.d)[row], np.asarray(record.clipped)[row] != 0
    seen = multivariate_normal.logpdf(d[~cut], clean[~cut], covariance[np.ix_(~cut, ~cut)])
    back = np.linalg.solve(covariance[np.ix_(~cut, ~cut)], covariance[np.ix_(~cut, cut)]).T
    mean = clean[cut] + back @ (d[~cut] - clean[~cut])
    given = covariance[np.ix_(cut, cut)] - back @ covariance[np.ix_(~cut, cut)]
    random = np.random.default_rng(1)
    beyond = multivariate_normal(mean - d[cut], given).cdf(
        np.full(cut.sum(), np.inf), lower_limit=np.zeros(cut.sum()), rng=random
    )
    return float(seen + np.log(beyond))


@pytest.mark.slow
@pytest.mark.parametrize(("uneven", "sign"), [(False, 1.0), (True, 1.0), (False, -1.0)])
def test_density_is_that_of_a_normal_beyond_the_limit(uneven: bool, sign: float) -> None:
    record = traces(SEPARATE, sign=sign, uneven=uneven)
    found = log_density(record)
    for row in range(2):
        # Laplace's method over what is unknown of four errors; the oracle's own error is 1e-4.
        assert found[row] == pytest.approx(expected(record, SEPARATE, row, sign), abs=5e-3)


def test_one_error_of_velocity_and_gain_serves_as_well() -> None:
    merged = np.array([0.03, 0.5, 1e-4])
    record = traces(merged, sign=1.0)
    found = log_density(record)
    for row in range(2):
        assert found[row] == pytest.approx(expected(record, merged, row, 1.0), abs=5e-3)


@pytest.mark.long
def test_beside_a_discrepancy() -> None:
    record = traces(SEPARATE, sign=1.0)
    modes = discrepancy_modes(np.full(2, COUNT), np.tile(np.arange(COUNT), (2, 1)))
    record = record._replace(discrepancy=modes)
    found = log_density(record)
    for row in range(2):
        assert found[row] == pytest.approx(expected(record, SEPARATE, row, 1.0), abs=0.03)


@pytest.mark.slow
def test_without_a_clipped_sample_it_is_the_density_of_all() -> None:
    record = traces(SEPARATE, sign=1.0)
    none = record._replace(clipped=jnp.zeros_like(record.d))
    np.testing.assert_allclose(log_density(none), log_density(record._replace(clipped=None)), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_replicate_is_cut_where_the_trace_was(sign: float) -> None:
    record = traces(SEPARATE, sign=sign)
    replicate = sign * np.asarray(measured(record).replicate(jax.random.PRNGKey(1))["deceleration"])
    limit = (sign * np.asarray(record.d)).max(axis=1)
    # Both would go beyond: by a quarter of the peak, and by the noise of many samples near it.
    np.testing.assert_array_equal(replicate.max(axis=1), limit)
    uncut = measured(record._replace(clipped=None)).replicate(jax.random.PRNGKey(1))["deceleration"]
    np.testing.assert_allclose(replicate, np.minimum(sign * np.asarray(uncut), limit[:, None]), rtol=1e-12)
