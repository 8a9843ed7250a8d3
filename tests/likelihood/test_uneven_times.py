"""Traces whose times are uneven: the same density as a multivariate normal at the times that there are."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayestissue.mechanics.elements import element, impact
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord, UnevenTimes
from bayestissue.model.likelihood.element.response import response

pytestmark = pytest.mark.slow

MASS, VELOCITY = np.array([0.5, 1.2]), np.array([1.5, 1.0])
DT, FIRST = np.array([4e-4, 5e-4]), np.array([1e-4, 4e-4])
COUNT, WIDTH = np.array([38, 45]), 45
LOG_SIGMA = jnp.log(jnp.array([0.4, 0.6]))
VALUES = {"K": 2500.0, "C": 30.0, "stiffening_depth_m": 0.015}
REACH = 4


def since_first() -> np.ndarray:
    """Jitter of 15 % of a step, and one sample lost."""
    random = np.random.default_rng(3)
    place = np.arange(WIDTH) + 0.15 * random.uniform(-1, 1, (2, WIDTH))
    place[:, 20:] += 1
    return (place - place[:, :1]) * DT[:, None]


def record(name: str, error_sd: np.ndarray, time: np.ndarray | None, reach: int = 0) -> DecelerationRecord:
    later = np.arange(WIDTH) * DT[:, None] if time is None else time
    values = {p.name: VALUES[p.name] for p in element(name).parameters}
    d = np.array(impact(name, values, MASS, 0.99 * VELOCITY, FIRST[:, None] + later).deceleration) + 0.3
    random = np.random.default_rng(4)
    d += 0.5 * random.standard_normal(d.shape)
    contact = Contact.known(np.array([False, False]))
    if reach:
        before = 0.5 * random.standard_normal((2, reach))
        contact = Contact.anywhere(before, np.array([reach, reach - 1]), np.array([0.5, 0.6]))
    surroundings = {"diameter_m": np.full(2, 0.0318)}
    made = DecelerationRecord.from_arrays(
        d, COUNT, FIRST, DT, VELOCITY, error_sd, MASS, surroundings, contact
    )
    before_s = (np.arange(reach) - reach) * DT[:, None]
    return made._replace(uneven=UnevenTimes(jnp.asarray(later), jnp.asarray(before_s)))


def likelihood(name: str, record: DecelerationRecord) -> MeasuredImpact:
    parameters = jnp.array([np.full(2, VALUES[p.name]) for p in element(name).parameters])
    return MeasuredImpact(element(name), parameters, NoiseParameters(LOG_SIGMA), record)


@jax.jit
def log_density(measured: MeasuredImpact) -> jax.Array:
    return measured.log_density()


SEPARATE = np.array([[0.01, 0.02, 0.5, 1e-4], [0.02, 0.01, 0.2, 5e-5]])
MERGED = np.array([[0.03, 0.5, 1e-4], [0.02, 0.2, 5e-5]])


def deceleration(mass: float, velocity: float, time: np.ndarray) -> np.ndarray:
    """Of a spring and damper side by side, in closed form."""
    K, C = VALUES["K"], VALUES["C"]
    root = np.sqrt(complex((C / mass) ** 2 / 4 - K / mass))
    slow, fast = -C / mass / 2 + root, -C / mass / 2 - root
    x = (np.exp(slow * time) - np.exp(fast * time)) / (slow - fast)
    v = (slow * np.exp(slow * time) - fast * np.exp(fast * time)) / (slow - fast)
    return np.asarray(velocity * (K * x + C * v).real / mass)


@pytest.mark.parametrize("error_sd", [MERGED, SEPARATE])
def test_density_is_that_of_a_multivariate_normal(error_sd: np.ndarray) -> None:
    traces = record("kelvin_voigt", error_sd, since_first())
    found = log_density(likelihood("kelvin_voigt", traces))
    for row, number in enumerate(COUNT):
        time, mass = FIRST[row] + since_first()[row, :number], MASS[row]
        at_contact = deceleration(mass, VELOCITY[row], time)
        gain = [at_contact] if error_sd.shape[1] == 4 else []
        step = 1e-6
        late = (
            deceleration(mass, VELOCITY[row], time - step) - deceleration(mass, VELOCITY[row], time + step)
        ) / (2 * step)
        columns = np.stack([at_contact / VELOCITY[row], *gain, np.ones(number), late])
        covariance = np.exp(2 * float(LOG_SIGMA[row])) * np.eye(number)
        covariance += (columns.T * error_sd[row] ** 2) @ columns
        expected = multivariate_normal.logpdf(np.asarray(traces.d)[row, :number], at_contact, covariance)
        # Of the general way the motion lies between the nodes of a grid.
        assert found[row] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("reach", [0, REACH])
def test_even_times_give_the_density_of_even_times(reach: int) -> None:
    """For contact in any of several cells too; the cubic between states misses by (omega h)^4 / 384, 1e-7."""
    traces = record("kelvin_voigt", SEPARATE, None, reach)
    even = traces._replace(uneven=None)
    found, expected = (log_density(likelihood("kelvin_voigt", one)) for one in (traces, even))
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_slopes_of_the_fast_kernel_are_those_of_differences() -> None:
    traces = record("kelvin_voigt", MERGED, since_first())

    @jax.jit
    def total(logs: jax.Array) -> jax.Array:
        parameters = jnp.exp(logs[:2])[:, None] * jnp.ones(2)
        noise = NoiseParameters(LOG_SIGMA + logs[2])
        return MeasuredImpact(element("kelvin_voigt"), parameters, noise, traces).log_density().sum()

    at = jnp.array([np.log(2600.0), np.log(28.0), 0.1])
    slopes = jax.grad(total)(at)
    step = 1e-5
    differences = [(total(at + step * unit) - total(at - step * unit)) / (2 * step) for unit in jnp.eye(3)]
    np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("name", ["kelvin_voigt", pytest.param("stiffening", marks=pytest.mark.long)])
def test_the_response_is_the_element_s_at_these_times(name: str) -> None:
    traces = record(name, SEPARATE, since_first())
    parameters = likelihood(name, traces).parameters
    found = np.asarray(response(element(name), parameters, traces).d)
    values = {p.name: VALUES[p.name] for p in element(name).parameters}
    time = FIRST[:, None] + since_first()
    expected = np.array(impact(name, values, MASS, VELOCITY, time).deceleration)
    inside = np.arange(WIDTH) < COUNT[:, None]
    assert np.abs(found - expected)[inside].max() < 1e-6 * expected.max()
