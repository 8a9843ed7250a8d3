"""The second path: each trace summarised once, then the population, then a correction.

With its summary in each trace's place, everything but the standard deviations integrates out, and a chain
moves through a dozen dimensions whatever the number of impacts. Its draws are weighted by how much the
traces' true evidence differs from their summaries', and each impact's parameters are drawn from their
true conditional.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayestissue.hierarchy.conditional import Summaries, impact_parameters
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, constrained, located, log_likelihood
from bayestissue.inference import wide_summaries
from bayestissue.inference.chains import Start, run_chains
from bayestissue.inference.compiling import (
    CHOICE,
    CORRECTION,
    Helper,
    compiled_quickly,
    compiled_sooner,
    in_pieces,
)
from bayestissue.inference.diagnostics import Check
from bayestissue.inference.pareto import pareto_smoothed
from bayestissue.inference.ratios import Ratios, compare_over, log_corrections
from bayestissue.inference.sampling import Draws, Progress, silent
from bayestissue.inference.trace_moments import standard_points
from bayestissue.inference.trace_profile import Profile
from bayestissue.inference.trace_start import (
    LAST,
    Summarised,
    spreads_model,
    spreads_of_summaries,
    summarise,
)

CANDIDATES, _FEWEST_CANDIDATES, _OFF = 8, 2, 1 / 32
# Summaries beside a discrepancy are made again, so often at most, while less of the draws' worth is left.
_MOST_AGAIN, _WELL_PLACED = 2, 0.3
PARETO_LIMIT = 0.7


@dataclass(frozen=True)
class Correction:
    """How the draws were corrected.

    Attributes:
        pareto_k: of the importance weights; above 0.7 they can't be trusted.
        effective: effective number of weighted draws over their number.
    """

    pareto_k: float
    effective: float

    @property
    def trusted(self) -> bool:
        """Whether the corrected draws can be used."""
        return self.pareto_k < PARETO_LIMIT

    def check(self) -> Check:
        """As one of a run's diagnostics."""
        return Check(
            "Pareto k of the correction",
            self.pareto_k,
            f"below {PARETO_LIMIT}",
            self.trusted,
            "do the traces' summaries stand for the traces themselves? "
            f"The correction leaves {self.effective:.0%} of the draws' worth",
            'Set sampler.path = "exact" in the model file.',
        )


def corrected_draws(
    prepared: Prepared,
    settings: Sampler,
    seed: int,
    *,
    summarised: Summarised | None = None,
    say: Progress = silent,
    progress: Progress = silent,
    helper: Helper | None = None,
) -> tuple[Summarised, Draws, Correction]:
    """Summaries, and draws made with them; of the better of two kinds if need be.

    Whether a last parameter that may be open passes for normal is judged before the chains; where the
    correction then can't be trusted, the other kind of summary may still be right. ``summarised`` is what
    `summarise` found, if it was asked before.
    """
    helper = helper or Helper()
    summarised = summarised or summarise(prepared, say=say, helper=helper)
    if prepared.model.discrepancy:
        return _beside_a_discrepancy(prepared, summarised, settings, seed, progress, helper)
    sample = partial(summary_draws, prepared, settings=settings, seed=seed, progress=progress, helper=helper)
    made = [(summarised, *sample(summarised))]
    if prepared.model.last_may_be_open and not made[0][2].trusted:
        other = made[0][0].profile is not None
        again = summarise(prepared, normal=other, say=say, helper=helper)
        made.append((again, *sample(again)))
    return min(made, key=lambda attempt: np.nan_to_num(attempt[2].pareto_k, nan=np.inf))


def summary_draws(
    prepared: Prepared,
    summarised: Summarised,
    settings: Sampler,
    seed: int,
    *,
    progress: Progress = silent,
    helper: Helper | None = None,
) -> tuple[Draws, Correction]:
    """Draws of the same sites as `sampled_model` has, corrected to the same posterior.

    ``helper`` may have compiled what is asked for, and shares what is done draw by draw.
    """
    helper = helper or Helper()
    found = _population_draws(prepared, summarised, settings, seed, progress, helper)
    return _with_impacts(prepared, summarised, found, settings, helper)


def _with_impacts(
    prepared: Prepared, summarised: Summarised, found: _Population, settings: Sampler, helper: Helper
) -> tuple[Draws, Correction]:
    """The population's draws, and each impact's parameters under every one."""
    model, summaries, profile = prepared.model, summarised.summaries, summarised.profile
    of_draws = jax.random.split(found.key, len(found.z_b))
    candidates = _candidates(model, found.ratios, profile, found.compared)
    choose = partial(standard_impacts, model)
    shared, rows = (prepared.data, summaries, candidates), (found.raw, found.z_b, of_draws)
    z_u = in_pieces(helper, CHOICE, choose, shared, rows)
    sites = {**found.raw, "standard_locations": found.z_b, "standard_impacts": z_u}
    shape = (settings.chains, settings.draws)
    draws = Draws(
        {name: np.asarray(values).reshape(*shape, *values.shape[1:]) for name, values in sites.items()},
        found.chains.statistics,
        found.chains.max_tree_depth,
    )
    return draws, found.correction


