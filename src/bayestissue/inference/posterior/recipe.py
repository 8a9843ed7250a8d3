"""Importance-corrected MCMC on an approximate marginal posterior (Vihola, Helske and Franks 2020).

With a Gaussian site in place of each trace's likelihood, everything but the hyperparameters integrates out,
and a chain moves through a dozen dimensions whatever the number of impacts. Its draws are weighted by the
traces' evidence over that of their sites, p(traces | psi, b) / q(traces | psi, b), the sites are improved
where too few draws stay effective, and each impact's parameters are drawn from their true conditional by
sampling-importance-resampling.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import COORDINATES, TraceData, TraceModel
from bayestissue.inference.execution.compiling import compiled_quickly, filled_up, in_calls
from bayestissue.inference.execution.progress import Progress, silent
from bayestissue.inference.factors import regression
from bayestissue.inference.factors.conditional import ConditionalPrior, evenly_spaced, log_site, normals
from bayestissue.inference.factors.conditional_prior import ConditionalPriors, conditional_priors
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    log_evidence_corrections,
    ratios_among,
)
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.posterior.approximate import (
    LAST,
    Approximation,
    approximate,
    marginal_model,
    potential_at,
    spreads_of_summaries,
)
from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.samplers.coordinates import Coordinates
from bayestissue.inference.samplers.independence import independence_chains
from bayestissue.inference.samplers.nuts import Known, Start, run_chains
from bayestissue.inference.samplers.psis import relative_variance
from bayestissue.inference.samplers.resampling import systematic
from bayestissue.inference.samplers.sampling import Draws

CANDIDATES, _FEWEST_CANDIDATES, _OFF = 8, 2, 1 / 32
# Independent proposals serve where their weights are bounded well and most of them count.
PROPOSAL_LIMIT, _LEAST_EFFECTIVE = 0.5, 0.5
# A matrix of each impact under each of so many draws takes little memory.
_DRAWS_AT_ONCE = 500
# Sites are fitted about so many draws to second order, once for each number, before any chain: of Maxwell's
# element on the example, beside a discrepancy, one pass of 512 left 8 to 71 % of the draws, these leave 73 to
# 89 %. About chains' corrected draws they are fitted as often as that raises the effective number by half.
_DRAWS_BEFORE = (256, 512)
_MOST_PASSES, _GAIN = 4, 1.5
# Chains of the population so many times longer still take less time than the exact path.
_LONGEST = 5


class Attempt(NamedTuple):
    """Sites, and draws of the population made and corrected with them."""

    sites: Approximation
    found: _Population

    @property
    def correction(self) -> Correction:
        """Of the draws."""
        return self.found.correction


def corrected_draws(
    prepared: Prepared,
    settings: Sampler,
    seed: int,
    *,
    summarised: Approximation | None = None,
    say: Progress = silent,
    progress: Progress = silent,
) -> tuple[Approximation, Draws, Correction]:
    """Sites, draws of the approximate marginal posterior made with them, and their correction.

    Where the correction can't be trusted the sites are fitted anew about the corrected draws, as long as that
    helps: see `_attempts`. A weakly identified last parameter then has the other kind of site, a grid or a
    normal. Where all that is wrong is that too few draws are effective, longer chains follow. The best of
    these is returned, trusted or not; `Correction.attempts` lists them all.

    Args:
        prepared: model and data.
        settings: how many chains and draws.
        seed: of all of it.
        summarised: what `approximate` found, if it was asked before.
        say: told what `approximate` has done.
        progress: told how many transitions are done, of every attempt anew.
    """
    rng = np.random.default_rng([seed, 22])
    sites = summarised or approximate(prepared, say=say)

    def sample(sites: Approximation, settings: Sampler = settings) -> Attempt:
        return Attempt(sites, _population_draws(prepared, sites, settings, seed, progress))

    made = _attempts(prepared, sites, sample, seed, rng)
    if prepared.model.may_have_grid and not _best(made).correction.trusted:
        other = approximate(prepared, normal=sites.profile is not None, say=say)
        made += _attempts(prepared, other, sample, seed, rng)
    best = _best(made)
    if best.correction.lacks_only_draws:
        longer = int(np.ceil(1.2 * best.correction.needed / best.correction.effective))
        if longer <= _LONGEST:
            made.append(sample(best.sites, _lengthened(settings, longer)))
            best = _best(made)
    draws, correction = _with_impacts(prepared, best.sites, best.found, settings)
    rows = tuple(attempt.correction.row() for attempt in made)
    return best.sites, draws, replace(correction, attempts=rows)


def _best(made: list[Attempt]) -> Attempt:
    return min(made, key=lambda attempt: attempt.correction.rank)


def _attempts(
    prepared: Prepared,
    sites: Approximation,
    sample: Callable[[Approximation], Attempt],
    seed: int,
    rng: np.random.Generator,
) -> list[Attempt]:
    """Draws with these sites, then with sites fitted about the corrected draws of the last attempt.

    So on until a correction can be trusted or the effective number of draws is not half as large again. A
    grid of the last parameter is not fitted anew.
    """
    if sites.profile is None:
        sites = about_second_order(prepared, sites, seed, rng)
    made = [sample(sites)]
    while not made[-1].correction.trusted and made[-1].sites.profile is None and len(made) < _MOST_PASSES:
        found = made[-1].found
        some = np.resize(rng.permutation(len(found.z_b)), _DRAWS_BEFORE[-1])
        draws = {name: values[some] for name, values in found.raw.items()}, found.z_b[some]
        before = len(_DRAWS_BEFORE) + len(made) - 1
        made.append(sample(_about_draws(prepared, made[-1].sites, draws, seed + before)))
        if made[-1].correction.effective < _GAIN * made[-2].correction.effective:
            break
    return made


def _lengthened(settings: Sampler, times: int) -> Sampler:
    """So many times as many transitions for as many draws."""
    return settings.model_copy(update={"thinning": times * settings.thinning})


def marginal_draws(
    prepared: Prepared,
    summarised: Approximation,
    settings: Sampler,
    seed: int,
    *,
    progress: Progress = silent,
) -> tuple[Draws, Correction]:
    """Draws of the same sites as `sampled_model` has, corrected to the same posterior."""
    found = _population_draws(prepared, summarised, settings, seed, progress)
    return _with_impacts(prepared, summarised, found, settings)


def _with_impacts(
    prepared: Prepared, summarised: Approximation, found: _Population, settings: Sampler
) -> tuple[Draws, Correction]:
    """The population's draws, and each impact's parameters under every one."""
    model, summaries, profile = prepared.model, summarised.summaries, summarised.profile
    candidates = _candidates(model, found.ratios, profile, found.compared)
    choose = partial(sir_proposals, model, prepared.data, summaries, candidates)
    seeds = found.rng.integers(2**32, size=len(found.z_b))
    z_u = in_calls(choose, (found.expected.about, found.expected.precision, seeds), _DRAWS_AT_ONCE)
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
        expected: what they expect of every impact.
        correction: their importance weights.
        compared: draws at which ``ratios`` were taken.
        ratios: likelihood over summary there.
        rng: for what follows.
    """

    chains: Draws
    raw: dict[str, np.ndarray]
    z_b: np.ndarray
    expected: ConditionalPriors
    correction: Correction
    compared: ConditionalPriors
    ratios: ImportanceRatios
    rng: np.random.Generator


