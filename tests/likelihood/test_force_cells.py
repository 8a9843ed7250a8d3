"""A force beside a deceleration that does not show when contact was, against an integral over all moments.

The motion is solved by scipy and filtered on a fine grid. In each cell of contact all rows of both channels
have one dense normal, whose mean is linear in the moment.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from bayestissue.mechanics.elements import element
from bayestissue.model.hierarchy.recorder_noise import low_pass_of
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord, ForceRows
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import on_even_grid

pytestmark = pytest.mark.slow

MASS, VELOCITY, RATIO, TIP = 0.8, 1.4, 0.07, 0.1
# Velocity, gain, the force's zero, its clock, the deceleration's zero; contact's is that within a cell.
SD = (0.03, 0.02, 0.1, 5e-5, 0.2, 0.0)
SIGMA, FORCE_SIGMA = 0.4, 0.5
DT, SAMPLES, ROWS, REACH = 5e-4, 40, 25, 8
# Steps of the grid in DT, and how long it is on either side of contact.
FINER, LONG = 200, 120
PARAMETERS = {
    "kelvin_voigt": {"K": 3000.0, "C": 25.0},
    "maxwell": {"K": 3000.0, "C": 120.0},
    "hunt_crossley": {"K": 3000.0, "C": 60.0},
}
BESSEL = LowPassFilter(low_pass_hz=300.0, order=4, kind="bessel")
BACK = LowPassFilter(low_pass_hz=300.0, order=2, zero_phase=True, applied="analog")
DIGITAL = LowPassFilter(low_pass_hz=300.0, applied="digital")


def force(name: str, y: np.ndarray) -> np.ndarray:
    """The elements' laws [N]; the third state is how far Maxwell's damper has yielded."""
    K, C = PARAMETERS[name].values()
    x, v, s = y
    if name == "maxwell":
        return K * (x - s)
    if name == "hunt_crossley":
        return (np.maximum(x, 0.0) / 0.01) ** 1.5 * (K * 0.01 + C * v)
    return K * x + C * v


def motion(name: str, velocity: float) -> Callable[[np.ndarray], np.ndarray]:
    """Deceleration at times since contact [s]; 0 before it and once the force has fallen to 0."""
    C = PARAMETERS[name]["C"]

    def rates(_: float, y: np.ndarray) -> list[float]:
        F = float(force(name, y))
        return [y[1], -F / MASS, F / C]

    until = LONG * DT
    solved = solve_ivp(rates, (0, until), [0, velocity, 0], rtol=1e-10, atol=1e-12, dense_output=True)

    def at(time: np.ndarray) -> np.ndarray:
        touched = np.clip(time, 0.0, until)
        d = force(name, solved.sol(touched.ravel()).reshape(3, *time.shape)) / MASS
        return np.where((time < 0) | ~np.logical_and.accumulate((d > 0) | (time <= 0)), 0.0, d)

    return at


def recorded(recorder: LowPassFilter | None, d: Callable[[np.ndarray], np.ndarray], dt: float):
    """What is recorded at times first + k dt for contact at time 0, as a function of the first time."""
    if recorder is not None and recorder.digital:

        def of_samples(first: float, count: int) -> np.ndarray:
            grid = first + dt * np.arange(-LONG, LONG)
            return on_even_grid(d(grid)[None], 1 / dt, recorder)[0, LONG : LONG + count]

        return of_samples
    grid = DT / FINER * (np.arange(-LONG * FINER, LONG * FINER) + 0.5)
    values = d(grid) if recorder is None else on_even_grid(d(grid)[None], FINER / DT, recorder)[0]

    def of_time(first: float, count: int) -> np.ndarray:
        return np.interp(first + dt * np.arange(count), grid, values)

    return of_time


def columns_at(answers, first: float, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, their derivative by the velocity, and minus that by time, contact being at 0."""
    middle, slower, faster, step = answers
    h = DT / FINER
    late = (middle(first - h, count) - middle(first + h, count)) / (2 * h)
    return middle(first, count), (faster(first, count) - slower(first, count)) / (2 * step), late


