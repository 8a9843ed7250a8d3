"""Noise that went through the recorder's filter, against the whole covariance."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import correlation, record_of
from numpy.testing import assert_allclose
from recorded_impacts import LOW_PASS, SAE

from bayestissue.model.likelihood import noise
from bayestissue.model.likelihood.contact_cells import noise_of
from bayestissue.model.likelihood.noise import LEAST_EIGENVALUE, colour_of
from bayestissue.model.likelihood.record import Contact
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import autocorrelation

pytestmark = pytest.mark.slow

DT, ROWS = 1e-4, 60


def lags(recorder: LowPassFilter, dt: float = DT):
    return lambda lag: autocorrelation(recorder, lag, dt)


def whole(recorder: LowPassFilter, white: float, rows: int = ROWS, dt: float = DT) -> np.ndarray:
    return correlation(recorder, white, rows, dt)


@pytest.mark.parametrize("recorder", [LOW_PASS, SAE], ids=str)
@pytest.mark.parametrize("white", [0.0, 0.2])
def test_samples_are_so_far_apart_that_no_frequency_is_believed_above_all_others(recorder, white):
    stride = colour_of(white, [lags(recorder)], ROWS).stride
    assert (stride == 1) == (white > LEAST_EIGENVALUE)
    least = [np.linalg.eigvalsh(whole(recorder, white, dt=DT * s))[0] for s in (stride, max(1, stride - 1))]
    # Those of so many samples more are lower by a little.
    assert least[0] > 0.95 * LEAST_EIGENVALUE
    assert stride == 1 or least[1] < LEAST_EIGENVALUE


@pytest.mark.parametrize(("recorder", "white"), [(LOW_PASS, 0.2), (SAE, 0.05), (SAE, 0.0)], ids=str)
def test_products_are_those_under_the_inverse_covariance(recorder, white):
    """Of traces that begin and end anywhere, at two sampling rates."""
    random = np.random.default_rng(0)
    colour = colour_of(white, [lags(recorder), lags(recorder, 1.5 * DT)], ROWS)
    asked, reach = np.arange(ROWS)[:: colour.stride], 20
    recorded, rate = np.array([20, 13, 0]), np.array([0, 1, 0])
    traces = record_of(
        np.zeros((3, ROWS - reach)),
        DT,
        DT,
        1.0,
        contact=Contact.anywhere(np.zeros((3, reach)), recorded),
        count=np.array([40, 35, 40]),
        colour=colour,
        rate=jnp.asarray(rate),
    )
    inside = (np.arange(ROWS) >= [[0], [7], [20]]) & (np.arange(ROWS) < [[60], [55], [60]])
    inside = inside[:, :: colour.stride]
    parts = np.where(inside, random.normal(size=(5, *inside.shape)), 0)

    @jax.jit
    @jax.vmap
    def products(one: noise.TraceNoise, parts: jax.Array) -> tuple[jax.Array, jax.Array]:
        white = one.whitened(parts)
        return white @ white.T, one.log_determinant()

    made = noise_of(traces)
    np.testing.assert_array_equal(made.inside, inside)
    gram, log_determinant = products(made, jnp.asarray(parts.swapaxes(0, 1)))
    for row in range(3):
        rows = asked[inside[row]]
        shape = whole(recorder, max(white, 1e-3), dt=DT * (1, 1.5)[rate[row]])[np.ix_(rows, rows)]
        # Weights of 1e-7 together are left out.
        assert_allclose(log_determinant[row], np.linalg.slogdet(shape)[1], atol=1e-6 * len(rows))
        mine, *other = parts[:, row, inside[row]]
        solved = np.linalg.solve(shape, mine)
        size = np.sqrt(mine @ solved)
        assert_allclose(gram[row, 0, 0], mine @ solved, rtol=1e-6)
        assert_allclose(gram[row, 0, 1:], np.array(other) @ solved, atol=1e-6 * size**2)
        each = [one @ np.linalg.solve(shape, one) for one in other]
        assert_allclose(np.diagonal(gram[row])[1:], each, rtol=1e-6)


def test_innovations_undo_the_factor_and_draws_have_the_covariance():
    colour = colour_of(0.1, [lags(SAE)], 40)
    standard = np.random.default_rng(1).standard_normal((3, 40))
    factor = np.linalg.cholesky(whole(SAE, 0.1, 40))
    rate, correlated = jnp.zeros(3, int), jnp.asarray(standard @ factor.T)
    rows = noise.TraceNoise.of(
        jnp.ones(correlated.shape, bool), colour._replace(stride_marks=jnp.zeros(1)), rate
    )
    found = jax.jit(jax.vmap(noise.TraceNoise.whitened))(rows, correlated)
    assert_allclose(found, standard, atol=1e-6)
    draws = 20_000
    drawn = np.asarray(noise.drawn(colour, rate, jax.random.PRNGKey(1), (draws, 3, 40)))[:, 0]
    # Five standard errors of a covariance of numbers whose variances are 1.
    assert_allclose(np.cov(drawn.T), whole(SAE, 0.1, 40), atol=5 * (2 / draws) ** 0.5)
