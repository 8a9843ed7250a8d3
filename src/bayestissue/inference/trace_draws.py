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
from bayestissue.hierarchy.population import SharedError, Spread, of_impacts
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
from bayestissue.inference.compiling import DRAWS, Helper, compiled_sooner, in_pieces
from bayestissue.inference.element_draws import element_quantities, measured_of
from bayestissue.inference.sampling import Draws


@dataclass(frozen=True)
class Unfolded:
    """Draws of everything, each array [chain, draw, ...].

    ``sites`` are the hierarchy's quantities by the names of `bayestissue.hierarchy.effects`, ``impacts``
    those of every impact, ``log_likelihood`` the log density of each impact, subject and trial with its own
    parameters and effects integrated out. Where ``kept`` is given, impacts have these draws of each chain
    only, and log densities are those of some impacts.
    """

    sites: dict[str, np.ndarray]
    impacts: dict[str, np.ndarray]
    log_likelihood: dict[str, np.ndarray]
    kept: np.ndarray | None = None


def unfold(
    prepared: Prepared, summaries: Summaries, draws: Draws, key: Array, helper: Helper | None = None
) -> Unfolded:
    """Map all draws back, some of them by the helper, if there is one."""
    model, data = prepared.model, prepared.data
    shape = next(iter(draws.sites.values())).shape[:2]
    flat = {name: jnp.asarray(v.reshape(-1, *v.shape[2:])) for name, v in draws.sites.items()}
    flat |= constrained(model, flat)
    keys = jax.random.split(jax.random.fold_in(key, 11), shape[0] * shape[1])
    groups = tuple(
        (getattr(prepared.design, group), len(getattr(prepared.design, f"{group}s"))) for group in GROUPS
    )
    counts = tuple(count for _, count in groups)
    given = (data, summaries, tuple(jnp.asarray(codes) for codes, _ in groups))
    function = partial(unfold_all, model, counts)
    made = in_pieces(helper or Helper(), DRAWS, function, given, (flat, keys))
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


@compiled_sooner(("model", "counts"))
def unfold_all(
    model: TraceModel,
    counts: tuple[int, ...],
    data: TraceData,
    summaries: Summaries,
    codes: tuple[Array, ...],
    flat: dict[str, Array],
    keys: Array,
) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    """b, every impact's quantities and the log densities, of each draw along a first axis."""
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
    b, mass_error = _mass_error(model, data, sites, found, keys[0])
    impacts = impact_quantities(model, data, found.u, mass_error, keys[1])
    return b, impacts, _scores(model, data, summaries, sites, found, groups)


def impact_quantities(
    model: TraceModel, data: TraceData, u: list[Array], mass_error: Array, key: Array
) -> dict[str, Array]:
    """What an impact's parameters stand for, and a draw of the chain's errors given them.

    Args:
        model: the model.
        data: the dataset.
        u: each impact's parameters, K and C at the recorded mass.
        mass_error: of the log mass.
        key: of the chain's errors.
    """
    at, distribution = physical(model, data, u), trace_distribution(model, data, u)
    measured = measured_of(distribution, key)
    impacts = {
        "K": jnp.exp(u[0] + mass_error),
        "C": jnp.exp(u[1] + mass_error),
        "omega_n": at.omega_n,
        "zeta": at.zeta,
        "mass": jnp.exp(data.log_mass + mass_error),
        "chain_error": measured.chain_error,
        **({"sigma_d": jnp.exp(at.log_sigma)} if model.kind == "impact" else {}),
        **({} if model.kind == "impact" else {"sigma_a": jnp.exp(at.log_sigma)}),
        "parameters": jnp.stack(u, axis=-1),
    }
    impacts |= element_quantities(model, data, u, mass_error, measured)
    if model.kind != "impact":
        impacts["theta1"] = distribution.differences()[2]
    return impacts


