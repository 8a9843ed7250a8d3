"""When contact was: found where it was, and drawn as its density has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import Recorded, Rows, scatter
from recorded_impacts import SAE, contact_open, filtered
from scipy.stats import kstest, multivariate_normal

from bayestissue.mechanics.elements import impact
from bayestissue.model.likelihood.impact import MeasuredImpact, NoiseParameters

pytestmark = pytest.mark.slow

DT, CELLS = 2e-4, 4


@jax.jit
def log_density(measured: MeasuredImpact) -> jax.Array:
    return measured.log_density()


@pytest.mark.parametrize(
    ("make", "contact", "within"),
    [
        # One moment in a cell, nearly without noise: the middle of the cell that it is in.
        (partial(contact_open, "maxwell", CELLS, sigma=1e-3), 2.5, 0.01),
        (partial(filtered, SAE, 0.0, -2.3, 8), -2.3, 0.5),
    ],
)
def test_contact_is_found_where_it_was(make: Callable[[], Recorded], contact: float, within: float) -> None:
    """In sampling intervals; behind a filter within a few of its standard deviations."""
    given = make().measured
    first = jax.jit(given.mean_first_time)() / given.record.dt
    assert np.asarray(first) == pytest.approx(contact, abs=within)


def test_drawn_contact_is_distributed_as_its_density() -> None:
    of = contact_open("maxwell", CELLS, sigma=1.0)
    keys = jax.random.split(jax.random.PRNGKey(1), 4000)
    drawn = DT / 2 - np.asarray(jax.jit(jax.vmap(of.measured.draw_errors))(keys))[:, 0, 3]
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


def test_replicates_have_contact_where_the_trace_has_it() -> None:
    given = contact_open("maxwell", CELLS, sigma=1e-2).measured
    record, values = given.record, dict(zip("KC", given.parameters, strict=True))
    made = np.asarray(jax.jit(given.replicate)(jax.random.PRNGKey(3))["deceleration"])
    time = (np.arange(record.d.shape[1]) + np.full((2, 1), 2.6)) * DT
    expected = np.asarray(impact("maxwell", values, record.mass, record.velocity, time).deceleration)
    # Errors of velocity, gain and offset are as large as these.
    tolerance = 5 * (0.02 / 1.1 + 0.01) * np.abs(expected).max() + 0.5
    assert np.abs(np.where(record.inside(), made - expected, 0.0)).max() < tolerance


def test_no_noise_is_small_enough_to_explain_everything() -> None:
    """Early samples that hold part of the impact must not make a vanishing noise likely."""
    given = contact_open("maxwell", 3 * CELLS, lead=8.0).measured
    sizes = np.log(0.3) - np.array([0.0, 2.0, 4.0, 8.0])
    noises = [NoiseParameters(jnp.full(2, size)) for size in sizes]
    values = [log_density(replace(given, noise_parameters=each)) for each in noises]
    assert (np.diff(values, axis=0) < 0).all()