class _Population(NamedTuple):
    """Draws of the population, chosen by their weights.

    Attributes:
        chains: as the sampler left them.
        raw: the spreads, unconstrained.
        z_b: the standard locations.
        correction: what the weights are worth.
        compared: spreads and b at which ``ratios`` were taken.
        ratios: likelihood over summary there.
        key: for what follows.
    """

    chains: Draws
    raw: dict[str, Array]
    z_b: Array
    correction: Correction
    compared: tuple[dict[str, Array], Array]
    ratios: Ratios
    key: Array


def _population_draws(
    prepared: Prepared,
    summarised: Summarised,
    settings: Sampler,
    seed: int,
    progress: Progress,
    helper: Helper,
) -> _Population:
    """Chains of the population and their correction."""
    model, summaries, profile = prepared.model, summarised.summaries, summarised.profile
    # The record stays behind: the population asks only for the summaries.
    data = prepared.data._replace(record=None)  # type: ignore[arg-type]
    chains = run_chains(
        spreads_of(model),
        (data, summaries, profile, summarised.warp),
        _start(summarised),
        settings,
        seed,
        progress=progress,
        processes=False,
        helper=helper,
    )
    shape = (settings.chains, settings.transitions)
    raw = {name: jnp.asarray(values.reshape(-1)) for name, values in chains.sites.items()}
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 21), 3)
    z_b = jax.random.normal(keys[0], (shape[0] * shape[1], model.locations.size))
    if profile is not None:
        last = raw.pop(LAST)
        z_b = z_b.at[:, -1].set(last if summarised.warp is None else summarised.warp(last))
    standard = jnp.asarray(standard_points(summaries.centre.shape[1]))
    some = np.linspace(0, len(z_b) - 1, len(standard)).astype(int)
    helper.wait(CORRECTION)
    part = locations_of(
        model, data, summaries, {name: values[some] for name, values in raw.items()}, z_b[some]
    )
    ratios = compare_over(model, prepared.data, summaries, part, standard, profile)
    log_weight = np.asarray(log_weights(model, data, summaries, ratios, raw, z_b))
    smoothed, k = pareto_smoothed(log_weight)
    weight = np.exp(smoothed.reshape(shape))
    chosen = _resample(weight, settings.draws, np.random.default_rng([seed, 21]))
    effective = weight.sum() ** 2 / np.square(weight).sum() / weight.size
    correction = Correction(k, float(effective))
    raw = {name: values[chosen] for name, values in raw.items()}
    return _Population(chains, raw, z_b[chosen], correction, part, ratios, keys[2])


def _beside_a_discrepancy(
    prepared: Prepared,
    summarised: Summarised,
    settings: Sampler,
    seed: int,
    progress: Progress,
    helper: Helper,
) -> tuple[Summarised, Draws, Correction]:
    """`corrected_draws` by summaries that serve all of the posterior: see `wide_summaries`.

    Where the posterior is, the first summaries tell to second order, and then, if need be, corrected draws.
    """
    count, rng = wide_summaries.DRAWS, np.random.default_rng([seed, 22])
    mode, names = summarised.spreads.mode, sorted(summarised.spreads.mode)
    flat = rng.multivariate_normal(
        [float(mode[name]) for name in names], summarised.spreads.covariance, count
    )
    raw = {name: jnp.asarray(flat[:, place]) for place, name in enumerate(names)}
    z_b = jnp.asarray(rng.standard_normal((count, prepared.model.locations.size)))
    made = []
    for again in range(1 + _MOST_AGAIN):
        summarised = _about_draws(prepared, summarised, (raw, z_b), seed + again)
        found = _population_draws(prepared, summarised, settings, seed, progress, helper)
        made.append((summarised, found))
        if found.correction.effective > _WELL_PLACED:
            break
        some = np.resize(rng.permutation(len(found.z_b)), count)
        raw, z_b = {name: values[some] for name, values in found.raw.items()}, found.z_b[some]
    summarised, found = max(made, key=lambda attempt: attempt[1].correction.effective)
    return summarised, *_with_impacts(prepared, summarised, found, settings, helper)


def _about_draws(
    prepared: Prepared, summarised: Summarised, draws: tuple[dict[str, Array], Array], seed: int
) -> Summarised:
    """Summaries made anew about draws of the population."""
    summaries = wide_summaries.regressed(prepared.model, prepared.data, summarised.summaries, draws, seed)
    near = {name: np.asarray(values.mean()) for name, values in draws[0].items()}
    return Summarised(summaries, spreads_of_summaries(prepared, summaries, near), None)


