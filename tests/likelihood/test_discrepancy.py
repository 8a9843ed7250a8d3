from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.stats import multivariate_normal, norm

from bayestissue.inference.quantities.whole import integrals
from bayestissue.mechanics.elements import element, impact
from bayestissue.mechanics.elements.element import Element
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.noise import discrepancy_modes
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord
from bayestissue.model.likelihood.element.response import Response, columns, response

MASS, VELOCITY = np.array([0.5, 1.2]), np.array([1.5, 1.0])
DT, FIRST = np.array([4e-4, 5e-4]), np.array([1e-4, 4e-4])
COUNT = np.array([38, 45])
SD = np.array([[0.01, 0.02, 0.5, 1e-4], [0.02, 0.01, 0.2, 5e-5]])
LOG_SIGMA = jnp.log(jnp.array([0.4, 0.6]))
LOG_S = jnp.log(jnp.array([2.0, 0.5]))
EXTRA = {"K": 2500.0, "C": 30.0, "stiffening_depth_m": 0.015}


def kernel(count: int) -> np.ndarray:
    """The covariance of delta / s on so many samples, by its six greatest eigenvalues."""
    time = np.arange(count) / (count - 1)
    whole = np.exp(-((time[:, None] - time) ** 2) / (2 * 0.3**2))
    values, vectors = eigh(whole)
    values, vectors = values[-6:], vectors[:, -6:]
    return (vectors * values * count / values.sum()) @ vectors.T


def measured(name: str, log_s: jax.Array | None = LOG_S, *, uniform: bool = False) -> MeasuredImpact:
    """Recordings of a stiffening element, taken for those of the named one."""
    time = FIRST[:, None] + DT[:, None] * np.arange(COUNT.max())
    d = np.array(impact("stiffening", EXTRA, MASS, 0.99 * VELOCITY, time).deceleration) + 0.3
    d += 0.5 * np.random.default_rng(4).standard_normal(d.shape)
    contact, ball = Contact.known(np.array([uniform, False])), {"diameter_m": np.full(2, 0.0318)}
    traces = DecelerationRecord.from_arrays(d, COUNT, FIRST, DT, VELOCITY, SD, MASS, ball, contact)
    traces = traces._replace(discrepancy=discrepancy_modes(COUNT, np.tile(np.arange(COUNT.max()), (2, 1))))
    which = element(name)
    parameters = jnp.array([np.full(2, EXTRA[each.name]) for each in which.parameters])
    return MeasuredImpact(which, parameters, NoiseParameters(LOG_SIGMA, log_s), traces)


@partial(jax.jit, static_argnums=0)
def _log_prob(
    which: Element, parameters: jax.Array, noise: NoiseParameters, record: DecelerationRecord
) -> jax.Array:
    return MeasuredImpact(which, parameters, noise, record).log_density()


@partial(jax.jit, static_argnums=0)
def _response(*given: Any) -> Response:
    return response(*given)


def log_prob(given: MeasuredImpact) -> np.ndarray:
    """Log densities of its own traces."""
    return np.asarray(_log_prob(given.element, given.parameters, given.noise_parameters, given.record))


