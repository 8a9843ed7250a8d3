"""From the sampler's standard normals back to what they stand for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayestissue.hierarchy.conditional import Summaries, impact_log_evidence
from bayestissue.hierarchy.design import GROUPS
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import (
    Drawn,
    TraceData,
    TraceModel,
    constrained,
    from_standard,
    physical,
    population,
    trace_distribution,
)
from bayestissue.inference.sampling import Draws


@dataclass(frozen=True)
class Unfolded:
    """Draws of everything, each array [chain, draw, ...].

    ``sites`` are the hierarchy's quantities by the names of `bayestissue.hierarchy.effects`, ``impacts``
    those of every impact, ``log_likelihood`` the log density of each impact, subject and trial with its own
    parameters and effects integrated out.
    """

    sites: dict[str, np.ndarray]
    impacts: dict[str, np.ndarray]
    log_likelihood: dict[str, np.ndarray]


def unfold(prepared: Prepared, summaries: Summaries, draws: Draws, key: Array) -> Unfolded:
    """Map all draws back in one compiled pass over them."""
    model, data = prepared.model, prepared.data
    shape = next(iter(draws.sites.values())).shape[:2]
    flat = {name: jnp.asarray(v.reshape(-1, *v.shape[2:])) for name, v in draws.sites.items()}
    flat |= constrained(model, flat)
    keys = jax.random.split(jax.random.fold_in(key, 11), shape[0] * shape[1])
    groups = tuple(
        (getattr(prepared.design, group), len(getattr(prepared.design, f"{group}s"))) for group in GROUPS
    )
    counts = tuple(count for _, count in groups)
    made = _unfold_all(model, counts, data, summaries, flat, keys, tuple(codes for codes, _ in groups))
    b, impacts, scores = jax.tree.map(lambda v: np.asarray(v).reshape(*shape, *v.shape[1:]), made)
    spreads = {name: np.asarray(flat[name]).reshape(shape) for name in model.spreads}
    return Unfolded(named_sites(prepared, spreads, b), impacts, scores)


def named_sites(prepared: Prepared, spreads: dict[str, np.ndarray], b: np.ndarray) -> dict[str, np.ndarray]:
    """The hierarchy's quantities by name, from the spreads and the locations b, all [chain, draw, ...].

    Effects that the formulas leave out are zero, so that what follows need not ask.
    """
    sites = dict(spreads)
    for name, part in prepared.model.locations.parts.items():
        values = b[..., part]
        sites[name] = values if name.startswith(("subject_", "trial_", "covariate_")) else values[..., 0]
    for response in RESPONSES:
        for group in GROUPS:
            count = len(getattr(prepared.design, f"{group}s"))
            sites.setdefault(f"{group}_effect_{response}", np.zeros((*b.shape[:2], count)))
            sites.setdefault(f"sd_{group}_{response}", np.zeros(b.shape[:2]))
    return sites


@partial(jax.jit, static_argnames=("model", "counts"))
def _unfold_all(
    model: TraceModel,
    counts: tuple[int, ...],
    data: TraceData,
    summaries: Summaries,
    flat: dict[str, Array],
    keys: Array,
    codes: tuple[Array, ...],
) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    groups = tuple(zip(codes, counts, strict=True))
    one = partial(_unfold_one, model, data, summaries, groups=groups)
    return jax.lax.map(lambda part: one(*part), (flat, keys))


def _unfold_one(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    draw: dict[str, Array],
    key: Array,
    *,
    groups: tuple[tuple[Array, int], ...],
) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    sites = {name: draw[name] for name in model.spreads}
    found = from_standard(model, data, summaries, sites, draw["standard_locations"], draw["standard_impacts"])
    keys = jax.random.split(key)
    at = physical(model, data, found.u)
    mass_error = _mass_error(model, sites, found, keys[0])
    errors = trace_distribution(model, data, found.u).draw_errors(keys[1])
    impacts = {
        "K": jnp.exp(found.u[0] + mass_error),
        "C": jnp.exp(found.u[1] + mass_error),
        "omega_n": at.omega_n,
        "zeta": at.zeta,
        "mass": jnp.exp(data.log_mass + mass_error),
        "chain_error": errors,
        **({"sigma_d": jnp.exp(at.log_sigma)} if model.kind == "impact" else {}),
        **({} if model.kind == "impact" else {"sigma_a": jnp.exp(at.log_sigma)}),
        "parameters": jnp.stack(found.u, axis=-1),
    }
    if model.kind != "impact":
        distribution = trace_distribution(model, data, found.u)
        impacts["theta1"] = distribution.differences()[2]
    return found.b, impacts, _scores(model, data, summaries, sites, found, groups)


def _mass_error(model: TraceModel, sites: dict[str, Array], found: Drawn, key: Array) -> Array:
    """The error e of the log mass given u = (log K, log C) - e, normal: Var(e) is part of u's covariance."""
    kk, kc, cc = population(model, sites).own
    variance = model.log_mass_sd**2
    determinant = kk * cc - kc**2
    pull_K, pull_C = variance * (cc - kc) / determinant, variance * (kk - kc) / determinant
    mean = -pull_K * (found.u[0] - found.about[0]) - pull_C * (found.u[1] - found.about[1])
    left = jnp.maximum(variance * (1 - pull_K - pull_C), 0.0)
    return mean + jnp.sqrt(left) * jax.random.normal(key, mean.shape)


def _scores(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    sites: dict[str, Array],
    found: Drawn,
    groups: tuple[tuple[Array, int], ...],
) -> dict[str, Array]:
    """Log densities for cross-validation: of each trace, and of all traces of a person or a condition."""
    parts = found.conditional.parts
    scores = {"trace": impact_log_evidence(found.conditional, summaries, found.about)}
    for name, (codes, count) in zip(GROUPS, groups, strict=True):
        effects = [
            found.b[model.locations.parts[f"{name}_effect_{q}"]][codes]
            if f"{name}_effect_{q}" in model.locations.parts
            else jnp.zeros_like(found.u[0])
            for q in ("K", "C")
        ]
        about = [found.about[0] - effects[0], found.about[1] - effects[1], *found.about[2:]]
        alone = impact_log_evidence(found.conditional, summaries, about)
        away = [about[a] - summaries.centre[:, a] for a in range(len(about))]
        pull = [parts.pull[a] - sum(parts.weight[a][b] * away[b] for b in range(len(about))) for a in (0, 1)]

        def total(values: Array, codes: Array = codes, count: int = count) -> Array:
            return jax.ops.segment_sum(values, codes, count)

        sd = [sites.get(f"sd_{name}_{q}", jnp.zeros(())) for q in ("K", "C")]
        m00 = 1 + sd[0] ** 2 * total(parts.weight[0][0])
        m01 = sd[0] * sd[1] * total(parts.weight[0][1])
        m11 = 1 + sd[1] ** 2 * total(parts.weight[1][1])
        h0, h1 = sd[0] * total(pull[0]), sd[1] * total(pull[1])
        determinant = m00 * m11 - m01**2
        gained = (m11 * h0**2 - 2 * m01 * h0 * h1 + m00 * h1**2) / (2 * determinant)
        scores[f"traces_of_{name}"] = total(alone) + gained - jnp.log(determinant) / 2
    return scores


def thinned(draws: dict[str, Any], number: int) -> dict[str, Any]:
    """Every so many draws of each chain, so that about ``number`` are left of all chains."""
    chains, length = next(iter(draws.values())).shape[:2]
    step = max(1, chains * length // number)
    return {name: values[:, ::step] for name, values in draws.items()}
