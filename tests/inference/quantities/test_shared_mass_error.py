"""A mass in error moves log K and log C alike in all impacts that share it."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from numpyro.distributions import biject_to

from bayestissue.inference.quantities.quantity_draws import posterior_draws, prior_draws
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import MassError
from bayestissue.model.hierarchy.trace_data import Prepared
from chain_of_sites import chain_of_sites
from studies_by_mass import prepared_study

PEOPLE, EACH, RELATIVE_SD = 3, 10, 0.2
FORMULA = "(1|subject) + (1|trial)"
SPREADS = {"sd_subject_K": 1.0, "sd_subject_C": 0.8, "sd_impact_K": 0.05, "sd_impact_C": 0.07}
SPREADS |= {"sd_trial_K": 0.01, "sd_trial_C": 0.01, "residual_correlation": 0.3, "sd_noise": 0.2}
DRAWS = 1500


def prepared(mass_error: MassError) -> Prepared:
    """Of three masses, a person's each."""
    count = PEOPLE * EACH
    rows = pd.DataFrame(
        {
            "impact": [f"i{i}" for i in range(count)],
            "subject": np.repeat(list("abc"), EACH),
            "trial": np.tile(["x", "y"], count // 2),
            "mass_kg": np.repeat([0.5, 0.8, 1.2], EACH),
            "velocity_m_s": 1.5,
        }
    )
    return prepared_study(rows, FORMULA, mass_error, RELATIVE_SD)


def summaries() -> GaussianFactor:
    count = PEOPLE * EACH
    rng = np.random.default_rng(1)
    centre = np.array([8.0, 3.0, -6.0]) + 0.1 * rng.normal(size=(count, 3))
    root = 0.3 * rng.normal(size=(count, 3, 3))
    each = 1e8 * (root @ root.swapaxes(1, 2) + np.eye(3))
    return GaussianFactor(*map(jnp.asarray, (centre, np.zeros((count, 3)), each, np.zeros(count))))


def drawn(made: Prepared, told: GaussianFactor) -> dict[str, np.ndarray]:
    """Draws of log K and log C of people, the spreads given: exact, since the summaries are normal."""
    inverse = {name: biject_to(made.model.prior_of(name).support).inv for name in made.model.hyperparameters}
    y = np.array([float(inverse[name](SPREADS[name])) for name in made.model.hyperparameters])
    chains = chain_of_sites(made, told, np.tile(y, (1, DRAWS, 1)), np.random.default_rng(2))
    found = posterior_draws(made, chains, 3)
    people = {
        q: (found.population[f"intercept_{q}"][..., None] + found.population[f"subject_effect_{q}"])[0]
        for q in "KC"
    }
    return people | {"mass": found.impacts["mass"][0], "log K": np.log(found.impacts["K"][0])}


def test_a_mass_of_each_person_is_an_error_of_people() -> None:
    of_masses, of_people = prepared("mass"), prepared("subject")
    assert of_masses.model == of_people.model
    jax.tree.map(np.testing.assert_array_equal, of_masses.data, of_people.data)


@pytest.mark.slow
def test_one_error_of_all_masses_moves_all_alike_and_is_as_wide_as_declared() -> None:
    made, told = prepared("all"), summaries()
    found = drawn(made, told)
    error = np.log(found["mass"]) - np.asarray(made.data.log_mass)
    assert_allclose(error, np.broadcast_to(error[:, :1], error.shape), atol=1e-12)
    # A standard deviation's relative standard error is 1 / sqrt(2 n).
    assert error[:, 0].std() == pytest.approx(RELATIVE_SD, rel=4 / np.sqrt(2 * DRAWS))
    # At the declared masses it is the fit whose masses are exact, draw by draw: people and impacts.
    exact = drawn(replace(made, common_mass_sd=0.0), told)
    for name in ("K", "C", "log K"):
        assert_allclose(found[name] - error[:, :1], exact[name], atol=1e-12)


def test_before_anything_is_recorded_an_error_of_its_mass_does_not_widen_an_impact() -> None:
    made = prepared("impact")
    prior = prior_draws(made, 1)
    mass = np.log(prior.impacts["mass"]) - np.asarray(made.data.log_mass)
    number, design = mass.size, made.design
    assert mass.std() == pytest.approx(RELATIVE_SD, rel=4 / np.sqrt(2 * number))
    expected = prior.population["intercept_K"][..., None] + sum(
        prior.population[f"{name}_effect_K"][..., grouping.code]
        for name, grouping in design.groupings.items()
    )
    standard = (np.log(prior.impacts["K"]) - expected) / prior.population["sd_impact_K"][..., None]
    assert standard.std() == pytest.approx(1.0, rel=4 / np.sqrt(2 * number))
    # The mass errs whatever its impact's stiffness is.
    assert np.corrcoef(mass.ravel(), standard.ravel())[0, 1] == pytest.approx(0.0, abs=4 / np.sqrt(number))
