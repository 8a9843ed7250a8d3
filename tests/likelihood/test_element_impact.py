from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayestissue.mechanics.elements import element, element_names, impact
from bayestissue.mechanics.elements.element import GRAVITY
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord
from bayestissue.model.likelihood.element.response import motion

pytestmark = pytest.mark.slow

MASS, VELOCITY = np.array([0.5, 1.2]), np.array([1.5, 1.0])
DT, FIRST = np.array([4e-4, 5e-4]), np.array([1e-4, 4e-4])
COUNT = np.array([38, 45])
SD = np.array([[0.01, 0.02, 0.5, 1e-4], [0.02, 0.01, 0.2, 5e-5]])
LOG_SIGMA = jnp.log(jnp.array([0.4, 0.6]))


def values(name: str) -> dict[str, float]:
    return {"K": 2500.0, "C": 30.0} | {each.name: each.typical for each in element(name).extra}


def record(name: str, *, uniform: bool = False, gravity: float = 0.0) -> DecelerationRecord:
    time = FIRST[:, None] + DT[:, None] * np.arange(COUNT.max())
    d = np.array(impact(name, values(name), MASS, 0.99 * VELOCITY, time).deceleration) + 0.3
    d += 0.5 * np.random.default_rng(4).standard_normal(d.shape)
    surroundings = {"diameter_m": np.full(2, 0.0318)} | ({GRAVITY: np.full(2, gravity)} if gravity else {})
    contact = Contact.known(np.array([uniform, False]))
    return DecelerationRecord.from_arrays(d, COUNT, FIRST, DT, VELOCITY, SD, MASS, surroundings, contact)


def parameters(name: str) -> jax.Array:
    return jnp.array([np.full(2, value) for value in values(name).values()])


@cache
def compiled(name: str) -> Callable[[jax.Array, DecelerationRecord], jax.Array]:
    """Log densities of a record's own traces, for logs of parameters and noise."""
    which = element(name)

    @jax.jit
    def log_prob(logs: jax.Array, record: DecelerationRecord) -> jax.Array:
        return MeasuredImpact(which, jnp.exp(logs[:-1]), NoiseParameters(logs[-1]), record).log_density()

    return log_prob


# One solved in closed form and one on a grid; all in the long suite.
BY_DEFAULT = ("standard_linear", "hunt_crossley")


def logs_of(name: str) -> jax.Array:
    return jnp.concatenate([jnp.log(parameters(name)), LOG_SIGMA[None]])


