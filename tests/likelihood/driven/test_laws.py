"""Laws that are not a spring and damper's: their density against importance sampling, their memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from scipy.integrate import quad
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from bayestissue.elements import REFERENCE_DIAMETER_M, element
from bayestissue.elements.path import internal_lengths
from bayestissue.likelihood.driven import motion
from bayestissue.likelihood.driven.measured import DrivenOutcomes, DrivenRecord, MeasuredDriven, driven_record

N, DT, FIRST = 30, 1e-3, 0.3e-3
TIME = FIRST + DT * np.arange(N)
# Down 8 mm in 25 ms, and a little beyond.
DEPTH, RATE = 8e-3, 60.0
X, V = DEPTH * np.sin(RATE * TIME), DEPTH * RATE * np.cos(RATE * TIME)
SIGMA, SIGMA_F, ROUGH = 5e-5, 1.0, 4.0
ERRORS = np.array([[1e-4, 1.0]])
# Of each law its parameters and its force in numpy.
LAWS: dict[str, tuple[list[float], Callable[..., np.ndarray]]] = {
    "kelvin_voigt": ([40e3, 100.0], lambda x, v: 40e3 * x + 100.0 * v),
    "stiffening": ([20e3, 100.0, 6e-3], lambda x, v: 20e3 * x * (1 + (x / 6e-3) ** 2) + 100.0 * v),
    "wall": ([10e3, 100.0, 12e-3], lambda x, v: 10e3 * x / (1 - x / 12e-3) + 100.0 * v),
    "hunt_crossley": (
        [40e3, 300.0],
        lambda x, v: np.where(x > 0, np.abs(x / 0.01) ** 1.5, 0.0) * (40e3 * 0.01 + 300.0 * v),
    ),
}


# Of a log density, what the bend of a law over what is not known of the motion leaves out, and the sampling's
# 0.014 at most.
# Of a linear law it is 0.001.
LEFT_OUT = 0.06


@pytest.fixture
def few_functions(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Eight unknowns in all, over which one can draw."""
    monkeypatch.setattr(motion, "MODES", 3)
    motion._eigenvectors.cache_clear()
    motion._table.cache_clear()
    yield
    motion._eigenvectors.cache_clear()
    motion._table.cache_clear()


def recorded(x: np.ndarray, force: np.ndarray, rng: np.random.Generator) -> DrivenRecord:
    x = x + 2e-3 + SIGMA * rng.standard_normal(N)
    start = np.array([N]), np.array([FIRST]), np.array([DT])
    return driven_record(
        ((force + SIGMA_F * rng.standard_normal(N))[None], *start),
        (x[None], *start),
        ERRORS,
        clock_sd=np.full(1, 1e-4),
        discrepancy=False,
        surroundings={"diameter_m": np.array([REFERENCE_DIAMETER_M])},
        common_depth=np.zeros(1),
    )


def measured(name: str, parameters: list[float], record: DrivenRecord) -> MeasuredDriven:
    logs = [jnp.log(jnp.array([value])) for value in (SIGMA, SIGMA_F, ROUGH)]
    return MeasuredDriven(element(name), jnp.asarray(parameters)[:, None], *logs, jnp.zeros(1), None, record)


@partial(jax.jit, static_argnames="name")
def density(name: str, parameters: list[float], record: DrivenRecord) -> tuple[Array, Array, Array]:
    """Log density of both, and of all that is integrated out the matrix over the noise and the likeliest."""
    event = measured(name, parameters, record)
    return event.joint_log_density(), event.standardised()[1], event.weights()


