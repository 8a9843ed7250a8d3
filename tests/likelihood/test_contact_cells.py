"""Contact in one of several cells, against the same sum made trace by trace and cell by cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import kstest, multivariate_normal, norm

from bayestissue.mechanics.elements import element, impact
from bayestissue.mechanics.elements.element import Element
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord

pytestmark = pytest.mark.slow

DT, SAMPLES, CELLS = 2e-4, 60, 4
LONGEST = 72
COUNT = np.array([60, 48])
RECORDED = np.array([100, 3])
# Of these, as many tell the zero that was taken away.
QUIET = np.array([2, 1])
MASS, VELOCITY, DIAMETER = np.array([0.6, 0.9]), np.array([1.2, 1.1]), np.full(2, 0.0318)
SIGMA, QUIET_SD = 0.3, 0.25
ERROR_SD = np.array([0.02, 0.01, 0.1, 0.0])
VALUES = {
    "maxwell": {"K": 3000.0, "C": 120.0},
    "standard_linear": {"K": 2000.0, "C": 30.0, "arm_ratio": 2.0},
    "hunt_crossley": {"K": 3000.0, "C": 60.0},
}
# What is alike for all elements: by default one that jumps at contact. The density is tested of another too.
NAMES = [
    "maxwell",
    *(pytest.param(name, marks=pytest.mark.long) for name in ("standard_linear", "hunt_crossley")),
]


def simulated(name: str, lead: np.ndarray, reach: int, sigma: float = SIGMA) -> np.ndarray:
    """Traces from ``reach`` samples before the first on, contact being ``lead`` before that one."""
    time = (np.arange(-reach, SAMPLES)) * DT + lead[:, None]
    d = response(name, np.maximum(time, 0.0), VELOCITY)
    rng = np.random.default_rng(1)
    return np.where(time > 0, d, 0.0) + sigma * rng.standard_normal(d.shape)


def response(name: str, time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    # Of one length, whatever is asked for, and so compiled once.
    longer = np.pad(time, ((0, 0), (0, LONGEST - time.shape[1])), mode="edge")
    found = impact(element(name), VALUES[name], MASS, velocity, jnp.asarray(longer), diameter=DIAMETER)
    return np.asarray(found.deceleration)[:, : time.shape[1]]


@partial(jax.jit, static_argnums=0)
def _log_prob(
    which: Element, parameters: jax.Array, noise: NoiseParameters, record: DecelerationRecord
) -> jax.Array:
    return MeasuredImpact(which, parameters, noise, record).log_density()


def log_prob(given: MeasuredImpact) -> np.ndarray:
    return np.asarray(_log_prob(given.element, given.parameters, given.noise_parameters, given.record))


def contact_errors(given: MeasuredImpact, seed: int, number: int) -> np.ndarray:
    """Draws of the first impact's error of contact."""
    keys = jax.random.split(jax.random.PRNGKey(seed), number)
    return np.asarray(
        _contact_errors(given.element, given.parameters, given.noise_parameters, keys, given.record)
    )


@partial(jax.jit, static_argnums=0)
def _contact_errors(
    which: Element, parameters: jax.Array, noise: NoiseParameters, keys: jax.Array, record: DecelerationRecord
) -> jax.Array:
    given = MeasuredImpact(which, parameters, noise, record)
    return jax.vmap(given.draw_errors)(keys)[:, 0, 3]


def measured(name: str, reach: int, *, sigma: float = SIGMA, lead: float = 2.6) -> MeasuredImpact:
    traces = simulated(name, np.full(2, lead * DT), reach, sigma)
    recorded, quiet_sd = np.minimum(RECORDED, reach), np.full(2, QUIET_SD)
    error_sd = np.tile(ERROR_SD, (2, 1))
    error_sd[:, 3] = reach * DT / np.sqrt(12)
    record = DecelerationRecord.from_arrays(
        traces[:, reach:],
        COUNT,
        np.full(2, DT / 2),
        np.full(2, DT),
        VELOCITY,
        error_sd,
        MASS,
        {"diameter_m": DIAMETER},
        Contact.anywhere(traces[:, :reach], recorded, quiet_sd, n_quiet=QUIET),
    )
    parameters = jnp.stack([jnp.full(2, value) for value in VALUES[name].values()])
    return MeasuredImpact(element(name), parameters, NoiseParameters(jnp.full(2, np.log(sigma))), record)