def _population_draws(
    prepared: Prepared,
    summarised: Approximation,
    settings: Sampler,
    seed: int,
    progress: Progress,
) -> _Population:
    """Chains of the population and their correction."""
    model, profile = prepared.model, summarised.profile
    data = summarised.data(prepared.data)
    chains = sample_marginal(prepared, summarised, settings, seed, progress)
    shape = (settings.chains, settings.transitions)
    rng = np.random.default_rng([seed, 21])
    count = shape[0] * shape[1]
    raw = summarised.spreads.raw(chains.sites[COORDINATES].reshape(count, -1))
    z_b = rng.standard_normal((count, model.locations.size))
    if profile is not None:
        z_b[:, -1] = raw.pop(LAST)
    every = conditional_priors(model, data, raw, z_b)
    of_impacts, ratios, compared = _log_weights(prepared, summarised, every)
    log_weight = of_impacts.sum(-1).reshape(shape)
    correction = Correction.of(log_weight, settings.chains * settings.draws, ratios)
    places = systematic(correction.weight, settings.draws, rng)
    chosen = np.ravel(places + shape[1] * np.arange(shape[0])[:, None])
    correction = replace(correction, of_impacts=of_impacts[chosen])
    raw = {name: values[chosen] for name, values in raw.items()}
    return _Population(chains, raw, z_b[chosen], _rows(every, chosen), correction, compared, ratios, rng)


def sample_marginal(
    prepared: Prepared, summarised: Approximation, settings: Sampler, seed: int, progress: Progress
) -> Draws:
    """Draws of the marginal posterior's coordinates, by independent proposals where these serve, or NUTS."""
    data = summarised.data(prepared.data)
    arguments = (prepared.model, *filled_up((data, summarised.grid)), summarised.spreads.warp)
    progress(0, 1)
    covariance = summarised.spreads.covariance
    found = independence_chains(marginal_model, arguments, COORDINATES, covariance, settings, seed)
    if found.pareto_k < PROPOSAL_LIMIT and found.effective > _LEAST_EFFECTIVE:
        progress(1, 1)
        return found.draws
    return run_chains(
        marginal_model,
        arguments,
        _begun(prepared, summarised, settings.chains, np.random.default_rng([seed, 23])),
        settings,
        seed,
        progress=progress,
        processes=False,
    )


def _rows(every: ConditionalPriors, chosen: np.ndarray) -> ConditionalPriors:
    return jax.tree.map(lambda values: values[chosen], every)


