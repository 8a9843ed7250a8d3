"""The hierarchy over published estimates, against dense normals and against its other writing."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpyro.distributions import biject_to
from numpyro.infer.util import log_density
from scipy.stats import multivariate_normal, norm

from bayestissue.model.hierarchy.gaussian.arrangement import expected
from bayestissue.model.hierarchy.gaussian.effects import effects_from_standard
from bayestissue.model.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.model.hierarchy.trace_models import hyperparameters_at
from bayestissue.recordings.dataset.published import read_published
from bayestissue.thesis.reanalysis.observations import (
    published_design,
    published_observations,
)
from bayestissue.thesis.reanalysis.table_model import (
    EstimatesModel,
    common_effects,
    densities,
    estimates_data,
    integrated,
    leave_one_out,
    without,
)
from published_model import AveragesOfLognormals, plain_model

pytestmark = pytest.mark.slow

OWN_EXPONENTS = "log(mass_kg) + (log(mass_kg)|subject) + (1|trial)"
SPECIFICATION = ModelSpecification(
    name="small",
    likelihood="published-estimates",
    formula=Formulas(K=OWN_EXPONENTS, C="log(mass_kg) + (1|subject) + (1|trial)"),
)
PRIORS = SPECIFICATION.complete_priors()
SITES = {
    "sd_subject_mass_exponent_K": 0.1,
    "sd_subject_K": 0.05,
    "sd_subject_C": 0.2,
    "sd_trial_K": 0.02,
    "sd_trial_C": 0.15,
    "sd_impact_K": 0.04,
    "sd_impact_C": 0.5,
    "residual_correlation": -0.4,
}


class Draw(NamedTuple):
    """Effects from standard normals, and the densities there."""

    b: Any
    scatter: Any
    log_density: Any
    log_ratio: Any
    rows: Any


def coordinates(model: EstimatesModel, hyperparameters: dict[str, Any]) -> jax.Array:
    """Unconstrained, of the hyperparameters by name."""
    return jnp.stack(
        [biject_to(model.prior_of(name).support).inv(hyperparameters[name]) for name in model.hyperparameters]
    )


def log_evidence(model: EstimatesModel, data: Any, hyperparameters: dict[str, Any]) -> jax.Array:
    """Of the rows that are kept, the hyperparameters given."""
    y = coordinates(model, hyperparameters)
    return integrated(model, data, y).log_density - hyperparameters_at(model, y)[1]


def draw_effects(
    model: EstimatesModel, data: Any, hyperparameters: dict[str, Any], standard: jax.Array
) -> Draw:
    y = coordinates(model, hyperparameters)
    conditional = integrated(model, data, y).conditional
    b = effects_from_standard(data.design, conditional, data.location_mean, standard)
    at = densities(model, data, y, b)
    return Draw(b, at.scatter, log_evidence(model, data, hyperparameters), at.log_ratio, at.rows)


evidence, drawn_effects = jax.jit(log_evidence), jax.jit(draw_effects)
given_others = jax.jit(
    lambda model, data, hyperparameters: leave_one_out(model, data, coordinates(model, hyperparameters))
)
SCATTER = np.array([[0.002, 0.03], [0.003, 0.05]])
TABLES = 2


@pytest.fixture(scope="module")
def setting():
    """The thesis's tables, people with exponents of their own, in an arrangement with room for another."""
    observations = published_observations(read_published())
    energy = Formulas(K="log(energy_J) + (1|subject)", C="log(energy_J) + (1|subject)")
    designs = [
        published_design(observations, SPECIFICATION, formulas=formulas)
        for formulas in (SPECIFICATION.formula, energy)
    ]
    model = EstimatesModel(common_effects(designs, PRIORS), PRIORS, True)
    data = estimates_data(designs[0], observations, model)._replace(scatter=SCATTER)
    hyperparameters = {name: jnp.asarray(value) for name, value in SITES.items()}
    return observations, designs[0], model, data, hyperparameters


