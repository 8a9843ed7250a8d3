"""Impactors that were weighed once each, against one dense normal."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from jax import Array
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from bayestissue.model.hierarchy.gaussian.effects import effects_from_standard
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import MassError
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import sites_by_cell
from studies_by_mass import prepared_study

PEOPLE, REPEATS, MASSES = 10, 2, (0.4, 0.7, 1.2)
COUNT = PEOPLE * len(MASSES) * REPEATS
# The masses are 5 % wrong, up and down.
MASS_SD, ERRORS = 0.05, np.array([0.05, -0.05, 0.05])
FORMULA = "log(mass_kg) + (1|subject)"
# Standard deviations of people and impacts in log K and log C, and the correlation of the latter.
PERSON, IMPACT, CORRELATION = np.array([0.2, 0.25]), np.array([0.03, 0.05]), 0.4
EXPONENT = np.array([0.3, 0.6])
AT_MEAN = np.log([3000.0, 25.0])
# Of the sites: log K, log C and the noise.
TOLD = np.array([0.01, 0.03, 0.1])
KNOWN = {
    **dict(zip(("sd_subject_K", "sd_subject_C"), PERSON, strict=True)),
    **dict(zip(("sd_impact_K", "sd_impact_C"), IMPACT, strict=True)),
    "residual_correlation": CORRELATION,
    "sd_noise": 0.2,
}


def rows(masses: tuple[float, ...] = MASSES) -> pd.DataFrame:
    person, mass = (each.ravel() for each in np.indices((PEOPLE, len(MASSES) * REPEATS)))
    return pd.DataFrame(
        {
            "impact": [f"i{i}" for i in range(COUNT)],
            "subject": [f"s{p}" for p in person],
            "trial": "all",
            "mass_kg": np.array(masses)[(mass + person * (len(masses) == COUNT) * 6) % len(masses)],
            "velocity_m_s": 1.5,
        }
    )


def prepared(mass_error: MassError, table: pd.DataFrame, formula: str = FORMULA) -> Prepared:
    return prepared_study(table, formula, mass_error, MASS_SD)


def sites() -> GaussianFactor:
    """What traces tell of a study in which each declared mass is wrong."""
    rng, table = np.random.default_rng(7), rows()
    code = np.unique(table["mass_kg"], return_inverse=True)[1]
    person = np.unique(table["subject"], return_inverse=True)[1]
    scatter = np.outer(IMPACT, IMPACT) * np.array([[1, CORRELATION], [CORRELATION, 1]])
    log_mass = np.log(table["mass_kg"] / np.exp(np.log(table["mass_kg"]).mean())).to_numpy()
    u = AT_MEAN + EXPONENT * log_mass[:, None] + (PERSON * rng.normal(size=(PEOPLE, 2)))[person]
    u += rng.multivariate_normal(np.zeros(2), scatter, COUNT) - ERRORS[code, None]
    centre = np.column_stack([u, rng.normal(-5, 0.2, COUNT)]) + TOLD * rng.normal(size=(COUNT, 3))
    precision = np.broadcast_to(np.diag(TOLD**-2.0), (COUNT, 3, 3))
    return GaussianFactor(*map(jnp.asarray, (centre, np.zeros((COUNT, 3)), precision, np.zeros(COUNT))))


def found(made: Prepared, told: GaussianFactor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log density, mean of b, and a root of its covariance."""
    known = {name: jnp.asarray(KNOWN[name]) for name in made.model.hyperparameters}
    prior_mean = jnp.asarray(made.model.locations.mean)

    @jax.jit
    def of() -> tuple[Array, Array, Array]:
        data = sites_by_cell(made.data, told)
        conditional, log_density = data.integrated(made.model.covariances(known))
        b = effects_from_standard(data.design, conditional, prior_mean)
        unit = jnp.eye(len(b))
        drawn = jax.vmap(lambda z: effects_from_standard(data.design, conditional, prior_mean, z))(unit)
        return log_density, b, (drawn - b).T

    return tuple(map(np.asarray, of()))  # type: ignore[return-value]


def dense(told: GaussianFactor, priors: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Log density, and mean and covariance of intercepts and exponents, of log K and then of log C.

    ``priors`` [(intercept, exponent) of each, (mean, sd)].
    """
    table = rows()
    log_mass = np.log(table["mass_kg"] / np.exp(np.log(table["mass_kg"]).mean())).to_numpy()
    person, mass = (table[name].to_numpy() for name in ("subject", "mass_kg"))
    X = np.column_stack([np.ones(COUNT), log_mass])
    whole = np.kron(np.ones((2, 2)), MASS_SD**2 * (mass[:, None] == mass))
    whole += np.kron(np.diag(PERSON**2), person[:, None] == person)
    scatter = np.outer(IMPACT, IMPACT) * np.array([[1, CORRELATION], [CORRELATION, 1]])
    whole += np.kron(scatter + np.diag(TOLD[:2] ** 2), np.eye(COUNT))
    X = np.kron(np.eye(2), X)
    mean, sd = priors.T
    seen = np.asarray(told.centre)[:, :2].T.ravel()
    of_seen = whole + X * sd**2 @ X.T
    gain = np.linalg.solve(of_seen, X * sd**2).T
    covariance = np.diag(sd**2) - gain @ X * sd**2
    value = multivariate_normal(X @ mean, of_seen).logpdf(seen)
    return float(value), mean + gain @ (seen - X @ mean), covariance


def fixed(made: Prepared) -> np.ndarray:
    """Where intercepts and mass exponents are in b."""
    parts = made.model.locations.parts
    return np.array([parts[f"{name}_{q}"].start for q in "KC" for name in ("intercept", "mass_exponent")])


def test_the_posterior_is_that_of_the_dense_normal() -> None:
    made, told = prepared("mass", rows()), sites()
    at, locations = fixed(made), made.model.locations
    priors = np.stack([locations.mean[at], locations.sd[at]], axis=-1)
    (log_density, b, root), (value, mean, covariance) = found(made, told), dense(told, priors)
    # The noise is a factor by itself, and a site's constant that of a normal's density.
    noise_mean, noise_sd = made.model.priors.noise.mean, made.model.priors.noise.sd
    of_noise = KNOWN["sd_noise"] ** 2 + TOLD[2] ** 2
    noise = multivariate_normal(
        np.full(COUNT, noise_mean), of_noise * np.eye(COUNT) + noise_sd**2 * np.ones((COUNT, COUNT))
    ).logpdf(np.asarray(told.centre)[:, 2])
    constants = COUNT * (1.5 * np.log(2 * np.pi) + np.log(TOLD).sum())
    assert_allclose(log_density, value + noise + constants, rtol=1e-10)
    assert_allclose(b[at], mean, rtol=1e-9, atol=1e-10)
    assert_allclose((root @ root.T)[np.ix_(at, at)], covariance, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(
    ("masses", "same_as", "formula"),
    [((0.7,), "all", "(1|subject)"), (tuple(np.linspace(0.4, 1.2, COUNT)), "impact", FORMULA)],
)
def test_one_mass_is_one_error_of_all_and_different_masses_have_their_own(
    masses: tuple[float, ...], same_as: MassError, formula: str
) -> None:
    table = rows(masses)
    assert table["mass_kg"].nunique() == len(masses)
    of_masses, other = (prepared(whose, table, formula) for whose in ("mass", same_as))
    assert of_masses.model == other.model
    assert of_masses.common_mass_sd == other.common_mass_sd == (MASS_SD if same_as == "all" else 0.0)
    assert of_masses.mass_group is None
    jax.tree.map(np.testing.assert_array_equal, of_masses.data, other.data)
