from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayestissue.mechanics.oscillator import spring_damper
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import population_design
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.model.hierarchy.specification import Formulas
from bayestissue.model.hierarchy.trace_models import (
    NUISANCE,
    Kind,
    TraceData,
    TraceModel,
    log_likelihood,
    physical,
)
from bayestissue.model.likelihood.arma.displacements import displacement_record
from bayestissue.model.likelihood.element.record import Contact, DecelerationRecord

pytestmark = pytest.mark.slow

RNG = np.random.default_rng(6)
NUMBER, SAMPLES = 6, 12
KINDS: tuple[Kind, ...] = ("arma", "a2", "impact")


def made(kind: Kind) -> tuple[TraceModel, TraceData, GaussianFactor]:
    """Three people in two conditions, traces of a dozen samples, and summaries of anything."""
    rows = pd.DataFrame(
        {
            "subject": np.repeat(["a", "b", "c"], 2),
            "trial": np.tile(["x", "y"], 3),
            "mass_kg": np.tile([0.5, 1.2], 3),
        }
    )
    design = build_design(Formulas(), rows, reference_mass_kg=0.8, source="m.toml")
    locations, columns = population_design(design, Priors(), NUISANCE[kind])
    model = TraceModel(kind, locations, Priors(), correlated=True, log_mass_sd=0.02)
    start = (np.full(NUMBER, SAMPLES), np.full(NUMBER, 5e-4), np.full(NUMBER, 2e-3))
    errors = np.tile([1e-4, 0.02, 0.5], (NUMBER, 1))
    if kind == "impact":
        d = 50 + RNG.normal(size=(NUMBER, SAMPLES))
        contact, ball = Contact.known(np.arange(NUMBER) % 2 == 0), {"diameter_m": np.full(NUMBER, 0.03)}
        mass = rows["mass_kg"].to_numpy()
        record = DecelerationRecord.from_arrays(d, *start, np.full(NUMBER, 1.5), errors, mass, ball, contact)
        peak = 50.0
    else:
        x = 0.02 * np.sin(np.arange(SAMPLES) / 9) + 1e-4 * RNG.normal(size=(NUMBER, SAMPLES))
        record, peak = displacement_record(x, *start, errors), 0.02
    data = TraceData(
        record,
        jax.tree.map(jnp.asarray, columns),
        jnp.asarray(locations.mean),
        jnp.log(jnp.asarray(rows["mass_kg"].to_numpy())),
        jnp.full(NUMBER, np.log(peak)),
    )
    return model, data, sites_about(np.array([8.0, 3.0, -3.0, 0.3])[: 2 + len(model.nuisance)])


def sites_about(middle: np.ndarray) -> GaussianFactor:
    size = len(middle)
    root = RNG.normal(size=(NUMBER, size, size))
    centre = middle + 0.1 * RNG.normal(size=(NUMBER, size))
    return GaussianFactor(
        jnp.asarray(centre),
        jnp.asarray(RNG.normal(size=(NUMBER, size))),
        jnp.asarray(root @ root.swapaxes(1, 2) + np.eye(size)),
        jnp.asarray(RNG.normal(size=NUMBER)),
    )


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_become_those_of_the_likelihood_and_back(kind: Kind) -> None:
    model, data, summaries = made(kind)
    u = [summaries.centre[:, a] for a in range(summaries.centre.shape[1])]
    at = physical(model, data, u)
    K, C = spring_damper(at.omega_n, at.zeta, jnp.exp(data.log_mass))
    assert_allclose(jnp.log(K), u[0], rtol=1e-12)
    assert_allclose(jnp.log(C), u[1], rtol=1e-12)
    if kind == "arma":
        assert at.theta1 is not None
        assert_allclose(jnp.arctanh(at.theta1), u[3], rtol=1e-12)
        noise = at.log_sigma + jnp.log(1 + at.theta1**2) / 2
        assert_allclose(noise, u[2] + data.log_peak, rtol=1e-12)
    else:
        assert at.theta1 is None
        assert_allclose(at.log_sigma, u[2] + data.log_peak, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_an_impact_s_likelihood_is_its_own_trace_s_alone(kind: Kind) -> None:
    model, data, summaries = made(kind)
    u, density = summaries.centre, jax.jit(log_likelihood)
    together = density(model, data, list(u.T))
    assert together.shape == (NUMBER,)
    row = np.array([1])
    alone = density(model, data.impacts(row), list(u[row].T))
    assert_allclose(alone, together[row], rtol=1e-10)


def test_spreads_are_the_groups_the_impacts_and_the_nuisance() -> None:
    model, _, _ = made("arma")
    # Two conditions of one mass each are not told from their masses.
    groups = ["sd_subject_C", "sd_subject_K"]
    own = ["sd_impact_K", "sd_impact_C", "residual_correlation", "sd_noise", "sd_atanh_theta1"]
    assert list(model.hyperparameters) == [*groups, *own]
    for name in model.hyperparameters:
        assert model.prior_of(name).event_shape == ()
