"""A hierarchy whose traces are Gaussian in their parameters: what is drawn from it is known in law."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jax.scipy.special import logsumexp
from numpyro import handlers
from numpyro.distributions import biject_to

from bayestissue.inference.chain.moves import State, Steps, StudentT, Tuning
from bayestissue.inference.chain.target import FIELDS, SIZES, Target
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import impacts_model
from bayestissue.recordings.dataset.arrays import dataset

# Standard deviations with which a trace tells log K, log C, the noise, and a gain, or the log of a mass that
# moves along.
TOLD = np.array([0.1, 0.3, 0.2, 0.4])


@partial(jax.tree_util.register_dataclass, data_fields=[*FIELDS, "traces"], meta_fields=SIZES)
@dataclass(frozen=True)
class GaussianTarget(Target):
    """A posterior whose traces' likelihoods are ``traces``."""

    traces: Any = None

    def log_likelihoods(self, u: Any) -> Any:
        return np.asarray([self.log_likelihood(one) for one in u])

    def log_likelihood(self, u: Array) -> Array:
        return jnp.where(self.present, self.traces.log_density(u.T), 0.0)


@partial(jax.tree_util.register_dataclass, data_fields=[*FIELDS, "traces"], meta_fields=SIZES)
@dataclass(frozen=True)
class MixtureTarget(Target):
    """A posterior whose traces' likelihoods are the sum of several ``traces``, along their first axis."""

    traces: Any = None

    def log_likelihoods(self, u: Any) -> Any:
        return np.asarray([self.log_likelihood(one) for one in u])

    def log_likelihood(self, u: Array) -> Array:
        return jnp.where(self.present, logsumexp(self.traces.log_density(u.T), axis=0), 0.0)


def prepared(K: str, table: dict[str, Any], gain_sd: float = 0.0, **model: Any) -> Prepared:
    """A small campaign of short traces, whose values no test here reads; ``model`` has a model's keys."""
    time = np.arange(-1e-2, 0.04, 1e-3)
    omega, V = 80.0, 1.5
    trace = np.where(time > 0, V * omega * np.sin(omega * np.maximum(time, 0)), 0.0)
    trace = np.where(time < np.pi / omega, trace, 0.0)
    rows = pd.DataFrame(table)
    rng = np.random.default_rng(0)
    traces = [(time, trace + rng.normal(size=len(time))) for _ in range(len(rows))]
    rows = rows.assign(impact=[f"i{n}" for n in range(len(rows))], velocity_m_s=V)
    uncertainty = {"relative_mass_sd": 0.2, "relative_gain_sd": gain_sd}
    stated = {"uncertainty": uncertainty, "contact": "between"}
    data = dataset(rows, traces, quantity="deceleration", unit="m/s^2", **stated)
    from bayestissue.studies.fitting import resolve

    content = {"likelihood": "impact", "formula": {"K": K, "C": K}, **model}
    specification, source = resolve(content)
    return prepare(data, specification, source=source)


def target_of(made: Prepared) -> GaussianTarget:
    plain = Target.from_prepared(made)
    count, size = len(plain.present), 2 + len(made.model.nuisance)
    precision = jnp.broadcast_to(jnp.diag(TOLD[:size] ** -2.0), (count, size, size))
    nothing = jnp.zeros((count, size))
    traces = GaussianFactor(nothing, nothing, precision, jnp.zeros(count))
    return GaussianTarget(**vars(plain), traces=traces)


def from_prior(target: GaussianTarget, key: Array) -> tuple[GaussianTarget, State]:
    """Hyperparameters, effects, impacts and traces, top down by the model as it is written."""
    keys = jax.random.split(key)
    model = handlers.trace(handlers.seed(impacts_model, keys[0]))
    sites = model.get_trace(target.model, target.data)
    value = {name: site["value"] for name, site in sites.items() if site["type"] == "sample"}
    y = jnp.stack(
        [
            biject_to(target.model.prior_of(name).support).inv(value[name])
            for name in target.model.hyperparameters
        ]
    )
    b = value["locations"]
    logs = value["log_K_and_C"]
    u = jnp.stack([logs[:, 0], logs[:, 1], *(value[name] for name in target.model.nuisance)])
    told = u + TOLD[: len(u), None] * jax.random.normal(keys[1], u.shape)
    target = replace(target, traces=target.traces._replace(centre=told.T))
    return target, State(y, b, u, target.log_likelihood(u))


def bad_tuning(target: GaussianTarget, several: int = 1) -> tuple[Tuning, Steps]:
    """Sites that are off by half of what a trace tells, and too wide; of several one is far off."""
    traces, count = target.traces, len(target.present)
    size = traces.centre.shape[1]
    off = jnp.asarray(0.5 * TOLD[:size])
    places = jnp.stack([traces.centre + off * (1 - 3 * n) for n in range(several)])
    wide = jnp.broadcast_to(0.5 * traces.precision, (several, *traces.precision.shape))
    scale = jnp.broadcast_to(-2.0 * jnp.arange(several)[:, None], (several, count))
    sites = GaussianFactor(places, jnp.zeros_like(places), wide, scale)
    number = len(target.model.hyperparameters)
    roots = jnp.broadcast_to(jnp.diag(TOLD[:size]), (count, size, size))
    near, length = StudentT(jnp.zeros(number), jnp.eye(number)), jnp.asarray(0.6)
    inner, levels = target.level_effects.shape
    of_level = jnp.broadcast_to(0.2 * jnp.eye(inner), (levels, inner, inner))
    steps = Steps(jnp.full(count, 0.8), jnp.full(count, 0.5), length, length, jnp.ones(levels))
    # Off the middle and narrow, so that what a step gains over the t counts.
    common = StudentT(jnp.full(2, 0.3), jnp.full(2, 0.2))
    along = jnp.where(jnp.arange(size) == (target.common or 0), 1.0, 0.05)[:, None] * jnp.ones(count)
    return Tuning(sites, near, roots, of_level, common, along), steps
