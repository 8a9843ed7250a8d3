"""The exact likelihood on series that others published, at estimates that others printed."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import OptimizeResult, least_squares
from scipy.signal import lfilter

from bayestissue.inference.points.point_fit import PointFit, fit_points
from bayestissue.model.likelihood.arma21 import Start, arma21_log_likelihood


class Published(NamedTuple):
    """phi1, phi2, theta1 and the shocks' variance with the log likelihood there, all as printed."""

    parameters: tuple[float, float, float, float]
    log_likelihood: float


# S. M. Pandit and S.-M. Wu, Time Series and System Analysis with Applications (Wiley 1983), appendix: their
# series less the mean; maxima of the exact Gaussian likelihood with a stationary start.
SERIES = {
    "vibration": Published((1.41474, -0.59649, -0.54518, 4.12886), -278.68493),
    "sunspots": Published((1.42517, -0.72072, 0.15700, 233.791), -730.81604),
    "grinding": Published((0.89456, -0.30277, 0.11835, 6.17416), -582.59705),
}


# Five decimals.
PRINTED = 0.5e-5


class Printed(NamedTuple):
    """Coefficients with six decimals, and the residual standard deviation with seven digits."""

    coefficients: tuple[float, ...]
    deviation: float


# The DDS routines of NIST's Dataplot (usnistgov/dataplot, src/dpdds3.F, commit 39742913), transcribed for one
# series and compiled on their own, reals in double precision as its Makefile has them. ARMA(2,1), its
# default, and AR(2), with the mean subtracted.
DATAPLOT = {
    "vibration": (
        Printed((1.426255, -0.607849, -0.540947), 2.053772),
        Printed((1.618323, -0.782570), 2.183484),
    ),
    "sunspots": (
        Printed((1.423989, -0.721389, 0.151242), 15.37212),
        Printed((1.336437, -0.650491), 15.40901),
    ),
    "grinding": (
        Printed((0.885862, -0.286708, 0.110663), 2.442060),
        Printed((0.785365, -0.223670), 2.437671),
    ),
}
# Seven digits, as a part of the number.
PRINTED_DIGITS = 0.5e-6
# Its search ends when a step changes the sum of squares by less than this part, or by what it predicts
# to this part.
CONVERGED = 1e-5


def path_of(name: str) -> Path:
    """Where a series lies beside the project, if it does."""
    return Path(__file__).resolve().parents[3] / "shared" / "series" / f"{name}.dat"


def series(name: str) -> np.ndarray:
    """Used where they lie beside the project."""
    path = path_of(name)
    if not path.is_file():
        pytest.skip(f"the published series is not at {path}")
    values = np.array(path.read_text().split(), float)
    return values - values.mean()


