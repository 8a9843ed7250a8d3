"""The likelihood of an impact, however it was recorded, against the dense normal of all its samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import Recorded, errors_given, log_density, normal, scatter
from jax import Array
from jax.flatten_util import ravel_pytree
from numpy.testing import assert_allclose
from recorded_impacts import (
    LOW_PASS,
    SAE,
    THERE_AND_BACK,
    both_open,
    clipped,
    contact_open,
    filtered,
    force_beside,
    side_by_side,
    two_impacts,
)
from scipy.linalg import eigh
from scipy.stats import norm

from bayestissue.mechanics.elements import element_names
from bayestissue.model.likelihood.impact import MeasuredImpact
from bayestissue.recordings.dataset.dataset_file import LowPassFilter

GRAVITY = 9.80665
DISCREPANCY = (np.log(2.0), np.log(0.5))
GAINS = (0.04, -0.07)
SLOW_BESSEL = LowPassFilter(low_pass_hz=300.0, order=4, kind="bessel")
BOTH_WAYS = LowPassFilter(low_pass_hz=300.0, order=2, zero_phase=True, applied="analog")
SOFTWARE = LowPassFilter(low_pass_hz=200.0, applied="digital")
Make = Callable[[], Recorded]
WITH_DISCREPANCY = partial(two_impacts, "kelvin_voigt", "stiffening", log_discrepancy=DISCREPANCY)


def case(make: Callable[..., Recorded], *given: Any, within: float, mark: str = "slow", **named: Any) -> Any:
    """A configuration, how near its density is to the dense one's, and when it is tried."""
    marks = getattr(pytest.mark, mark) if mark else ()
    words = [make.__name__, *map(str, given), *(f"{key}={value}" for key, value in named.items())]
    return pytest.param(partial(make, *given, **named), within, marks=marks, id=" ".join(words))


@jax.jit
def density(measured: MeasuredImpact) -> Array:
    return measured.log_density()


def densities(of: Recorded) -> list[float]:
    return [log_density(of, row) for row in range(len(of.measured.record.d))]


@pytest.mark.parametrize(
    ("make", "within"),
    [
        # Columns are differences: what they leave grows with an element's bends. One element solved in closed
        # form and one on a grid; all in the long suite.
        case(two_impacts, "standard_linear", gravity=GRAVITY, within=1e-6),
        case(two_impacts, "hunt_crossley", within=1e-3),
        *(case(two_impacts, name, within=1e-3, mark="long") for name in element_names()),
        case(two_impacts, "hunt_crossley", gravity=GRAVITY, within=1e-3, mark="long"),
        case(two_impacts, "kelvin_voigt", "stiffening", log_discrepancy=DISCREPANCY, within=1e-7, mark=""),
        # Of the general way the motion lies between the nodes of a grid.
        case(two_impacts, "kelvin_voigt", uneven=True, within=1e-6),
        case(side_by_side, within=1e-8, mark=""),
        # A gain of all impacts: along gravity, beside a discrepancy, and with a force that has its own.
        case(two_impacts, "kelvin_voigt", gravity=GRAVITY, merged=True, log_gain=GAINS, within=1e-7, mark=""),
        case(two_impacts, "stiffening", log_discrepancy=DISCREPANCY, log_gain=GAINS, within=1e-5),
        case(force_beside, log_gain=0.05, within=1e-6, mark=""),
        # Laplace's method over what is unknown of four errors; the oracle's own error is 1e-4.
        case(clipped, merged=True, within=5e-3, mark=""),
        case(clipped, uneven=True, within=5e-3),
        case(clipped, sign=-1.0, within=5e-3),
        case(clipped, discrepancy=True, within=0.03, mark="long"),
        case(force_beside, below=True, within=1e-6, mark=""),
        # The oracle's grid is off by a share of its step, and a filter that looks ahead does so not for ever.
        case(force_beside, SLOW_BESSEL, 0.3, within=1e-3),
        case(force_beside, BOTH_WAYS, 0.3, within=0.02, mark=""),
        # Samples since contact before the first that counts are behind the filter too.
        case(force_beside, SOFTWARE, 0.3, within=1e-5),
        case(force_beside, SOFTWARE, 1.0, 1.7e-3, within=1e-5, mark=""),
        case(contact_open, "maxwell", 4, within=1e-6),
        case(contact_open, "hunt_crossley", 12, within=1e-5),
        *(case(contact_open, name, 12, within=1e-5, mark="long") for name in ("standard_linear", "maxwell")),
        case(contact_open, "maxwell", 4, (0.3, -0.4), within=1e-6),
        # A force at other times than the deceleration's, and filters run once or twice, or by software.
        case(both_open, "hunt_crossley", None, 7e-4, 3e-4, within=1e-3),
        case(both_open, "kelvin_voigt", SLOW_BESSEL, 7e-4, 3e-4, within=1e-3),
        case(both_open, "kelvin_voigt", BOTH_WAYS, 5e-4, 3e-3, within=0.02),
        case(both_open, "kelvin_voigt", SOFTWARE, 5e-4, 0.0, within=1e-5),
        case(filtered, LOW_PASS, 1.0, 3.3, 8, within=1e-3),
        case(filtered, THERE_AND_BACK, 1.0, -2.2, 8, within=0.1),
        case(filtered, LOW_PASS, 0.15, 2.3, log_discrepancy=np.log(3.0), within=1e-3),
        case(filtered, LOW_PASS, 0.3, 3.4, 8, log_discrepancy=np.log(3.0), within=1e-3),
        case(filtered, SAE, 0.0, -2.3, 8, within=0.1),
    ],
)
def test_the_density_is_that_of_the_dense_normal(make: Make, within: float) -> None:
    of = make()
    assert_allclose(density(of.measured), densities(of), rtol=1e-12, atol=within)