@pytest.mark.parametrize(
    ("name", "gravity"),
    [
        ("standard_linear", 9.80665),
        ("hunt_crossley", 0.0),
        *(
            pytest.param(name, gravity, marks=pytest.mark.long)
            for name, gravity in [*((name, 0.0) for name in element_names()), ("hunt_crossley", 9.80665)]
            if (name, gravity) != ("hunt_crossley", 0.0)
        ),
    ],
)
def test_density_is_that_of_the_whole_covariance(name: str, gravity: float) -> None:
    """Against the multivariate normal, its columns by differences of the simulated impact."""
    traces = record(name, gravity=gravity)
    found = compiled(name)(logs_of(name), traces)
    time, step = FIRST[:, None] + DT[:, None] * np.arange(COUNT.max()), 1e-6

    def d(time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        return np.asarray(impact(name, values(name), MASS, velocity, time, gravity=gravity).deceleration)

    mean = d(time, VELOCITY)
    by_velocity = (d(time, VELOCITY + step) - d(time, VELOCITY - step)) / (2 * step)
    by_contact = (d(time - step, VELOCITY) - d(time + step, VELOCITY)) / (2 * step)
    for row in range(2):
        n = COUNT[row]
        middle, faster, later = (part[row, :n] for part in (mean, by_velocity, by_contact))
        columns = np.stack([faster, middle, np.ones(n), later], axis=1) * SD[row]
        covariance = np.exp(2 * LOG_SIGMA[row]) * np.eye(n) + columns @ columns.T
        expected = multivariate_normal(middle, covariance).logpdf(np.asarray(traces.d)[row, :n])
        # The differences are good to 1e-5 of columns that change the density by some tens.
        np.testing.assert_allclose(found[row], expected, atol=1e-3)


@pytest.mark.parametrize("gravity", [0.0, 9.80665])
def test_gain_and_velocity_of_kelvin_voigt_are_one_error(gravity: float) -> None:
    traces = record("kelvin_voigt", uniform=True, gravity=gravity)
    if gravity:
        # Gain and velocity are then two errors.
        traces = traces._replace(error_sd=traces.error_sd.at[:, 1].set(0.0))
    gain_sd = np.asarray(traces.error_sd)[:, 1]
    sd = np.stack([np.hypot(SD[:, 0], gain_sd * VELOCITY), SD[:, 2], SD[:, 3]], axis=1)
    merged = traces._replace(error_sd=jnp.asarray(sd))
    found, expected = (
        compiled("kelvin_voigt")(logs_of("kelvin_voigt"), record) for record in (traces, merged)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.parametrize(
    "name",
    # What is each element's own of a slope is tested with the elements: here one of either kind is enough.
    [name if name in BY_DEFAULT else pytest.param(name, marks=pytest.mark.long) for name in element_names()],
)
def test_slopes_agree_with_differences(name: str) -> None:
    traces, logs = record(name, uniform=True), logs_of(name)

    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def at(logs: jax.Array) -> tuple[jax.Array, jax.Array]:
        densities = compiled(name)(logs, traces)
        return densities.sum(), densities

    slopes = at(logs)[1]
    step = 1e-5
    for k in range(len(logs)):
        ahead, behind = (at(logs.at[k].add(side * step))[0][1] for side in (1, -1))
        difference = (ahead - behind) / (2 * step)
        # Densities of about 100 are good to 1e-13, their differences over 2e-5 to 1e-6.
        np.testing.assert_allclose(slopes[k], difference, rtol=1e-5, atol=1e-5)


def test_samples_have_the_mean_and_spread_of_the_chain() -> None:
    traces = record("stiffening", uniform=True)
    given = MeasuredImpact(
        element("stiffening"), parameters("stiffening"), NoiseParameters(LOG_SIGMA), traces
    )
    number = 4000
    sampled = jax.jit(lambda key: (given.sample(key, (number,)), given.response()))
    traces_drawn, found = sampled(jax.random.PRNGKey(0))
    drawn = np.asarray(traces_drawn)
    assert not drawn[:, 0, COUNT[0] :].any()
    columns = np.stack([found.by_velocity, found.d, np.ones_like(found.d), found.jerk])
    variance = (columns**2 * SD.T[..., None] ** 2).sum(0) + np.exp(2 * LOG_SIGMA)[:, None]
    inside = np.asarray(traces.inside())
    away = (drawn.mean(0) - found.d) / np.sqrt(variance / number)
    # 83 values, normal: five standard errors.
    assert np.abs(away[inside]).max() < 5
    ratio = drawn.var(0)[inside] / variance[inside]
    assert np.abs(ratio - 1).max() < 5 * np.sqrt(2 / number)


def test_errors_of_the_chain_are_found_again() -> None:
    """Traces shifted by a velocity error and an offset, noise as small as makes both plain."""
    name = "hunt_crossley"
    quiet = NoiseParameters(jnp.log(jnp.full(2, 1e-3)))
    given = MeasuredImpact(element(name), parameters(name), quiet, record(name))
    sd = jnp.array([[0.02, 0.0, 0.5, 0.0], [0.02, 0.0, 0.5, 0.0]])
    found = jax.jit(given.response)()
    seen = found.d + 0.01 * found.by_velocity - 0.2
    made = given.record._replace(error_sd=sd, d=jnp.where(given.record.inside(), seen, 0.0))
    same = MeasuredImpact(element(name), parameters(name), quiet, made)
    errors = jax.jit(same.draw_errors)(jax.random.PRNGKey(1))
    # Noise of 1e-3 over some forty samples that change by about 100 and 1 per unit.
    np.testing.assert_allclose(errors[:, 0], 0.01, atol=1e-4)
    np.testing.assert_allclose(errors[:, 2], -0.2, atol=3e-3)


def test_motion_is_the_simulated_one() -> None:
    traces = record("wall")
    found = jax.jit(lambda: motion(element("wall"), parameters("wall"), traces, traces.velocity))()
    expected = impact("wall", values("wall"), MASS, VELOCITY, traces.time())
    for own, other, atol in ((found.x, expected.x, 1e-8), (found.v, expected.v, 1e-6)):
        np.testing.assert_allclose(np.where(traces.inside(), own - other, 0.0), 0.0, atol=atol)


def test_a_response_beyond_all_bounds_has_no_density() -> None:
    """A wall far thinner than the penetration: the solver's answer is beyond what products can hold."""
    traces = record("wall")
    thin = parameters("wall").at[2].set(jnp.array([0.03, 1e-4]))
    found = compiled("wall")(jnp.concatenate([jnp.log(thin), LOG_SIGMA[None]]), traces)
    assert np.isfinite(found[0])
    assert found[1] == -np.inf