def density_about(given: MeasuredImpact, name: str, row: int, about: float) -> Callable[[float], float]:
    """Log density of a row, contact so long before its first sample, by one large covariance.

    The trace is linear in that moment about ``about``. The density of a quiet part is taken off that of the
    samples before the first.
    """
    record = given.record
    n, before = int(COUNT[row]), int(record.contact.n_before[row])
    time = np.arange(-before, n) * DT + about
    touched = np.tile(np.maximum(time, 0.0), (2, 1))
    step = 1e-3 * VELOCITY
    d = response(name, touched, VELOCITY)[row]
    faster, slower = (response(name, touched, VELOCITY + side * step)[row] for side in (1, -1))
    h = 1e-6
    ends = [response(name, np.maximum(touched + side * h, 0.0), VELOCITY)[row] for side in (1, -1)]
    jerk = (ends[0] - ends[1]) / (2 * h)
    own = time > 0
    columns = [
        np.where(own, (faster - slower) / (2 * step[row]), 0.0) * ERROR_SD[0],
        np.where(own, d, 0.0) * ERROR_SD[1],
        (np.arange(n + before) >= QUIET[row]) * ERROR_SD[2],
    ]
    covariance = float(given.sigma[row]) ** 2 * np.eye(n + before)
    covariance += sum(np.outer(column, column) for column in columns)
    early = np.asarray(record.contact.before)[row, record.contact.reach - before :]
    seen = np.concatenate([early, np.asarray(record.d)[row, :n]])
    centred = multivariate_normal(np.zeros(n + before), covariance)
    quiet = norm.logpdf(early, scale=QUIET_SD).sum()

    def density(lead: float) -> float:
        mean = np.where(own, d + jerk * (lead - about), 0.0)
        return float(centred.logpdf(seen - mean) - quiet)

    return density


def density_of_row(given: MeasuredImpact, name: str, row: int) -> float:
    """Log of the integral over all cells, contact in sampling intervals.

    Within a cell the log density is a parabola in contact: three values give it, many points its integral.
    """
    inner = (np.arange(20_000) + 0.5) / 10_000 - 1
    total = []
    for cell in range(given.record.contact.reach):
        about, half = (cell + 0.5) * DT, DT / 2
        density = density_about(given, name, row, about)
        values = [density(about + side * half) for side in (-1, 0, 1)]
        total.append(np.polyval(np.polyfit([-1, 0, 1], values, 2), inner))
    return float(logsumexp(total) - np.log(len(inner)))


@pytest.mark.parametrize(
    ("name", "reach"),
    # One that jumps at contact and one that does not; the sum over cells is the same code for all.
    [
        (name, reach)
        if (name, reach) in (("maxwell", CELLS), ("hunt_crossley", 3 * CELLS))
        else pytest.param(name, reach, marks=pytest.mark.long)
        for name in VALUES
        for reach in (CELLS, 3 * CELLS)
    ],
)
def test_density_is_the_integral_over_all_cells(name: str, reach: int) -> None:
    given = measured(name, reach)
    found = log_prob(given)
    expected = [density_of_row(given, name, row) for row in range(2)]
    # Both are good to the differences that the oracle takes: a millionth of a trace's product over sigma^2.
    assert found == pytest.approx(expected, abs=1e-3)


def with_place(record: DecelerationRecord, by: jax.Array) -> DecelerationRecord:
    """The same where contact is so many intervals before the middle of the cell that it is in."""
    contact = record.contact
    known = contact._replace(uniform=contact.uniform & False)
    return record._replace(contact=known, interval=record.dt).with_contact_earlier(by)


def test_a_place_in_each_cell_has_the_density_of_that_moment_in_each() -> None:
    given, by = measured("maxwell", CELLS), np.array([0.3, -0.4])
    found = log_prob(replace(given, record=with_place(given.record, jnp.asarray(by))))
    for row, earlier in enumerate(by):
        moments = (np.arange(CELLS) + 0.5 + earlier) * DT
        expected = logsumexp([density_about(given, "maxwell", row, each)(each) for each in moments])
        # To the differences that the oracle takes, as above.
        assert found[row] == pytest.approx(expected, abs=1e-3)


def test_slopes_by_a_place_in_each_cell_are_those_of_differences() -> None:
    given, by, h = measured("maxwell", CELLS), jnp.array([0.3, -0.4]), 1e-5

    @jax.jit
    def density(by: jax.Array) -> jax.Array:
        return replace(given, record=with_place(given.record, by)).log_density()

    slope = jnp.diag(jax.jit(jax.jacrev(density))(by))
    ends = [density(by + side * h) for side in (1, -1)]
    # Third derivatives of a log density of a few thousand, and its rounding over 2 h.
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), atol=1e-3, rtol=1e-5)