def test_the_density_is_that_of_the_samples_one_after_another() -> None:
    """Each sample given those before it: the errors and the modes' weights learnt as a static state."""
    of = WITH_DISCREPANCY()
    found = density(of.measured)
    for row in range(2):
        rows, sd = normal(of, row), np.asarray(of.measured.record.error_sd)[row]
        values, vectors = eigh(rows.discrepancy)
        modes = vectors[:, -6:] * np.sqrt(values[-6:])
        through = np.concatenate([rows.columns.T * sd, modes], axis=1)
        mean, covariance, total = np.zeros(10), np.eye(10), 0.0
        for seen, h in zip(rows.seen - rows.mean, through, strict=True):
            variance = h @ covariance @ h + rows.noise[0, 0]
            total += norm(h @ mean, np.sqrt(variance)).logpdf(seen)
            gain = covariance @ h / variance
            mean = mean + gain * (seen - h @ mean)
            covariance = covariance - np.outer(gain, h @ covariance)
        assert_allclose(found[row], total, rtol=1e-9)


def parameters(of: Recorded) -> tuple[Array, Callable[[Array], MeasuredImpact]]:
    """What can be changed of each impact, [parameter, impact], and the impacts so changed.

    An element's parameters are in units of themselves, those of the noise are logs.
    """
    measured, given = of.measured, of.measured.parameters
    unit = jnp.where(given == 0, 1.0, given)
    flat, back = ravel_pytree((given / unit, measured.noise_parameters))

    def at(changed: Array) -> MeasuredImpact:
        values, noise = back(changed.ravel())
        return replace(measured, parameters=values * unit, noise_parameters=noise)

    return flat.reshape(-1, len(measured.record.d)), at


@pytest.mark.parametrize(
    ("make", "within"),
    [
        # Third derivatives, of up to 1e7 where the error of contact is uniform, by the square of the step.
        *(
            case(two_impacts, name, uniform=True, within=1e-5, mark=mark)
            for name in element_names()
            for mark in ["slow" if name in ("standard_linear", "hunt_crossley") else "long"]
        ),
        case(two_impacts, "kelvin_voigt", merged=True, uneven=True, within=1e-4),
        case(force_beside, within=1e-4),
        case(side_by_side, within=1e-5),
        # Third derivatives of a log density of a few thousand, and its rounding over 2 h.
        case(contact_open, "standard_linear", 4, within=1e-3),
        case(both_open, "kelvin_voigt", SLOW_BESSEL, 7e-4, 3e-4, within=1e-3),
    ],
)
def test_slopes_are_those_of_differences(make: Make, within: float) -> None:
    values, at = parameters(make())

    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def both(values: Array) -> tuple[Array, Array]:
        found = at(values).log_density()
        return found.sum(), found

    slopes, step = both(values)[1], 3e-6
    for k, slope in enumerate(slopes):
        ahead, behind = (both(values.at[k].add(side * step))[0][1] for side in (1, -1))
        assert_allclose(slope, (ahead - behind) / (2 * step), rtol=1e-5, atol=within)


