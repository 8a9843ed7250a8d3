"""The fit's model as one would first write it in numpyro: what `fit_efficiency.py` measures against.

Nothing integrated out, nothing whitened. The standard deviations, the population and the effects are
sampled, the effects and each impact's deviations as standard normals times their standard deviation
(non-centred), and so are every impact's errors of mass, level, ramp and parabola; the likelihood is a Kalman
filter over samples.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array

from bayestissue.mechanics.oscillator import to_differences
from bayestissue.model.hierarchy.population import expected, shared_mass_errors
from bayestissue.model.hierarchy.trace_models import TraceData, TraceModel, physical, sample_hyperparameters


def cholesky_factor(sd_K: jax.Array, sd_C: jax.Array, correlation: jax.Array) -> jax.Array:
    """Lower Cholesky factor of [[sd_K², r sd_K sd_C], [r sd_K sd_C, sd_C²]]."""
    return jnp.array([[sd_K, 0.0], [sd_C * correlation, sd_C * jnp.sqrt(1 - correlation**2)]])


def plain(model: TraceModel, data: TraceData) -> None:
    """The density of `plain_model` in `bayestissue.model.hierarchy.trace_models`, the chain's errors latent.

    Deterministic sites ``locations`` (b), ``log_K`` and ``log_C`` of each impact are what is compared.
    """
    hyperparameters = sample_hyperparameters(model)
    number = data.log_mass.shape[0]
    spread = model.covariances(hyperparameters)
    b = data.location_mean + spread.locations * _standard("standard_locations", model.locations.size)
    about = expected(data.design, b)
    factor = cholesky_factor(
        *(hyperparameters[name] for name in ("sd_impact_K", "sd_impact_C", "residual_correlation"))
    )
    pair = _standard("standard_pair", number, 2) @ factor.T
    mass_error = model.own_mass_sd * _standard("standard_mass_error", number)
    if model.locations.of_shared_masses:
        shared = shared_mass_errors(model.locations, data.design, b)
        mass_error, about = mass_error + shared, about.at[:2].add(shared)
    log_K = numpyro.deterministic("log_K", about[0] + pair[:, 0])
    log_C = numpyro.deterministic("log_C", about[1] + pair[:, 1])
    numpyro.deterministic("locations", b)
    # K and C at the recorded mass are all that a trace knows of K, C and the mass.
    u = [log_K - mass_error, log_C - mass_error]
    for a, (name, sd) in enumerate(zip(model.nuisance, spread.nuisance, strict=True), start=2):
        u.append(about[a] + sd * _standard(f"standard_{name}", number))
    errors = data.record.error_sd * _standard("standard_errors", number, 3)
    numpyro.factor("traces", trace_density(model, data, u, errors).sum())


def trace_density(model: TraceModel, data: TraceData, u: list[Array], errors: Array) -> Array:
    """Log density of each trace, the errors of level, ramp and parabola given, by a filter over samples."""
    at, record = physical(model, data, u), data.record
    c1, c2, theta1 = to_differences(at.omega_n, at.zeta, record.dt)
    theta1 = theta1 if at.theta1 is None else at.theta1
    time = record.first_time[:, None] + jnp.arange(record.x.shape[1]) * record.dt[:, None]
    x = record.x - (errors[:, :1] + errors[:, 1:2] * time + errors[:, 2:] * time**2 / 2)
    slope = jnp.diff(x, axis=1)
    w = jnp.diff(slope, axis=1) + c1[:, None] * slope[:, :-1] + c2[:, None] * x[:, :-2]
    inside = jnp.arange(w.shape[1]) < record.n_samples[:, None] - 2

    def step(carry: tuple[Array, Array], part: tuple[Array, Array]) -> tuple[tuple[Array, Array], Array]:
        error, r = carry
        w_t, counts = part
        v = w_t + theta1 * error / r
        r = 1 + theta1**2 - theta1**2 / r
        density = -(jnp.log(2 * jnp.pi * r) + v**2 * jnp.exp(-2 * at.log_sigma) / r) / 2 - at.log_sigma
        return (v, r), jnp.where(counts, density, 0.0)

    # an infinite variance before the first sample gives it the unconditional one
    start = (jnp.zeros_like(c1), jnp.full_like(c1, 1e300))
    return jax.lax.scan(step, start, (w.T, jnp.asarray(inside.T)))[1].sum(0)


def _standard(name: str, *shape: int) -> Array:
    return numpyro.sample(name, dist.Normal().expand(list(shape)).to_event(len(shape)))


def check_density(model: TraceModel, data: TraceData, u: list[Array]) -> None:
    """Refuse to compare unless the filter gives the library's density, errors given.

    Raises:
        AssertionError: the two differ.
    """
    from bayestissue.model.hierarchy.trace_models import trace_likelihood

    record = data.record
    rng = np.random.default_rng(0)
    errors = jnp.asarray(record.error_sd) * rng.standard_normal(record.error_sd.shape)
    time = record.first_time[:, None] + jnp.arange(record.x.shape[1]) * record.dt[:, None]
    x = record.x - (errors[:, :1] + errors[:, 1:2] * time + errors[:, 2:] * time**2 / 2)
    known = record._replace(error_sd=jnp.zeros_like(record.error_sd))
    exact = replace(data, record=known.with_traces(np.asarray(x)))
    np.testing.assert_allclose(
        trace_density(model, data, u, errors), trace_likelihood(model, exact, u).log_density(), rtol=1e-7
    )
