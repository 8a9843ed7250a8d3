"""Noise that went through the recorder's filter, against the whole covariance."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import toeplitz
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayestissue.mechanics.elements import element
from bayestissue.model.likelihood.element import noise
from bayestissue.model.likelihood.element.contact_cells import noise_of
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.noise import LEAST_EIGENVALUE, colour_of, discrepancy_modes
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord
from bayestissue.model.likelihood.element.recorder import Colour, LowPass
from bayestissue.model.likelihood.element.response import columns, response
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import autocorrelation, modes

pytestmark = pytest.mark.slow

SLOW = LowPassFilter(low_pass_hz=500.0)
SAE = LowPassFilter(low_pass_hz=2.0775 * 180, zero_phase=True, sae_class=180, applied="analog")
DT, ROWS = 1e-4, 60
K, C, MASS, VELOCITY = 30_000.0, 60.0, 0.5, 1.5


def lags(recorder: LowPassFilter, dt: float = DT):
    return lambda lag: autocorrelation(recorder, lag, dt)


def whole(recorder: LowPassFilter, white: float, rows: int = ROWS, dt: float = DT) -> np.ndarray:
    """T = f 1 + (1 - f) R."""
    return white * np.eye(rows) + (1 - white) * toeplitz(lags(recorder, dt)(np.arange(rows)))


@pytest.mark.parametrize("recorder", [SLOW, SAE, LowPassFilter(low_pass_hz=900.0, order=1)], ids=str)
@pytest.mark.parametrize("white", [0.0, 0.2])
def test_samples_are_so_far_apart_that_no_frequency_is_believed_above_all_others(recorder, white):
    stride = colour_of(white, [lags(recorder)], ROWS).stride
    assert (stride == 1) == (white > LEAST_EIGENVALUE or recorder.order == 1)
    least = [np.linalg.eigvalsh(whole(recorder, white, dt=DT * s))[0] for s in (stride, max(1, stride - 1))]
    # Those of so many samples more are lower by a little.
    assert least[0] > 0.95 * LEAST_EIGENVALUE
    assert stride == 1 or least[1] < LEAST_EIGENVALUE


@pytest.mark.parametrize(("recorder", "white"), [(SLOW, 0.2), (SAE, 0.05), (SAE, 0.0)], ids=str)
def test_products_are_those_under_the_inverse_covariance(recorder, white):
    """Of traces that begin and end anywhere, at two sampling rates."""
    random = np.random.default_rng(0)
    colour = colour_of(white, [lags(recorder), lags(recorder, 1.5 * DT)], ROWS)
    asked, reach = np.arange(ROWS)[:: colour.stride], 20
    recorded, rate = np.array([20, 13, 0]), np.array([0, 1, 0])
    traces = record(
        DT, SLOW, colour, np.zeros((3, ROWS - reach)), Contact.anywhere(np.zeros((3, reach)), recorded)
    )
    traces = traces._replace(rate=jnp.asarray(rate), n_samples=jnp.array([40, 35, 40]))
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


def innovations(colour: Colour, rate: jax.Array, left: np.ndarray) -> jax.Array:
    whole_rows = noise.TraceNoise.of(
        jnp.ones(left.shape, bool), colour._replace(stride_marks=jnp.zeros(1)), rate
    )
    return jax.vmap(noise.TraceNoise.whitened)(whole_rows, jnp.asarray(left))


def test_the_work_goes_with_the_number_of_samples():
    """How many samples before it tell a sample is the filter's affair, and not the trace's length."""
    short, long = (colour_of(0.3, [lags(SLOW)], rows) for rows in (300, 1500))
    assert short.predictor.shape == long.predictor.shape
    assert short.predictor.shape[1] < 100
    # Both parts of the whitening, the first samples and the later ones, against the dense covariance.
    standard = np.random.default_rng(2).standard_normal((1, 300))
    correlated = standard @ np.linalg.cholesky(whole(SLOW, 0.3, 300)).T
    found = innovations(long, jnp.zeros(1, int), correlated)
    assert_allclose(found, standard, atol=1e-6)


def test_innovations_undo_the_factor_and_draws_have_the_covariance():
    colour = colour_of(0.1, [lags(SAE)], 40)
    standard = np.random.default_rng(1).standard_normal((3, 40))
    factor = np.linalg.cholesky(whole(SAE, 0.1, 40))
    rate = jnp.zeros(3, int)
    found = innovations(colour, rate, standard @ factor.T)
    assert_allclose(found, standard, atol=1e-6)
    draws = 20_000
    drawn = np.asarray(noise.drawn(colour, rate, jax.random.PRNGKey(1), (draws, 3, 40)))[:, 0]
    # Five standard errors of a covariance of numbers whose variances are 1.
    assert_allclose(np.cov(drawn.T), whole(SAE, 0.1, 40), atol=5 * (2 / draws) ** 0.5)


def record(
    first: float,
    recorder: LowPassFilter,
    colour: Colour,
    d: np.ndarray,
    contact: Contact,
    error_sd: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0),
    *,
    lead: int = 0,
    phases: int = 1,
) -> DecelerationRecord:
    poles, weights = modes(recorder)
    ahead = jnp.zeros(lead) if recorder.zero_phase else None
    cells = (jnp.arange(phases) + 0.5) / phases
    low_pass = LowPass(jnp.asarray(poles), jnp.asarray(weights), cells, ahead)
    one = np.ones(len(d))
    made = DecelerationRecord.from_arrays(
        d,
        np.full(len(d), d.shape[1]),
        first * one,
        DT * one,
        VELOCITY * one,
        np.outer(one, error_sd),
        MASS * one,
        {"diameter_m": 0.03 * one},
        contact,
    )
    return made._replace(low_pass=low_pass, colour=colour)


TISSUE, PARAMETERS = element("kelvin_voigt"), jnp.array([[K], [C]])
SIGMA = 2.0


@pytest.mark.parametrize("log_discrepancy", [None, np.log(3.0)])
def test_the_density_where_contact_is_known_is_that_of_the_whole_covariance(log_discrepancy):
    """Chain and discrepancy are in it too."""
    samples, white = 50, 0.15
    random = np.random.default_rng(2)
    smooth = discrepancy_modes(np.array([samples]), np.arange(samples)[None])
    given = record(
        2.3 * DT,
        SLOW,
        colour_of(white, [lags(SLOW)], samples),
        300 * np.sin(np.arange(samples) / 25)[None] + random.standard_normal((1, samples)),
        Contact.known(np.zeros(1, bool)),
        (0.01, 0.02, 0.5, 1e-5),
    )._replace(discrepancy=smooth)
    beside = None if log_discrepancy is None else jnp.array([log_discrepancy])

    @jax.jit
    def asked(given):
        event = MeasuredImpact(TISSUE, PARAMETERS, NoiseParameters(jnp.array([np.log(SIGMA)]), beside), given)
        found = response(TISSUE, PARAMETERS, given)
        return event.log_density(), found.d, jnp.stack(columns(found, given))

    density, d, each = (np.asarray(part) for part in asked(given))
    covariance = SIGMA**2 * whole(SLOW, white, samples)
    scaled = each[:, 0].T * np.asarray(given.error_sd)[0]
    covariance += scaled @ scaled.T
    if log_discrepancy is not None:
        own = np.exp(log_discrepancy) * np.asarray(smooth.basis)[0].T * np.sqrt(smooth.share[0])
        covariance += own @ own.T
    expected = multivariate_normal(np.zeros(samples), covariance).logpdf(np.asarray(given.d)[0] - d[0])
    assert density[0] == pytest.approx(expected, abs=1e-3 * samples)


def with_contact_open(
    recorder: LowPassFilter, colour: Colour, trace: np.ndarray, reach: int, lead: int
) -> DecelerationRecord:
    """Contact may be in any of ``reach`` cells, those in which the filter looks ahead among them."""
    return record(
        DT / 2,
        recorder,
        colour,
        trace[None, reach:],
        Contact.anywhere(trace[None, :reach], np.array([reach])),
        (0.0, 0.0, 0.0, reach * DT / 12**0.5),
        lead=lead,
        phases=2,
    )


@jax.jit
def of_trace(given: DecelerationRecord, beside: jax.Array | None = None) -> tuple[jax.Array, jax.Array]:
    noise = NoiseParameters(jnp.array([np.log(SIGMA)]), beside)
    event = MeasuredImpact(TISSUE, PARAMETERS, noise, given)
    return event.log_density(), event.mean_first_time()


def test_the_density_is_that_over_all_moments_of_contact():
    """Against the dense normal at many moments; within a cell the likelihood is linear in them."""
    lead, reach, samples, contact = 40, 48, 50, -2.3 * DT
    colour = colour_of(0.0, [lags(SAE)], reach + samples)
    time = np.arange(-reach, samples) * DT
    shape = whole(SAE, 1e-3, len(time))
    noise = np.linalg.cholesky(shape) @ np.random.default_rng(3).standard_normal(len(time))
    trace = seen_directly(SAE, time + contact) + SIGMA * noise
    density, first = of_trace(with_contact_open(SAE, colour, trace, reach, lead))
    moments = (np.arange(1500) + 0.5) / 1500 * reach * DT - lead * DT
    rows = np.arange(len(time))[:: colour.stride]
    left = np.stack([trace - seen_directly(SAE, time + moment) for moment in moments])[:, rows]
    log_each = multivariate_normal(np.zeros(len(rows)), SIGMA**2 * shape[np.ix_(rows, rows)]).logpdf(left)
    assert density[0] == pytest.approx(logsumexp(log_each) - np.log(1500 / reach), abs=0.15)
    assert first[0] == pytest.approx(contact, abs=0.5 * DT)


def test_where_all_of_it_is_white_it_is_the_likelihood_of_white_noise():
    """But for the samples before the first, which count by their own density and not against a quiet part."""
    reach, white = 8, 1 - 1e-6
    time = np.arange(-reach, 50) * DT
    trace = seen_directly(SLOW, time + 3.4 * DT)
    trace = trace + SIGMA * np.random.default_rng(3).standard_normal(len(time))
    given = with_contact_open(SLOW, colour_of(white, [lags(SLOW)], len(time)), trace, reach, 0)
    contact = Contact.anywhere(trace[None, :reach], np.array([reach]), np.array([SIGMA]))
    plain, quiet = given._replace(colour=Colour.white_noise(), contact=contact), contact.quiet_log_density
    coloured_one, white_one = of_trace(given), of_trace(plain)
    # In proportion to 1 - f times the greatest eigenvalue of R, a dozen.
    assert_allclose(coloured_one[0], white_one[0] + quiet, atol=1e-4)
    assert_allclose(coloured_one[1], white_one[1], atol=1e-4 * DT)


def test_a_discrepancy_beside_it_takes_up_what_the_element_leaves():
    """A small one changes nothing. One that is there makes its own density greater."""
    reach, samples = 8, 50
    time = np.arange(-reach, samples) * DT
    noise = np.linalg.cholesky(whole(SLOW, 0.3, len(time))) @ np.random.default_rng(3).standard_normal(58)
    trace = seen_directly(SLOW, time + 3.4 * DT) + SIGMA * noise
    colour = colour_of(0.3, [lags(SLOW)], len(time))
    smooth = discrepancy_modes(np.array([samples]), np.arange(samples)[None])

    def density(trace: np.ndarray, log_discrepancy: float) -> float:
        given = with_contact_open(SLOW, colour, trace, reach, 0)
        given = given._replace(discrepancy=smooth)
        return float(of_trace(given, jnp.array([log_discrepancy]))[0][0])

    plain = float(of_trace(with_contact_open(SLOW, colour, trace, reach, 0))[0][0])
    assert density(trace, -12.0) == pytest.approx(plain, abs=1e-4)
    basis, share = (np.asarray(part)[0] for part in smooth)
    further = 10 * np.sqrt(share) * np.random.default_rng(4).standard_normal(len(basis)) @ basis
    spoilt = trace + np.concatenate([np.zeros(reach), further])
    assert density(spoilt, np.log(10.0)) > density(spoilt, np.log(1.0)) + 3
    assert density(trace, np.log(10.0)) < plain


def seen_directly(recorder: LowPassFilter, time: np.ndarray) -> np.ndarray:
    """The filter's answer to the impact at some times."""
    return np.interp(time, *answer(recorder))


@cache
def answer(recorder: LowPassFilter) -> tuple[np.ndarray, np.ndarray]:
    """By its transform, sampled so often that the jump does no harm: times and values."""
    fine, span = DT / 40, 0.08
    grid = np.arange(-span, span, fine)
    own = np.roots([1, C / MASS, K / MASS])
    size = VELOCITY * own**2 * np.array([-1, 1]) / (own[0] - own[1])
    late = np.maximum(grid + fine / 2, 0)
    force = np.where(grid + fine / 2 > 0, (size * np.exp(own * late[:, None])).sum(1).real, 0)
    poles, weights = modes(recorder)
    given = (weights * np.exp(poles * np.abs(grid)[:, None])).sum(1).real
    given = given if recorder.zero_phase else np.where(grid >= 0, given, 0)
    found = np.fft.irfft(np.fft.rfft(force) * np.fft.rfft(np.fft.ifftshift(given)), len(grid)) * fine
    return grid + fine / 2, found