def about_second_order(
    prepared: Prepared, sites: Approximation, seed: int, rng: np.random.Generator
) -> Approximation:
    """Sites fitted about draws of the population to second order, which cost no chain."""
    for number, count in enumerate(_DRAWS_BEFORE):
        sites = _about_draws(
            prepared, sites, _to_second_order(prepared, sites.spreads, count, rng), seed + number
        )
    return sites


def _log_weights(
    prepared: Prepared, sites: Approximation, every: ConditionalPriors
) -> tuple[Float[np.ndarray, "draw impact"], ImportanceRatios, ConditionalPriors]:
    """Each impact's part of draws' log importance weights; the ratios, and the draws at which these are."""
    ratios = ratios_among(prepared.model, prepared.data, sites.summaries, every.anchors, sites.profile)
    compared = _rows(every, evenly_spaced(len(every.b)))
    of_impacts = log_evidence_corrections(sites.summaries, ratios, every.anchors)
    return np.where(np.isfinite(of_impacts), of_impacts, -np.inf), ratios, compared


def _to_second_order(
    prepared: Prepared, spreads: Coordinates, count: int, rng: np.random.Generator
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Draws of the population to second order: the spreads, unconstrained, and standard locations."""
    y = rng.multivariate_normal(np.zeros(len(spreads.names)), spreads.covariance, count)
    return spreads.raw(y), rng.standard_normal((count, prepared.model.locations.size))


def _about_draws(
    prepared: Prepared, summarised: Approximation, draws: tuple[dict[str, np.ndarray], np.ndarray], seed: int
) -> Approximation:
    """Sites made anew about draws of the population."""
    expected = conditional_priors(prepared.model, summarised.data(prepared.data), *draws)
    summaries = regression.regression_sites(
        prepared.model, prepared.data, summarised.summaries, expected, seed
    )
    near = {name: np.asarray(values.mean()) for name, values in draws[0].items()}
    found = Approximation(summaries, summarised.spreads, None)
    return replace(found, spreads=spreads_of_summaries(prepared, found, near))


def _candidates(
    model: TraceModel, ratios: ImportanceRatios, profile: LikelihoodGrid | None, part: ConditionalPriors
) -> int:
    """How many candidates an impact's parameters are chosen from.

    The choice is off the truth by about v / n, v being the variance of likelihood over summary relative to
    its mean squared, of what has a profile also under the population of each draw.
    """
    varies = float(np.mean(relative_variance(ratios.log_ratio)))
    if profile is not None:
        of_profile = _over(profile, part.b[:, -1], part.sites[f"sd_{model.nuisance[-1]}"])
        varies = (1 + varies) * (1 + float(np.mean(relative_variance(of_profile)))) - 1
    return candidates_for(varies)


def candidates_for(varies: float) -> int:
    """So many for this relative variance of likelihood over summary, infinite where it has no mean."""
    wanted = np.ceil(varies / _OFF) if np.isfinite(varies) else CANDIDATES
    return int(np.clip(wanted, _FEWEST_CANDIDATES, CANDIDATES))


_over = compiled_quickly()(LikelihoodGrid.over)


def _begun(prepared: Prepared, summarised: Approximation, chains: int, rng: np.random.Generator) -> Start:
    """Scattered by half a standard deviation, which lets R-hat see chains that did not forget it."""
    root = np.linalg.cholesky(summarised.spreads.covariance)
    points = 0.5 * rng.standard_normal((chains, len(root))) @ root.T
    found = [potential_at(prepared, summarised, point) for point in points]
    potentials, slopes = (np.array(part) for part in zip(*found, strict=True))
    return start_at(summarised.spreads, Known(points, potentials, slopes))


def start_at(spreads: Coordinates, known: Known) -> Start:
    """Of chains that begin at these points of the coordinates."""
    return Start({COORDINATES: np.zeros(len(spreads.names))}, (COORDINATES,), spreads.covariance, known)


def sir_proposals(
    model: TraceModel,
    data: TraceData,
    summaries: Sites,
    candidates: int,
    about: Float[np.ndarray, "draw impact parameter"],
    precision: Float[np.ndarray, "draw parameter parameter"],
    seeds: Int[np.ndarray, " draw"],
    number: int | None = None,
) -> Float[np.ndarray, "draw impact parameter"]:
    """Standard normals of every impact, one of a few candidates each, chosen by likelihood over summary.

    Of the first ``number`` draws, all of them unless given.
    """
    about, precision, seeds = (values[:number] for values in (about, precision, seeds))
    given = normals(summaries, ConditionalPrior(about, np.asarray(precision)[:, None]))
    rng = np.random.default_rng(seeds)
    best, most = np.zeros(about.shape), np.full(about.shape[:2], -np.inf)
    for number in range(candidates):
        z = rng.standard_normal(about.shape)
        u = given.at(z)
        ratio = log_likelihoods(model, data, u) - log_site(summaries, u)
        # The greatest of these sums is a choice by likelihood over summary (Gumbel 1954).
        value = ratio + rng.gumbel(size=ratio.shape)
        better = (value > most) | (number == 0)
        best = np.where(better[..., None], z, best)
        most = np.where(better, value, most)
    return best