@cache
def padded() -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, series side by side, and how long each is: what is compiled serves all of them."""
    names = [name for name in SERIES if path_of(name).is_file()]
    rows = [series(name) for name in names]
    lengths = np.array([len(row) for row in rows])
    return names, np.stack([np.pad(row, (0, lengths.max() - len(row))) for row in rows]), lengths


@partial(jax.jit, static_argnames="start")
def expansion_of(x: np.ndarray, at: jax.Array, start: Start) -> tuple[jax.Array, ...]:
    """Log likelihood at phi1, phi2, theta1 and the variance, its slope, and minus its second derivatives."""

    def value(at: jax.Array) -> jax.Array:
        phi1, phi2, theta1, variance = at
        return arma21_log_likelihood(x, phi1, phi2, theta1, jnp.sqrt(variance), start=start)

    return *jax.value_and_grad(value)(at), -jax.hessian(value)(at)


def expansion(name: str, parameters: np.ndarray, start: Start) -> list[np.ndarray]:
    """That of one series at its row of those for all."""
    row = parameters[padded()[0].index(name)]
    return [np.asarray(part) for part in expansion_of(series(name), jnp.asarray(row), start)]


def as_published() -> np.ndarray:
    return np.array([SERIES[name].parameters for name in padded()[0]])


@pytest.mark.parametrize("name", list(SERIES))
def test_the_book_s_series_have_their_log_likelihood_and_it_is_the_greatest(name: str):
    published, _ = SERIES[name], series(name)
    value, slope, curvature = expansion(name, as_published(), "stationary")
    assert (np.linalg.eigvalsh(curvature) > 0).all()
    assert float(value) == pytest.approx(published.log_likelihood, abs=PRINTED)
    # What a step to the maximum would gain is not to be seen in what was printed.
    assert slope @ np.linalg.solve(curvature, slope) / 2 < PRINTED


# What the search of theta1 leaves: its last grid is this fine, in standard errors of these series.
SEARCHED = 1e-4


@cache
def fitted() -> tuple[PointFit, np.ndarray]:
    """The estimator takes a series for a motion sampled once a second; phi1, phi2, theta1 and variance."""
    _, x, lengths = padded()
    one = np.ones(len(x))
    fit = fit_points(x, lengths, one, one)
    return fit, np.stack([fit.phi1, fit.phi2, fit.theta1, np.square(fit.sigma_a)], axis=1)


def shocks(at: np.ndarray, x: np.ndarray) -> np.ndarray:
    """From the third value on, those before being 0; an autoregression where ``at`` has no theta1."""
    phi1, phi2, theta1 = (*at, 0.0)[:3]
    return lfilter([1.0], [1.0, -theta1], x[2:] - phi1 * x[1:-1] - phi2 * x[:-2])


def minimum(x: np.ndarray, start: tuple[float, ...]) -> tuple[OptimizeResult, np.ndarray]:
    """Conditional least squares from a start, and the standard errors there."""
    best = least_squares(shocks, start, args=(x,), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    variance = 2 * best.cost / len(best.fun)
    return best, np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)) * variance)


@pytest.mark.parametrize("name", list(SERIES))
def test_dds_is_conditional_least_squares_from_any_start(name: str):
    """Its own guess is a grid over all theta1, and the series' mean is the right centre here.

    What is left between dds and the exact maximum is less than 0.6 of a standard error.
    """
    x = series(name)
    found, published = fitted()[1][padded()[0].index(name)], SERIES[name].parameters
    for start in (SERIES[name].parameters[:3], (1.0, -0.3, 0.0), (0.5, 0.0, 0.5)):
        theirs, error = minimum(x, start)
        assert (np.abs(found[:3] - theirs.x) < SEARCHED * error).all()
        assert found[3] == pytest.approx(2 * theirs.cost / (len(x) - 2), rel=1e-8)
    assert (np.abs(found[:3] - published[:3]) < 0.6 * error).all()


@pytest.mark.parametrize("order", ["ARMA(2,1)", "AR(2)"])
@pytest.mark.parametrize("name", list(SERIES))
def test_dataplot_ends_at_the_minimum_that_dds_has(name: str, order: str):
    """It printed our sum of squares at its coefficients, which is the least one to its criterion.

    z standard errors away the sum is 1 + z^2 / (N - 2) times the least one, so the criterion bounds z too.
    Its residual variance is divided by N less the number of coefficients.
    """
    x, printed = series(name), DATAPLOT[name][order == "AR(2)"]
    best, error = minimum(x, printed.coefficients)
    ours = best.x if order == "AR(2)" else fitted()[1][padded()[0].index(name)][:3]
    least, theirs = (np.square(shocks(at, x)).sum() for at in (ours, np.array(printed.coefficients)))
    deviation = np.sqrt(theirs / (len(x) - len(ours)))
    assert float(deviation) == pytest.approx(printed.deviation, rel=PRINTED_DIGITS)
    assert least < theirs < least * (1 + CONVERGED)
    assert (np.abs(ours - printed.coefficients) < np.sqrt(CONVERGED * (len(x) - 2)) * error).all()