def integrated(
    record: DrivenRecord, A: Array, weights: Array, law: Callable[..., np.ndarray], rng: np.random.Generator
) -> float:
    """Log density by importance sampling over all unknowns, in their units of standard deviation."""
    depth, A = float(record.unit[0, 0]), np.asarray(A)[0]
    last = TIME[-1]
    basis, slopes = (part[0] for part in motion.functions((TIME / last)[None]))
    scale = np.array([ERRORS[0, 0] / depth, 30, 30, ROUGH, ROUGH, ROUGH, 30, ERRORS[0, 1]])

    def log_joint(z: np.ndarray) -> np.ndarray:
        w = z * scale
        x, v = depth * w[:, :6] @ basis.T, depth * w[:, :6] @ slopes.T / last
        of_x = np.asarray(record.x)[0] - x - depth * w[:, 6:7]
        of_F = np.asarray(record.y)[0] - law(x, v) - w[:, 7:]
        squares = (of_x**2).sum(1) / SIGMA**2 + (of_F**2).sum(1) / SIGMA_F**2 + (z**2).sum(1)
        return -squares / 2 - N * np.log(SIGMA * SIGMA_F) - (2 * N + 8) / 2 * np.log(2 * np.pi)

    values, axes = np.linalg.eigh(np.eye(8) + A.T @ A)
    # Tails heavier than the integrand's.
    standard = multivariate_t(np.zeros(8), np.eye(8), df=12, seed=rng)
    t = standard.rvs(50_000)
    z = np.asarray(weights)[0] / scale + t / np.sqrt(values) @ axes.T
    ratios = log_joint(z) - standard.logpdf(t) - np.log(values).sum() / 2
    effective = np.exp(2 * logsumexp(ratios) - logsumexp(2 * ratios))
    assert effective > 5_000
    return float(logsumexp(ratios) - np.log(len(z)))


@pytest.mark.usefixtures("few_functions")
@pytest.mark.parametrize("name", list(LAWS))
def test_density_is_the_integral_over_motions(name: str) -> None:
    parameters, law = LAWS[name]
    rng = np.random.default_rng(4)
    record = recorded(X, law(X, V), rng)
    found, *rest = density(name, parameters, record)
    np.testing.assert_allclose(found[0], integrated(record, *rest, law, rng), atol=LEFT_OUT)


