"""When contact was: found where it was, drawn as its density has it, and bounded by the samples before it."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import Rows, scatter
from recorded_impacts import LOW_PASS, SAE, THERE_AND_BACK, contact_open, filtered
from scipy.stats import kstest, multivariate_normal

from bayestissue.mechanics.elements import impact
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.record import Contact
from bayestissue.recordings.dataset.dataset_file import LowPassFilter

pytestmark = pytest.mark.slow

DT, CELLS = 2e-4, 4
# What is alike for all elements: by default one that jumps at contact. The density is tested of another too.
NAMES = [
    "maxwell",
    *(pytest.param(name, marks=pytest.mark.long) for name in ("standard_linear", "hunt_crossley")),
]


@jax.jit
def log_density(measured: MeasuredImpact) -> jax.Array:
    return measured.log_density()


@jax.jit
def _contact_errors(measured: MeasuredImpact, keys: jax.Array) -> jax.Array:
    return jax.vmap(measured.draw_errors)(keys)[:, 0, 3]


def contact_errors(given: MeasuredImpact, seed: int, number: int) -> np.ndarray:
    """Draws of the first impact's error of contact."""
    return np.asarray(_contact_errors(given, jax.random.split(jax.random.PRNGKey(seed), number)))


def test_slopes_by_a_place_in_each_cell_are_those_of_differences() -> None:
    given, by, h = contact_open("maxwell", CELLS, (0.3, -0.4)).measured, jnp.array([0.3, -0.4]), 1e-5

    @jax.jit
    def density(by: jax.Array) -> jax.Array:
        return replace(given, record=given.record.with_contact_earlier(by)).log_density()

    slope = jnp.diag(jax.jit(jax.jacrev(density))(by))
    ends = [density(by + side * h) for side in (1, -1)]
    # Third derivatives of a log density of a few thousand, and its rounding over 2 h.
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), atol=1e-3, rtol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_contact_is_found_where_it_was(name: str) -> None:
    """Nearly without noise the moment is told to a hundredth of a sampling interval or so."""
    given = contact_open(name, CELLS, sigma=1e-3).measured

    @jax.jit
    def found(given: MeasuredImpact) -> tuple[jax.Array, jax.Array]:
        return given.draw_errors(jax.random.PRNGKey(0)), given.mean_first_time()

    errors, mean_first = found(given)
    first = np.asarray(given.record.first_time)
    # The trace is linear in the moment over half an interval: the rest is bent by a few per cent.
    assert first - errors[:, 3] == pytest.approx(np.full(2, 2.6 * DT), abs=0.1 * DT)
    assert np.asarray(mean_first) == pytest.approx(np.full(2, 2.5 * DT), abs=0.01 * DT)


@pytest.mark.parametrize(
    ("recorder", "white", "contact", "within"),
    [(LOW_PASS, 1.0, 3.3, 0.4), (THERE_AND_BACK, 1.0, -2.2, 0.4), (SAE, 0.0, -2.3, 0.5)],
)
def test_contact_is_found_where_it_was_behind_a_filter_too(
    recorder: LowPassFilter, white: float, contact: float, within: float
) -> None:
    """Within a few of its standard deviations, in sampling intervals."""
    given = filtered(recorder, white, contact, 8).measured
    first = jax.jit(given.mean_first_time)()
    assert first[0] / given.record.dt[0] == pytest.approx(contact, abs=within)


def test_drawn_contact_is_distributed_as_its_density() -> None:
    of = contact_open("maxwell", CELLS, sigma=1.0)
    drawn = DT / 2 - contact_errors(of.measured, 1, 4000)
    channels, sd = Rows(of, 0), np.asarray(of.measured.record.error_sd)[0, :-1]
    within, logs = ((np.arange(40) + 0.5) / 40 - 0.5) * DT, []
    for cell in range(CELLS):
        rows = channels.at((cell + 0.5) * DT)
        left = rows.seen - rows.mean + within[:, None] * rows.columns[-1]
        logs.append(multivariate_normal(cov=scatter(rows, sd)).logpdf(left))
    places = (np.arange(40 * CELLS) + 0.5) * DT / 40
    below = np.cumsum(np.exp(np.concatenate(logs) - np.max(logs)))
    uniform = np.interp(drawn, places + DT / 80, below / below[-1])
    assert kstest(uniform, "uniform").pvalue > 0.001


def test_early_samples_bound_contact() -> None:
    """Without them contact could be earlier by as much as the rest of the trace allows."""
    with_them = contact_open("maxwell", 3 * CELLS, sigma=1.0, lead=8.2).measured
    nothing = Contact.anywhere(np.zeros((2, 3 * CELLS)), np.zeros(2, int))
    without = replace(with_them, record=with_them.record._replace(contact=nothing))
    spread = [contact_errors(each, 2, 2000).std() for each in (with_them, without)]
    assert spread[0] < spread[1]


def test_replicates_have_contact_where_the_trace_has_it() -> None:
    given = contact_open("maxwell", CELLS, sigma=1e-2).measured
    record, values = given.record, dict(zip("KC", given.parameters, strict=True))
    made = np.asarray(jax.jit(lambda: given.sample(jax.random.PRNGKey(3)))())
    time = (np.arange(record.d.shape[1]) + np.full((2, 1), 2.6)) * DT
    expected = np.asarray(impact("maxwell", values, record.mass, record.velocity, time).deceleration)
    # Errors of velocity, gain and offset are as large as these.
    tolerance = 5 * (0.02 / 1.1 + 0.01) * np.abs(expected).max() + 0.5
    assert np.abs(np.where(record.inside(), made - expected, 0.0)).max() < tolerance


@pytest.mark.parametrize("name", NAMES)
def test_no_noise_is_small_enough_to_explain_everything(name: str) -> None:
    """Early samples that hold part of the impact must not make a vanishing noise likely."""
    given = contact_open(name, 3 * CELLS, lead=8.0).measured
    sizes = np.log(0.3) - np.array([0.0, 2.0, 4.0, 8.0])
    values = [
        log_density(replace(given, noise_parameters=NoiseParameters(jnp.full(2, size)))) for size in sizes
    ]
    assert (np.diff(values, axis=0) < 0).all()