def _mass_error(
    model: TraceModel, data: TraceData, sites: dict[str, Array], found: Drawn, key: Array
) -> tuple[Array, Array]:
    """People's effects in b put at their true mass, and each impact's error of the log mass.

    Everything seen is log K - e and log C - e. Where e is an impact's own, Var(e) is part of the covariance
    of u; where it is a person's, of that of the person's effects, from which it is taken apart here. Either
    way e is normal given what is seen.
    """
    spread = population(model, sites)
    if spread.shared is not None:
        error = error_of_people(spread.locations, spread.shared, found.b, key)
        b = found.b.at[spread.shared.effect_on_K].add(error).at[spread.shared.effect_on_C].add(error)
        return b, of_impacts(data.design, spread.shared, error)
    return found.b, impact_error(model, spread, found.u, found.about, key)


def impact_error(model: TraceModel, spread: Spread, u: list[Array], about: list[Array], key: Array) -> Array:
    """The error of the log mass where it is each impact's own, given u and its expectation."""
    kk, kc, cc = spread.own
    variance = model.log_mass_sd**2
    determinant = kk * cc - kc**2
    pull_K, pull_C = variance * (cc - kc) / determinant, variance * (kk - kc) / determinant
    mean = -pull_K * (u[0] - about[0]) - pull_C * (u[1] - about[1])
    left = jnp.maximum(variance * (1 - pull_K - pull_C), 0.0)
    return mean + jnp.sqrt(left) * jax.random.normal(key, mean.shape)


def error_of_people(sd: Array, shared: SharedError, b: Array, key: Array) -> Array:
    """The error e given what is seen of a person's effects, f = s - e, all of them normal and independent.

    Its mean is -v (C f_K + K f_C) / (K C + v (K + C)), with variances v of e, K of s_K and C of s_C.
    """
    K, C = sd[shared.effect_on_K] ** 2, sd[shared.effect_on_C] ** 2
    over = shared.variance / (K * C + shared.variance * (K + C))
    mean = -over * (C * b[shared.effect_on_K] + K * b[shared.effect_on_C])
    return mean + jnp.sqrt(over * K * C) * jax.random.normal(key, mean.shape)


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

        weight = [total(parts.weight[a][b]) for a, b in ((0, 0), (0, 1), (1, 1))]
        gained = integrated_effects(model, sites, name, weight, [total(each) for each in pull])
        scores[f"traces_of_{name}"] = total(alone) + gained
    return scores


def integrated_effects(
    model: TraceModel, sites: dict[str, Array], group: str, weight: list[Array], pull: list[Array]
) -> Array:
    """What the log density of each level's traces gains by the level's two effects being integrated out.

    Args:
        model: the model.
        sites: the standard deviations.
        group: "subject" or "trial".
        weight: each level's sums of W, as (KK, KC, CC).
        pull: its sums of the log evidence's slopes by log K and log C, the effects being 0.
    """
    (l00, l10), l11 = _factor_of_effects(model, sites, group)
    w00, w01, w11 = weight
    m00 = 1 + l00**2 * w00 + 2 * l00 * l10 * w01 + l10**2 * w11
    m01 = l11 * (l00 * w01 + l10 * w11)
    m11 = 1 + l11**2 * w11
    h0, h1 = l00 * pull[0] + l10 * pull[1], l11 * pull[1]
    determinant = m00 * m11 - m01**2
    return (m11 * h0**2 - 2 * m01 * h0 * h1 + m00 * h1**2) / (2 * determinant) - jnp.log(determinant) / 2


def _factor_of_effects(
    model: TraceModel, sites: dict[str, Array], group: str
) -> tuple[tuple[Array, Array], Array]:
    """Columns of the lower Cholesky factor of the covariance of a group's two effects."""
    sd_K, sd_C = (sites.get(f"sd_{group}_{q}", jnp.zeros(())) for q in RESPONSES)
    if group != "subject" or model.mass_error == "impact":
        return (sd_K, jnp.zeros(())), sd_C
    variance = model.log_mass_sd**2
    first = jnp.sqrt(sd_K**2 + variance)
    # C + v - v^2 / (K + v), without the difference of near equals
    return (first, variance / first), jnp.sqrt(sd_C**2 + variance * sd_K**2 / first**2)


def thinned(draws: dict[str, Any], number: int) -> dict[str, Any]:
    """Every so many draws of each chain, so that about ``number`` are left of all chains."""
    chains, length = next(iter(draws.values())).shape[:2]
    step = max(1, chains * length // number)
    return {name: values[:, ::step] for name, values in draws.items()}