def test_slopes_are_those_of_differences() -> None:
    given = measured("standard_linear", CELLS)
    which = given.element

    @jax.jit
    @jax.value_and_grad
    def total(logs: jax.Array) -> jax.Array:
        return _log_prob(which, jnp.exp(logs[:-1]), NoiseParameters(logs[-1]), given.record).sum()

    logs = jnp.concatenate([jnp.log(given.parameters), given.noise_parameters.log_sigma[None]])
    slope = np.asarray(total(logs)[1])
    h = 1e-5
    for place in np.ndindex(*logs.shape):
        ends = [float(total(logs.at[place].add(side * h))[0]) for side in (1, -1)]
        # Third derivatives of a log density of a few thousand, and its rounding over 2 h.
        assert slope[place] == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-3, rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_contact_is_found_where_it_was(name: str) -> None:
    """Nearly without noise the moment is told to a hundredth of a sampling interval or so."""
    given = measured(name, CELLS, sigma=1e-3)

    @jax.jit
    def found(record: DecelerationRecord) -> tuple[jax.Array, jax.Array]:
        same = MeasuredImpact(given.element, given.parameters, given.noise_parameters, record)
        return same.draw_errors(jax.random.PRNGKey(0)), same.mean_first_time()

    errors, mean_first = found(given.record)
    first = np.asarray(given.record.first_time)
    # The trace is linear in the moment over half an interval: the rest is bent by a few per cent.
    assert first - errors[:, 3] == pytest.approx(np.full(2, 2.6 * DT), abs=0.1 * DT)
    assert np.asarray(mean_first) == pytest.approx(np.full(2, 2.5 * DT), abs=0.01 * DT)


def test_drawn_contact_is_distributed_as_its_density() -> None:
    given = measured("maxwell", CELLS, sigma=1.0)
    drawn = DT / 2 - contact_errors(given, 1, 4000)

    cells = [density_about(given, "maxwell", 0, (cell + 0.5) * DT) for cell in range(CELLS)]
    places = (np.arange(40 * CELLS) + 0.5) * DT / 40
    logs = np.array([cells[int(place / DT)](place) for place in places])
    below = np.cumsum(np.exp(logs - logs.max()))
    uniform = np.interp(drawn, places + DT / 80, below / below[-1])
    assert kstest(uniform, "uniform").pvalue > 0.001


def test_early_samples_bound_contact() -> None:
    """Without them contact could be earlier by as much as the rest of the trace allows."""
    with_them = measured("maxwell", 3 * CELLS, sigma=1.0, lead=8.2)
    nothing = Contact.anywhere(np.zeros((2, 3 * CELLS)), np.zeros(2, int))
    none = with_them.record._replace(contact=nothing)
    without = MeasuredImpact(with_them.element, with_them.parameters, with_them.noise_parameters, none)
    spread = [contact_errors(each, 2, 2000).std() for each in (with_them, without)]
    assert spread[0] < spread[1]


def test_replicates_have_contact_where_the_trace_has_it() -> None:
    given = measured("maxwell", CELLS, sigma=1e-2)

    @jax.jit
    def sampled(record: DecelerationRecord) -> jax.Array:
        same = MeasuredImpact(given.element, given.parameters, given.noise_parameters, record)
        return same.sample(jax.random.PRNGKey(3))

    made = np.asarray(sampled(given.record))
    expected = response("maxwell", np.arange(SAMPLES) * DT + np.full((2, 1), 2.6 * DT), VELOCITY)
    inside = np.arange(SAMPLES) < COUNT[:, None]
    # Errors of velocity, gain and offset are as large as these.
    tolerance = 5 * (0.02 / 1.1 + 0.01) * np.abs(expected).max() + 0.5
    assert np.abs(np.where(inside, made - expected, 0.0)).max() < tolerance


@pytest.mark.parametrize("name", NAMES)
def test_no_noise_is_small_enough_to_explain_everything(name: str) -> None:
    """Early samples that hold part of the impact must not make a vanishing noise likely."""
    given = measured(name, 3 * CELLS, lead=8.0)
    values = []
    for log_sigma in np.log(SIGMA) - np.array([0.0, 2.0, 4.0, 8.0]):
        noise = NoiseParameters(jnp.full(2, log_sigma))
        other = MeasuredImpact(given.element, given.parameters, noise, given.record)
        values.append(log_prob(other))
    assert (np.diff(values, axis=0) < 0).all()