def test_what_lies_past_an_impacts_end_counts_nothing_and_other_traces_have_their_own_density() -> None:
    of = side_by_side()
    record = of.measured.record
    inside = np.arange(record.d.shape[1]) < record.n_samples[:, None]
    longer = replace(of.measured, record=record.with_traces(jnp.where(inside, record.d, 7.0)))
    assert_allclose(density(longer), density(of.measured), rtol=1e-12)
    other = replace(of, measured=replace(of.measured, record=record.with_traces(1.1 * record.d)))
    assert_allclose(density(other.measured), densities(other), rtol=1e-9)


NUMBER = 4000


def assert_distributed(drawn: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> None:
    """By the standard errors of means and of covariances; 5 of them, 6 of some thousand numbers."""
    number, sd = len(drawn), np.sqrt(np.diag(covariance))
    assert (np.abs(drawn.mean(0) - mean) <= 5 * sd / np.sqrt(number)).all()
    assert (np.abs(drawn.var(0) - sd**2) <= 5 * np.sqrt(2 / number) * sd**2).all()
    error = np.sqrt((np.outer(sd, sd) ** 2 + covariance**2) / number)
    assert (np.abs(np.cov(drawn.T) - covariance) <= 6 * error).all()


@pytest.mark.parametrize("make", [side_by_side, WITH_DISCREPANCY])
def test_samples_have_the_dense_mean_and_covariance(make: Make) -> None:
    of = make()
    keys = jax.random.split(jax.random.key(5), NUMBER)
    d = np.asarray(jax.jit(jax.vmap(of.measured.replicate))(keys)["deceleration"])
    for row, count in enumerate(np.asarray(of.measured.record.n_samples)):
        rows = normal(of, row)
        covariance = scatter(rows, np.asarray(of.measured.record.error_sd)[row])
        assert_distributed(d[:, row, :count], rows.mean, covariance)
        assert np.isnan(d[:, row, count:]).all()


def test_a_replicate_of_the_force_has_the_dense_mean_and_covariance() -> None:
    of = force_beside()
    record, rows = of.measured.record, normal(of, 0)
    keys = jax.random.split(jax.random.PRNGKey(0), NUMBER)
    drawn = np.asarray(jax.jit(jax.vmap(of.measured.replicate))(keys)["force"])[:, 0] / record.mass[0]
    count = int(record.force.n_samples[0])
    assert np.isnan(drawn[:, count:]).all()
    covariance = scatter(rows, np.asarray(record.error_sd)[0])
    assert_distributed(drawn[:, :count], rows.mean[-count:], covariance[-count:, -count:])


@pytest.mark.parametrize(
    "make",
    [force_beside, pytest.param(WITH_DISCREPANCY, marks=pytest.mark.slow)],
)
def test_errors_given_the_traces_are_those_of_the_joint_normal(make: Make) -> None:
    """Those of the chain, and the discrepancy where there is one."""
    of = make()
    keys = jax.random.split(jax.random.PRNGKey(2), NUMBER)
    drawn = jax.jit(jax.vmap(of.measured.draw_errors))(keys)
    delta, modes = np.asarray(of.measured.discrepancy(drawn)), of.measured.record.discrepancy.share.shape[1]
    for row, count in enumerate(np.asarray(of.measured.record.n_samples)):
        assert not delta[:, row, count:].any()
        together = [np.asarray(drawn)[:, row, modes:], delta[:, row, :count]][: 1 + bool(modes)]
        assert_distributed(np.concatenate(together, axis=1), *errors_given(of, row))
