"""A mass in error moves log K and log C alike in all impacts that share it: a person's, or an impactor's."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from numpyro.distributions import biject_to

from bayestissue.inference.fit import draws_of_chain
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import MassError
from bayestissue.model.hierarchy.trace_data import Prepared
from chain_of_sites import chain_of_sites
from studies_by_mass import prepared_study

PEOPLE, EACH, RELATIVE_SD = 3, 10, 0.2
MASSES = [0.5, 0.8, 1.2]
FORMULA = "(1|subject) + (1|trial)"
SPREADS = {"sd_subject_K": 1.0, "sd_subject_C": 0.8, "sd_impact_K": 0.05, "sd_impact_C": 0.07}
OTHERS = {"sd_trial_K": 0.01, "sd_trial_C": 0.01, "residual_correlation": 0.3, "sd_noise": 0.2}
DRAWS = 1500


def prepared(mass_error: MassError, *, across: bool = False) -> Prepared:
    """Of three masses, a person's each, or all of them of each person."""
    count = PEOPLE * EACH
    rows = pd.DataFrame(
        {
            "impact": [f"i{i}" for i in range(count)],
            "subject": np.repeat(list("abc"), EACH),
            "trial": np.tile(["x", "y"], count // 2),
            "mass_kg": np.tile(MASSES, EACH) if across else np.repeat(MASSES, EACH),
            "velocity_m_s": 1.5,
        }
    )
    return prepared_study(rows, FORMULA, mass_error, RELATIVE_SD)


def summaries(precision: float) -> GaussianFactor:
    count = PEOPLE * EACH
    rng = np.random.default_rng(1)
    centre = np.array([8.0, 3.0, -6.0]) + 0.1 * rng.normal(size=(count, 3))
    root = 0.3 * rng.normal(size=(count, 3, 3))
    each = precision * (root @ root.swapaxes(1, 2) + np.eye(3))
    return GaussianFactor(*map(jnp.asarray, (centre, np.zeros((count, 3)), each, np.zeros(count))))


def drawn(made: Prepared, told: GaussianFactor) -> dict[str, np.ndarray]:
    """Draws of log K and log C of people, the spreads given: exact, since the summaries are normal."""
    inverse = {name: biject_to(made.model.prior_of(name).support).inv for name in made.model.hyperparameters}
    y = np.array([float(inverse[name](value)) for name, value in in_order(made)])
    chains = chain_of_sites(made, told, np.tile(y, (1, DRAWS, 1)), np.random.default_rng(2))
    found = draws_of_chain(made, chains, 3)
    people = {
        q: (found.population[f"intercept_{q}"][..., None] + found.population[f"subject_effect_{q}"])[0]
        for q in "KC"
    }
    return people | {"mass": found.impacts["mass"][0], "log K": np.log(found.impacts["K"][0])}


def in_order(made: Prepared) -> list[tuple[str, float]]:
    """The spreads as the model has them."""
    return [(name, (SPREADS | OTHERS)[name]) for name in made.model.hyperparameters]


def dense_sd(told: GaussianFactor, priors: tuple[float, float]) -> np.ndarray:
    """The posterior sd of log K and log C of person a by a dense normal over effects and errors."""
    subject, trial = np.repeat(np.arange(PEOPLE), EACH), np.tile([0, 1], PEOPLE * EACH // 2)
    # per response: intercept, three people, two trials; then the three people's errors
    sd = np.concatenate([[p, *[s] * PEOPLE, 0.01, 0.01] for p, s in zip(priors, (1.0, 0.8), strict=True)])
    sd = np.append(sd, [RELATIVE_SD] * PEOPLE)
    own = np.ones((PEOPLE * EACH, 1)), subject[:, None] == np.arange(PEOPLE), trial[:, None] == np.arange(2)
    block = np.concatenate(own, axis=1).astype(float)
    zero, error = np.zeros_like(block), -own[1].astype(float)
    X = np.stack([np.hstack([block, zero, error]), np.hstack([zero, block, error])], axis=1)
    scatter = np.array([[0.05**2, 0.3 * 0.05 * 0.07], [0.3 * 0.05 * 0.07, 0.07**2]])
    # The noise's own mean and spread are as good as unknown here: its entry is integrated out of P.
    noise = np.linalg.inv(np.linalg.inv(np.asarray(told.precision))[:, :2, :2] + scatter)
    precision = np.einsum("iap,iab,ibq->pq", X, noise, X) + np.diag(sd**-2.0)
    covariance = np.linalg.inv(precision)
    pick = np.zeros((2, len(sd)))
    pick[0, [0, 1]] = pick[1, [6, 7]] = 1
    return np.sqrt(np.diag(pick @ covariance @ pick.T))


@pytest.mark.slow
def test_k_of_a_person_is_no_surer_than_the_persons_mass() -> None:
    told = summaries(1e8)
    made = prepared("subject")
    found = drawn(made, told)
    priors = made.model.priors.intercept
    wanted = dense_sd(told, (priors.K.sd, priors.C.sd))
    for place, q in enumerate("KC"):
        sd = found[q][:, 0].std()
        # A standard deviation's relative standard error is 1 / sqrt(2 n).
        assert sd == pytest.approx(wanted[place], rel=4 / np.sqrt(2 * DRAWS))
        low, high = np.quantile(found[q][:, 0], [0.05, 0.95])
        assert (high - low) / 2 > RELATIVE_SD
    alone = drawn(prepared("impact"), told)
    # Errors of each impact's own average out: these, and the impacts' scatter, over their number.
    averaged = np.hypot(RELATIVE_SD, SPREADS["sd_impact_K"]) / np.sqrt(EACH)
    assert alone["K"][:, 0].std() < 1.1 * averaged
    assert alone["mass"][:, :EACH].std(axis=1).min() > 0


@pytest.mark.slow
@pytest.mark.parametrize("across", [False, True])
def test_impacts_of_one_mass_have_the_same_error_and_others_another(across: bool) -> None:
    made = prepared("mass", across=across)
    found = drawn(made, summaries(1e8))
    error = np.log(found["mass"]) - np.asarray(made.data.log_mass)
    _, first, code = np.unique(made.impacts["mass_kg"], return_index=True, return_inverse=True)
    assert_allclose(error, error[:, first][:, code], atol=1e-12)
    assert (np.abs(np.diff(error[:, first], axis=1)) > 1e-6).all()
    # What a trace tells is log K - e; only K itself moves with the mass.
    seen = (found["log K"] - error).std(axis=0)
    assert (seen < 1e-3).all()


def test_a_mass_of_each_person_is_an_error_of_people() -> None:
    of_masses, of_people = prepared("mass"), prepared("subject")
    assert of_masses.model == of_people.model
    jax.tree.map(np.testing.assert_array_equal, of_masses.data, of_people.data)


def test_one_error_of_all_masses_moves_all_alike_and_is_as_wide_as_declared() -> None:
    made, told = prepared("all"), summaries(1e8)
    found = drawn(made, told)
    error = np.log(found["mass"]) - np.asarray(made.data.log_mass)
    assert_allclose(error, np.broadcast_to(error[:, :1], error.shape), atol=1e-12)
    # A standard deviation's relative standard error is 1 / sqrt(2 n).
    assert error[:, 0].std() == pytest.approx(RELATIVE_SD, rel=4 / np.sqrt(2 * DRAWS))
    # At the declared masses it is the fit whose masses are exact, draw by draw: people and impacts.
    exact = drawn(replace(made, common_mass_sd=0.0), told)
    for name in ("K", "C", "log K"):
        assert_allclose(found[name] - error[:, :1], exact[name], atol=1e-12)