def dense(given: MeasuredImpact, row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual, scaled error columns and the covariance of discrepancy and noise of a trace."""
    n, found = COUNT[row], _response(given.element, given.parameters, given.record)
    each = np.stack([np.asarray(column)[row, :n] for column in columns(found, given.record)], axis=1)
    own = np.exp(2 * LOG_S[row]) * kernel(n)
    return np.asarray(given.record.d - found.d)[row, :n], each * SD[row], own


def test_modes_are_those_of_the_kernel() -> None:
    basis, share = (
        np.asarray(part) for part in discrepancy_modes(COUNT, np.tile(np.arange(50), (len(COUNT), 1)))
    )
    assert basis.shape == (2, 6, 50)
    assert share.shape == (2, 6)
    for row, n in enumerate(COUNT):
        own = basis[row, :, :n]
        assert not basis[row, :, n:].any()
        np.testing.assert_allclose(own @ own.T, np.eye(6), atol=1e-11)
        np.testing.assert_allclose((own.T * share[row]) @ own, kernel(n), atol=1e-10)
        assert (np.diff(share[row]) < 0).all()
    np.testing.assert_allclose(share.sum(1), COUNT)


def test_modes_of_the_shortest_and_of_a_long_trace_are_orthonormal() -> None:
    basis, share = (
        np.asarray(part) for part in discrepancy_modes(np.array([8, 3000]), np.tile(np.arange(3000), (2, 1)))
    )
    np.testing.assert_allclose(basis @ basis.swapaxes(1, 2), [np.eye(6)] * 2, atol=1e-10)
    assert (share > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kelvin_voigt", "stiffening"])
def test_density_is_that_of_the_whole_covariance(name: str) -> None:
    given = measured(name)
    found = log_prob(given)
    for row in range(2):
        residual, each, own = dense(given, row)
        covariance = own + each @ each.T + np.exp(2 * LOG_SIGMA[row]) * np.eye(len(own))
        expected = multivariate_normal(np.zeros(len(own)), covariance).logpdf(residual)
        # The columns' products, up to 1e5, lose five of their digits to the modes.
        np.testing.assert_allclose(found[row], expected, rtol=1e-9)


def test_density_is_that_of_the_samples_one_after_another() -> None:
    """Each sample given those before it: the errors and the modes' weights learnt as a static state."""
    given = measured("kelvin_voigt")
    found = log_prob(given)
    for row in range(2):
        residual, each, own = dense(given, row)
        values, vectors = eigh(own)
        through = np.concatenate([each, vectors[:, -6:] * np.sqrt(values[-6:])], axis=1)
        mean, covariance, total = np.zeros(10), np.eye(10), 0.0
        for seen, h in zip(residual, through, strict=True):
            variance = h @ covariance @ h + np.exp(2 * LOG_SIGMA[row])
            total += norm(h @ mean, np.sqrt(variance)).logpdf(seen)
            gain = covariance @ h / variance
            mean = mean + gain * (seen - h @ mean)
            covariance = covariance - np.outer(gain, h @ covariance)
        np.testing.assert_allclose(found[row], total, rtol=1e-9)


@pytest.mark.slow
def test_no_amplitude_is_no_discrepancy() -> None:
    none, nothing = measured("kelvin_voigt", None), measured("kelvin_voigt", jnp.full(2, -40.0))
    np.testing.assert_allclose(log_prob(nothing), log_prob(none), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    # The slopes of an element's own motion are tested with the elements.
    ["kelvin_voigt", pytest.param("stiffening", marks=pytest.mark.long)],
)
def test_slopes_agree_with_differences(name: str) -> None:
    given = measured(name, uniform=True)
    which, traces = given.element, given.record

    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def both(logs: jax.Array) -> tuple[jax.Array, jax.Array]:
        noise = NoiseParameters(logs[-2], logs[-1])
        made = MeasuredImpact(which, jnp.exp(logs[:-2]), noise, traces)
        found = made.log_density()
        return found.sum(), found

    logs = jnp.concatenate([jnp.log(given.parameters), LOG_SIGMA[None], LOG_S[None]])
    _, slopes = both(logs)
    step = 1e-5
    for k in range(len(logs)):
        ahead, behind = (both(logs.at[k].add(side * step))[0][1] for side in (1, -1))
        difference = (ahead - behind) / (2 * step)
        # Densities of about 100 are good to 1e-12, their differences over 2e-5 to 1e-5.
        np.testing.assert_allclose(slopes[k], difference, rtol=1e-5, atol=5e-5)


@pytest.mark.slow
def test_draws_given_a_trace_are_those_of_the_joint_normal() -> None:
    given, number = measured("kelvin_voigt"), 4000

    @jax.jit
    @jax.vmap
    def draw(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        errors = given.draw_errors(key)
        return errors[:, 6:], given.discrepancy(errors)

    errors, delta = (np.asarray(each) for each in draw(jax.random.split(jax.random.PRNGKey(2), number)))
    for row in range(2):
        n = COUNT[row]
        assert not delta[:, row, n:].any()
        residual, each, own = dense(given, row)
        covariance = own + each @ each.T + np.exp(2 * LOG_SIGMA[row]) * np.eye(n)
        # Of the four errors in their units, and of delta at every sample.
        across = np.concatenate([each.T, own])
        weights = np.linalg.solve(covariance, across.T).T
        mean = weights @ residual
        prior = np.zeros((4 + n, 4 + n))
        prior[:4, :4], prior[4:, 4:] = np.eye(4), own
        expected = prior - weights @ across.T
        drawn = np.concatenate([errors[:, row] / SD[row], delta[:, row, :n]], axis=1)
        sd = np.sqrt(np.diag(expected))
        # Some 90 means and their variances: five standard errors each.
        assert np.abs((drawn.mean(0) - mean) / sd).max() < 5 / np.sqrt(number)
        assert np.abs(drawn.var(0) / sd**2 - 1).max() < 5 * np.sqrt(2 / number)
        together = np.corrcoef(drawn.T) - expected / np.outer(sd, sd)
        assert np.abs(together).max() < 6 / np.sqrt(number)


def test_samples_have_the_discrepancy_in_them() -> None:
    given, number = measured("kelvin_voigt"), 4000
    key = jax.random.PRNGKey(0)
    drawn = np.asarray(jax.jit(lambda key: given.sample(key, (number,)))(key))
    delta = np.asarray(given.discrepancy(given.prior_errors(key, (number,))))
    for row in range(2):
        n = COUNT[row]
        assert not drawn[:, row, n:].any()
        _, each, own = dense(given, row)
        spread = np.diag(own + each @ each.T) + np.exp(2 * LOG_SIGMA[row])
        # 83 values: five standard errors of a variance.
        assert np.abs(drawn[:, row, :n].var(0) / spread - 1).max() < 5 * np.sqrt(2 / number)
        mean_square = np.square(delta[:, row, :n]).mean()
        # s is the root of delta's mean square; most of it is in two modes, so that a draw's mean square
        # has a standard deviation of about its mean.
        assert abs(mean_square / np.exp(2 * LOG_S[row]) - 1) < 5 / np.sqrt(number)


def test_integrals_are_exact_for_a_constant_and_near_for_a_wave() -> None:
    time = FIRST[:, None] + DT[:, None] * np.arange(COUNT.max())
    velocity, x = integrals(jnp.full(time.shape, 3.0), jnp.asarray(FIRST), jnp.asarray(DT)[:, None])
    np.testing.assert_allclose(velocity, 3 * time, rtol=1e-12)
    # Trapezia of a straight line are exact.
    np.testing.assert_allclose(x, 3 * time**2 / 2, rtol=1e-12)
    rate = 100.0
    velocity, x = integrals(
        jnp.asarray(np.cos(rate * (time - FIRST[:, None]))), jnp.asarray(FIRST), jnp.asarray(DT)[:, None]
    )
    after = time - FIRST[:, None]
    expected = FIRST[:, None] + np.sin(rate * after) / rate
    # Of order (rate dt)^2 / 12, 2e-4, for each integration, relative to 1 / rate.
    np.testing.assert_allclose(velocity, expected, atol=3e-4 / rate)