def dense(setting):
    """Mean and covariance of all estimates (K and C of one after the other), b integrated out by matrices."""
    _, _, model, data, hyperparameters = setting
    sd, X = jax.jit(
        lambda hyperparameters: (
            model.covariances(hyperparameters).locations,
            expected(data.design, jnp.eye(model.locations.size)),
        )
    )(hyperparameters)
    # [parameter, element of b, row] to [row and parameter, element of b].
    sd, X = np.asarray(sd), np.asarray(X)[..., TABLES:]
    X = np.moveaxis(X, (2, 0), (0, 1)).reshape(-1, len(sd))
    r = SITES["residual_correlation"] * SITES["sd_impact_K"] * SITES["sd_impact_C"]
    own = np.array([[SITES["sd_impact_K"] ** 2, r], [r, SITES["sd_impact_C"] ** 2]])
    return X @ data.location_mean, X * sd**2 @ X.T + np.kron(np.eye(len(X) // 2), own)


def test_the_estimates_together_are_one_normal(setting) -> None:
    _, _, model, data, hyperparameters = setting
    only = without(data, np.arange(len(data.value)) < TABLES)
    direct = multivariate_normal(*dense(setting)).logpdf(data.value[TABLES:].ravel())
    # A Cholesky factor of a matrix with a condition number of some 1e6, over a sum of some hundred.
    assert_allclose(evidence(model, only, hyperparameters), direct, rtol=1e-9)


def test_an_estimate_given_all_others_is_the_ratio_of_two_densities(setting) -> None:
    _, _, model, data, hyperparameters = setting
    found = given_others(model, data, hyperparameters)
    whole = evidence(model, data, hyperparameters)
    for row in (0, 1, 2, 40, 71):
        others = evidence(model, without(data, np.arange(len(data.value)) == row), hyperparameters)
        assert_allclose(found[row], whole - others, atol=1e-7)


def test_both_writings_are_one_density(setting) -> None:
    _, _, model, data, hyperparameters = setting
    kept = without(data, np.arange(len(data.value)) % 7 == 0)

    @jax.jit
    def both(z: jax.Array) -> tuple[jax.Array, ...]:
        drawn = draw_effects(model, kept, hyperparameters, z)
        slope = jax.jacobian(lambda z: draw_effects(model, kept, hyperparameters, z).b)(z)
        plain, _ = log_density(plain_model, (model, kept), {}, hyperparameters | {"locations": drawn.b})
        priors = sum(model.prior_of(name).log_prob(value) for name, value in hyperparameters.items())
        return drawn.log_density + drawn.log_ratio + priors, slope, plain

    for seed in range(3):
        z = jnp.asarray(np.random.default_rng(seed).standard_normal(model.locations.size))
        own, slope, plain = both(z)
        standard = norm.logpdf(np.asarray(z)).sum() - np.linalg.slogdet(np.asarray(slope))[1]
        sampled = own + standard
        assert_allclose(plain, sampled, rtol=1e-9)


def test_rows_have_the_densities_of_the_distributions(setting) -> None:
    observations, design, model, data, hyperparameters = setting
    z = jnp.asarray(np.random.default_rng(5).standard_normal(model.locations.size))
    drawn = drawn_effects(model, data, hyperparameters, z)
    b, parts = np.asarray(drawn.b), model.locations.parts
    logs = np.stack(
        [
            b[parts[f"intercept_{q}"]]
            + b[parts[f"mass_exponent_{q}"]] * design.responses[q].log_mass
            + b[parts[f"subject_effect_{q}"]][design.subject]
            + b[parts[f"trial_effect_{q}"]][design.trial]
            for q in "KC"
        ],
        axis=-1,
    )
    of_people = b[parts["subject_mass_exponent_deviation_K"]][design.subject]
    logs[:, 0] += of_people * design.responses["K"].log_mass
    r, sd = SITES["residual_correlation"], np.array([SITES["sd_impact_K"], SITES["sd_impact_C"]])
    scale = np.array([[sd[0], 0.0], [r * sd[1], sd[1] * np.sqrt(1 - r**2)]])
    estimates = multivariate_normal([0, 0], scale @ scale.T)
    away = observations.log_estimates - logs[observations.impact_cell]
    assert_allclose(drawn.rows[TABLES:], estimates.logpdf(away), rtol=1e-9, atol=1e-9)
    tables = jax.jit(
        lambda logs: AveragesOfLognormals(logs, jnp.asarray(scale)).log_prob(observations.averages)
    )
    averaged = tables(logs[observations.averaged_cells])
    assert_allclose(drawn.rows[:TABLES], averaged, rtol=1e-9, atol=1e-9)
