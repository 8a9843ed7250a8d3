from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from jax.flatten_util import ravel_pytree
from numpy.testing import assert_allclose
from numpyro.infer.util import log_density, potential_energy

from bayestissue.hierarchy.design import build_design
from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.population import population_design
from bayestissue.hierarchy.priors import Priors
from bayestissue.hierarchy.specification import Formulas, ModelSpecification
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.hierarchy.traces import (
    COORDINATES,
    NUISANCE,
    Kind,
    TraceData,
    TraceModel,
    from_standard,
    log_likelihood,
    physical,
    plain_model,
    sampled_model,
)
from bayestissue.hierarchy.warp import SinhArcsinh
from bayestissue.likelihood.arma.displacement import displacement_record
from bayestissue.likelihood.element.record import Contact, DecelerationRecord
from bayestissue.oscillator import spring_damper
from bayestissue.simulation import Simulation, simulate

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


def made_with_arm() -> tuple[TraceModel, TraceData, GaussianFactor]:
    """The same by the standard linear element, whose ratio of springs is each person's own."""
    conditions = [{"trial": f"m{mass}", "mass_kg": mass, "velocity_m_s": 1.0} for mass in (0.5, 1.2)]
    content = {
        **{"name": "arm", "design": {"subjects": 3, "conditions": conditions}},
        "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0},
        "recording": {"sampling_rate_hz": 500.0, "noise_relative_to_peak": 0.01, "relative_mass_sd": 0.02},
    }
    dataset = simulate(Simulation.model_validate(content)).dataset("arm")
    formula = {"K": "log(mass_kg)", "C": "(1|subject)", "arm_ratio": "log(mass_kg) + (1|subject)"}
    file = {"name": "arm", "likelihood": "impact", "element": "standard_linear", "discrepancy": "none"}
    given = prepare(dataset, ModelSpecification.model_validate({**file, "formula": formula}), source="m.toml")
    return given.model, given.data, sites_about(np.array([7.6, 3.2, -4.6, 0.7]))


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


def point(model: TraceModel) -> tuple[dict[str, jax.Array], jax.Array, jax.Array]:
    sites = {name: jnp.asarray(RNG.uniform(0.2, 0.6)) for name in model.hyperparameters}
    z_b = jnp.asarray(RNG.normal(size=model.locations.size))
    return sites, z_b, jnp.asarray(RNG.normal(size=(NUMBER, 2 + len(model.nuisance))))


# The others are these with fewer parameters an impact.
FEWER = [pytest.param(kind, marks=pytest.mark.long) for kind in ("a2", "impact")]


@pytest.mark.parametrize("kind", ["arma", *FEWER, "arm"])
def test_both_models_are_one_density_in_two_coordinates(kind: Kind | Literal["arm"]) -> None:
    model, data, summaries = made_with_arm() if kind == "arm" else made(kind)

    @jax.jit
    def both(sites: dict[str, jax.Array], z_b: jax.Array, z_u: jax.Array) -> tuple[jax.Array, ...]:
        flat, unravel = ravel_pytree((z_b, z_u))

        def mapped(flat: jax.Array) -> jax.Array:
            found = from_standard(model, data, summaries, sites, *unravel(flat))
            return jnp.concatenate([found.b, jnp.stack(found.u, axis=1).ravel()])

        found = from_standard(model, data, summaries, sites, z_b, z_u)
        plain = {
            **sites,
            "locations": found.b,
            "log_K_and_C": jnp.stack(found.u[:2], axis=1),
            **dict(zip(model.nuisance, found.u[2:], strict=True)),
        }
        sampled = {**sites, "standard_locations": z_b, "standard_impacts": z_u}
        above, _ = log_density(plain_model, (model, data), {}, plain)
        below, _ = log_density(sampled_model, (model, data, summaries), {}, sampled)
        return above, below, jax.jacfwd(mapped)(flat)

    for _ in range(2):
        above, below, slopes = both(*point(model))
        _, log_jacobian = np.linalg.slogdet(slopes)
        # No constant is left over. The terms are sums of some thousands in size.
        assert float(below) == pytest.approx(float(above) + log_jacobian, rel=1e-9)


def test_an_element_has_slopes_where_places_are_filled_up() -> None:
    """As the exact path asks for them: backwards, the last place being no impact."""
    model, data, summaries = made_with_arm()
    sites, z_b, z_u = point(model)
    present = jnp.arange(NUMBER) < NUMBER - 1
    summaries = jax.tree.map(lambda leaf: leaf.at[-1].set(0.0), summaries)  # noqa: PD008 - of jax

    @jax.jit
    @jax.value_and_grad
    def density(z_u: jax.Array) -> jax.Array:
        values = {**sites, "standard_locations": z_b, "standard_impacts": z_u}
        return log_density(sampled_model, (model, data, summaries, None, present), {}, values)[0]

    along, step = jnp.asarray(RNG.normal(size=z_u.shape)), 1e-5
    slope = float((density(z_u)[1] * along).sum())
    above, below = (float(density(z_u + side * step * along)[0]) for side in (1, -1))
    # Differences of a density of some thousands, each known to some 1e-13 of that, and their third order.
    assert (above - below) / (2 * step) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("last", [pytest.param(False, marks=pytest.mark.long), True])
def test_warped_coordinates_have_the_same_density_of_the_unconstrained_ones(last: bool) -> None:
    """Of one likelihood: what is warped is the same for all."""
    model, data, summaries = made("a2")
    _, z_b, z_u = point(model)
    size = len(model.hyperparameters) + last
    warp = SinhArcsinh(RNG.normal(size=size), RNG.uniform(0.5, 1.5, size), RNG.uniform(-0.4, 0.4, size))
    y, y_last = RNG.normal(size=len(model.hyperparameters)), float(z_b[-1])
    raw = dict(zip(model.hyperparameters, warp.part(slice(len(y)))(y), strict=True))
    z_last = float(warp.part(-1)(y_last)) if last else y_last
    own = {"standard_locations": jnp.append(z_b[:-1], z_last), "standard_impacts": z_u}
    sampled = {COORDINATES: y, "standard_locations": z_b, "standard_impacts": z_u}
    below, above = jax.jit(
        lambda plain, warped: (
            potential_energy(sampled_model, (model, data, summaries), {}, plain),
            potential_energy(sampled_model, (model, data, summaries, warp), {}, warped),
        )
    )(raw | own, sampled)
    along = np.append(y, y_last) if last else y
    assert float(above) == pytest.approx(float(below) - np.log(warp.slope(along)).sum(), rel=1e-12)


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
    groups = ["sd_subject_C", "sd_subject_K", "sd_trial_C", "sd_trial_K"]
    own = ["sd_impact_K", "sd_impact_C", "residual_correlation", "sd_noise", "sd_atanh_theta1"]
    assert list(model.hyperparameters) == [*groups, *own]
    for name in model.hyperparameters:
        assert model.prior_of(name).event_shape == ()