@pytest.mark.usefixtures("few_functions")
@pytest.mark.parametrize("name", ["stiffening", "hunt_crossley"])
def test_density_of_another_K_is_the_integral_too(name: str) -> None:
    """Two standard errors from the truth, where the displacement alone misses the force."""
    parameters, law = LAWS[name]
    rng = np.random.default_rng(5)
    record = recorded(X, law(X, V), rng)
    found, *rest = density(name, [1.03 * parameters[0], *parameters[1:]], record)

    def stiffer(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return law(x, v) + 0.03 * law(x, 0 * v)

    np.testing.assert_allclose(found[0], integrated(record, *rest, stiffer, rng), atol=LEFT_OUT)


memory = jax.jit(internal_lengths, static_argnums=0)


@pytest.mark.parametrize("relaxation", [1e-6, 3e-3, 10.0])
@pytest.mark.parametrize("name", ["maxwell", "standard_linear"])
def test_what_remembers_follows_the_motion(name: str, relaxation: float) -> None:
    """s' = (x - s) / tau along a sine, against the integral of exp(-(t - u) / tau) x'(u)."""
    which, K = element(name), 2e4
    values = {"K": K, "C": K * relaxation, "arm_ratio": 1.0}
    p = {one.name: jnp.array([[values[one.name]]]) for one in which.parameters}
    (s,) = memory(which, p, X[None], V[None], np.array([FIRST]), np.array([DT]))

    def behind(t: float) -> float:
        begin = max(0.0, t - 40 * relaxation)
        pushed = quad(lambda u: np.exp(-(t - u) / relaxation) * DEPTH * RATE * np.cos(RATE * u), begin, t)
        return pushed[0]

    expected = X - [behind(t) for t in TIME]
    # From contact to the first sample the motion is taken as straight: 0.1 micrometre of x' t.
    np.testing.assert_allclose(X - s[0], X - expected, atol=1e-7, rtol=1e-5)


def test_laws_of_memory_are_those_of_their_limits() -> None:
    """An arm whose spring is very stiff is a damper beside the spring."""
    record = recorded(X, LAWS["kelvin_voigt"][1](X, V), np.random.default_rng(6))
    limit, *_ = density("standard_linear", [40e3, 100.0, 1e5], record)
    beside, *_ = density("kelvin_voigt", [40e3, 100.0], record)
    np.testing.assert_allclose(limit, beside, atol=1e-2)


def without_noise(times: np.ndarray, x: np.ndarray, force: np.ndarray) -> DrivenRecord:
    """The record of both channels, contact being sure."""
    record = recorded(x, force, np.random.default_rng(7))
    begin = jnp.asarray(times[:1])
    record = record._replace(error_sd=jnp.zeros((1, 2)), first_time=begin, first_displacement=begin)
    return record.with_channels(x[None] + 2e-3, force[None])


@partial(jax.jit, static_argnames="name")
def outcomes_of(
    name: str, parameters: list[float], record: DrivenRecord, weights: Array | None = None
) -> DrivenOutcomes:
    """Of a motion, or of the likeliest."""
    tight = [jnp.log(jnp.array([value])) for value in (1e-7, 1e-3, ROUGH)]
    event = MeasuredDriven(
        element(name), jnp.asarray(parameters)[:, None], *tight, jnp.zeros(1), None, record
    )
    return event.outcomes(event.weights() if weights is None else weights)


@pytest.mark.parametrize("name", list(LAWS))
def test_outcomes_are_those_of_the_motion(name: str) -> None:
    """Noise aside: the greatest depth, its moment, force and stiffness there, and what a damper has taken."""
    parameters, law = LAWS[name]
    comes = outcomes_of(name, parameters, without_noise(TIME, X, law(X, V)))
    fine = np.linspace(0, TIME[-1], 20_001)
    x, v = DEPTH * np.sin(RATE * fine), DEPTH * RATE * np.cos(RATE * fine)
    peak = np.pi / 2 / RATE
    viscous = np.trapezoid((law(x, v) - law(x, 0 * v)) * v, fine)
    to_peak = fine <= peak
    loss = np.trapezoid(((law(x, v) - law(x, 0 * v)) * v)[to_peak], fine[to_peak])
    squares = np.trapezoid((v**2)[to_peak], fine[to_peak])
    expected = {
        "peak_depth": DEPTH,
        "time_to_peak": peak,
        "peak_force": law(x, v).max(),
        "K_secant": law(np.array(DEPTH), np.array(0.0)) / DEPTH,
        "energy_absorbed": viscous,
        "C_equivalent": loss / squares,
    }
    for quantity, value in expected.items():
        np.testing.assert_allclose(getattr(comes, quantity)[0], value, rtol=2e-3, err_msg=quantity)


@pytest.mark.parametrize("shift", [0.0, 2e-5, -2e-5])
@pytest.mark.parametrize("since", [1e-6, 0.5e-3, 0.999e-3])
def test_a_damper_that_stops_the_motion_at_once_takes_what_the_integral_says(
    since: float, shift: float
) -> None:
    """C v^2 of a speed that falls to a third in five samples, wherever the first sample and contact are."""
    K, C, V_0, tau = 30e3, 600.0, 0.5, 5e-3
    times = since + DT * np.arange(N)

    def depth(time: np.ndarray) -> np.ndarray:
        return shift - V_0 * tau * np.expm1(-time / tau)

    contact = -tau * np.log1p(shift / V_0 / tau)
    x, v = depth(times), V_0 * np.exp(-times / tau)
    record = without_noise(times, x, K * x + C * v)
    fine = np.linspace(0, times[-1], 500)
    weights = np.zeros((1, motion.POWERS + motion.MODES + 2))
    (basis,) = motion.functions(fine[None] / times[-1])[0]
    weights[0, :-2] = np.linalg.lstsq(float(record.unit[0, 0]) * basis, depth(fine))[0]
    comes = outcomes_of("kelvin_voigt", [K, C], record, jnp.asarray(weights))
    expected = C * V_0**2 * tau / 2 * (np.exp(-2 * contact / tau) - np.exp(-2 * times[-1] / tau))
    # Slopes by three points leave (2 dt / tau)^4 / 36 of it, a parabola to the first sample half as much.
    rtol = (2 * DT / tau) ** 4 / 24
    np.testing.assert_allclose(comes.energy_absorbed[0], expected, rtol=rtol)
    np.testing.assert_allclose(comes.C_equivalent[0], C, rtol=rtol)
    greatest = max(C * V_0 * np.exp(-contact / tau), (K * x + C * v).max())
    np.testing.assert_allclose(comes.peak_force[0], greatest, rtol=rtol)


def test_slopes_are_differences_of_the_force() -> None:
    parameters, law = LAWS["stiffening"]
    event = measured("stiffening", parameters, recorded(X, law(X, V), np.random.default_rng(8)))

    @jax.jit
    def forces(at: Array) -> tuple[Array, Array]:
        return replace(event, parameters=at).force(event.weights()), event.slopes()

    slopes, step = np.asarray(forces(event.parameters)[1])[0, :N], 1e-5
    for index in range(3):
        sides = [forces(event.parameters.at[index].multiply(np.exp(side * step)))[0][0] for side in (1, -1)]
        np.testing.assert_allclose(
            slopes[:, index], (sides[0] - sides[1]) / (2 * step) / SIGMA_F, rtol=1e-5, atol=1e-6
        )