def case(name: str, of_d: LowPassFilter | None, dt: float, first: float):
    """The record of one impact, contact 2.3 intervals before its first sample, and its log density."""
    low_pass = None if of_d is None else low_pass_of(of_d, np.array([DT]))
    lead = 0 if low_pass is None else low_pass.lead
    reach, step = REACH + lead, 1e-3 * VELOCITY
    ratio, random = np.exp(RATIO) - TIP, np.random.default_rng(3)
    motions = [motion(name, VELOCITY + side * step) for side in (0, -1, 1)]
    d_of, y_of = (
        (*(recorded(recorder, d, interval) for d in motions), step)
        for recorder, interval in ((of_d, DT), (None, dt))
    )
    true = 2.3 * DT
    trace = d_of[0](true - reach * DT, reach + SAMPLES) + random.normal(0, SIGMA, reach + SAMPLES)
    y = ratio * y_of[0](true + first, ROWS) + FORCE_SIGMA * random.normal(size=ROWS)
    longer, one = 3 + int(np.ceil((first + reach * DT) / dt)), np.ones(1)
    rows = ForceRows(
        jnp.asarray(np.pad(y, (0, longer))[None]),
        jnp.array([ROWS]),
        jnp.array([DT / 2 + first]),
        jnp.array([dt]),
        jnp.array([TIP]),
    )
    record = DecelerationRecord.from_arrays(
        trace[None, reach:],
        np.array([SAMPLES]),
        DT / 2 * one,
        DT * one,
        VELOCITY * one,
        np.array([SD]),
        MASS * one,
        {"diameter_m": 0.0318 * one},
        Contact.anywhere(trace[None, :reach], np.array([reach]), np.array([SIGMA])),
    )._replace(force=rows, low_pass=low_pass)
    noise = np.diag(np.repeat([SIGMA**2, FORCE_SIGMA**2], [reach + SAMPLES, ROWS]))
    none_d, none_y = np.zeros(reach + SAMPLES), np.zeros(ROWS)
    finer = 1 if low_pass is None else len(low_pass.phase)
    # Every moment as likely, one in a sampling interval; the rows linear in it in each cell.
    width, inner, logs = DT / finer, (np.arange(200) + 0.5) / 200 - 0.5, []
    for middle in (np.arange(finer * reach) + 0.5) * width - lead * DT:
        d, d_faster, d_late = columns_at(d_of, middle - reach * DT, reach + SAMPLES)
        f, f_faster, f_late = (ratio * part for part in columns_at(y_of, middle + first, ROWS))
        columns = np.array(
            [
                [*d_faster, *f_faster],
                [*d, *none_y],
                [*none_d, *np.ones(ROWS)],
                [*none_d, *f_late],
                [*np.ones(reach + SAMPLES), *none_y],
            ]
        )
        covariance = noise + columns.T @ np.diag(np.square(SD[:5])) @ columns
        left = np.concatenate([trace - d, y - f]) + width * inner[:, None] * np.append(d_late, f_late)
        logs.append(multivariate_normal(np.zeros(len(noise)), covariance).logpdf(left))
    quiet = norm.logpdf(trace[:reach], scale=SIGMA).sum()
    return record, float(logsumexp(logs) - np.log(len(inner) * finer) - quiet)


@partial(jax.jit, static_argnums=0)
def _log_density(which, logs: jax.Array, record: DecelerationRecord) -> jax.Array:
    noise = NoiseParameters(logs[2:3], None, logs[3:4], logs[4:5])
    return MeasuredImpact(which, jnp.exp(logs[:2, None]), noise, record).log_density()[0]


def at_truth(name: str) -> jax.Array:
    return jnp.array([*np.log(list(PARAMETERS[name].values())), np.log(SIGMA), np.log(FORCE_SIGMA), RATIO])


CASES = {
    # Of forces that rise from 0, at other times than the deceleration's.
    "hunt_crossley": ("hunt_crossley", None, 1.4 * DT, 0.6 * DT),
    "maxwell": ("maxwell", None, DT, 0.0),
    # The deceleration behind a low-pass, run once or twice, or by software.
    "filtered": ("kelvin_voigt", BESSEL, 1.4 * DT, 0.6 * DT),
    "and backwards": ("kelvin_voigt", BACK, DT, 6 * DT),
    "by software": ("kelvin_voigt", DIGITAL, DT, 0.0),
}


@pytest.mark.parametrize("which", CASES)
def test_the_density_is_the_integral_over_all_moments_of_contact(which: str) -> None:
    record, expected = case(*CASES[which])
    name = CASES[which][0]
    found = float(_log_density(element(name), at_truth(name), record))
    # The oracle's grid is off by a share of its step.
    assert found == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("which", ["hunt_crossley", "filtered"])
def test_its_slopes_are_those_of_differences(which: str) -> None:
    record, _ = case(*CASES[which])
    name, step = CASES[which][0], 1e-5
    at = at_truth(name)
    value = partial(_log_density, element(name), record=record)
    slope = np.asarray(jax.grad(value)(at))
    differences = [
        (value(at.at[i].add(step)) - value(at.at[i].add(-step))) / (2 * step) for i in range(len(at))
    ]
    np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-3)