def _candidates(
    model: TraceModel, ratios: Ratios, profile: Profile | None, part: tuple[dict[str, Array], Array]
) -> Array:
    """How many candidates an impact's parameters are chosen from.

    The choice is off the truth by about v / n, v being the variance of likelihood over summary relative to
    its mean squared, of what has a profile also under the population of each draw.
    """
    varies = _relative_variance(ratios.log_ratio)
    if profile is not None:
        sites, b = part
        of_profile = profile.over(b[:, -1], sites[f"sd_{model.nuisance[-1]}"])
        varies = (1 + varies) * (1 + _relative_variance(of_profile)) - 1
    wanted = np.ceil(varies / _OFF) if np.isfinite(varies) else CANDIDATES
    return jnp.asarray(np.int64(np.clip(wanted, _FEWEST_CANDIDATES, CANDIDATES)))


def _relative_variance(log_weight: Array) -> float:
    """Of weights along a first axis: the mean of variance over mean squared."""
    weight = np.exp(np.asarray(log_weight - log_weight.max(0)))
    return float(np.mean(weight.var(0) / weight.mean(0) ** 2))


def _start(summarised: Summarised) -> Start:
    """The spreads' mode; the warped coordinate begins at its middle, and is standard normal by design."""
    mode, covariance = dict(summarised.spreads.mode), summarised.spreads.covariance.copy()
    names = tuple(sorted(mode))
    if summarised.warp is not None:
        place = names.index(LAST)
        mode[LAST] = np.zeros(())
        covariance[place], covariance[:, place] = 0.0, 0.0
        covariance[place, place] = 1.0
    return Start(mode, names, covariance)


@lru_cache(maxsize=8)
def spreads_of(model: TraceModel) -> Callable[..., None]:
    """The same function each time, so that what is compiled for it serves again."""
    return partial(spreads_model, model)


@compiled_quickly("model")
def locations_of(
    model: TraceModel, data: TraceData, summaries: Summaries, raw: dict[str, Array], z_b: Array
) -> tuple[dict[str, Array], Array]:
    """Spreads and b of some draws."""

    def one(draw: tuple[dict[str, Array], Array]) -> tuple[dict[str, Array], Array]:
        sites = constrained(model, draw[0])
        return sites, located(model, data, summaries, sites, draw[1]).b

    return jax.lax.map(one, (raw, z_b))


@compiled_sooner("model")
def log_weights(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    ratios: Ratios,
    raw: dict[str, Array],
    z_b: Array,
) -> Array:
    """Log of the true evidence over the summaries', for each draw of the population."""

    def one(draw: tuple[dict[str, Array], Array]) -> Array:
        found = located(model, data, summaries, constrained(model, draw[0]), draw[1])
        return log_corrections(ratios, summaries, found.conditional.parts, found.about).sum()

    return jax.lax.map(one, (raw, z_b))


def _resample(weight: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of so many draws of each chain, as often as their weights say (systematic resampling)."""
    chains, length = weight.shape
    share = weight / weight.sum(axis=1, keepdims=True)
    chosen = []
    for chain in range(chains):
        position = (np.arange(number) + rng.uniform()) / number
        index = np.searchsorted(np.cumsum(share[chain]), position)
        chosen.append(chain * length + np.minimum(index, length - 1))
    return np.concatenate(chosen)


@compiled_sooner("model")
def standard_impacts(
    model: TraceModel,
    data: TraceData,
    summaries: Summaries,
    candidates: Array,
    raw: dict[str, Array],
    z_b: Array,
    keys: Array,
) -> Array:
    """Standard normals of every impact, one of a few candidates each, chosen by likelihood over summary."""
    shape = summaries.centre.shape

    def one(draw: tuple[dict[str, Array], Array, Array]) -> Array:
        own, z, key = draw
        _, about, conditional = located(model, data, summaries, constrained(model, own), z)

        def consider(number: Array, kept: tuple[Array, Array]) -> tuple[Array, Array]:
            best, most = kept
            of_candidate, of_choice = jax.random.split(jax.random.fold_in(key, number))
            candidate = jax.random.normal(of_candidate, shape)
            u = impact_parameters(conditional, summaries, about, candidate)
            ratio = log_likelihood(model, data, u) - summaries.log_summary(u)
            # The greatest of these sums is a choice by likelihood over summary (Gumbel 1954).
            value = jnp.nan_to_num(ratio, nan=-jnp.inf) + jax.random.gumbel(of_choice, ratio.shape)
            better = (value > most) | (number == 0)
            return jnp.where(better[:, None], candidate, best), jnp.where(better, value, most)

        return jax.lax.fori_loop(0, candidates, consider, (jnp.zeros(shape), jnp.full(shape[0], -jnp.inf)))[0]

    return jax.lax.map(one, (raw, z_b, keys))
