"""The second path: each trace summarised once, then the population, then a correction.

With its summary in each trace's place, everything but the standard deviations integrates out, and a chain
moves through a dozen dimensions whatever the number of impacts. Its draws are weighted by how much the
traces' true evidence differs from their summaries', and each impact's parameters are drawn from their
true conditional.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.gaussian.conditional import Sites
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import COORDINATES, TraceData, TraceModel
from bayestissue.inference.execution.compiling import compiled_quickly, filled_up, in_calls
from bayestissue.inference.factors import regression
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    importance_ratios,
    log_evidence_corrections,
)
from bayestissue.inference.factors.laplace import ConditionalPrior
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.factors.moments import log_site, normals, standard_points
from bayestissue.inference.posterior.approximate import (
    LAST,
    Approximation,
    approximate,
    marginal_model,
    potential_at,
    spreads_of_summaries,
)
from bayestissue.inference.posterior.conditional_prior import ConditionalPriors, conditional_priors
from bayestissue.inference.posterior.coordinates import Coordinates
from bayestissue.inference.samplers.diagnostics import Check
from bayestissue.inference.samplers.nuts import Known, Start, run_chains
from bayestissue.inference.samplers.psis import below_greatest, pareto_smoothed
from bayestissue.inference.samplers.sampling import Draws, Progress, silent

CANDIDATES, _FEWEST_CANDIDATES, _OFF = 8, 2, 1 / 32
# A matrix of each impact under each of so many draws takes little memory.
_DRAWS_AT_ONCE = 500
# Sites beside a discrepancy are made about so many draws of the population, once for each number, before
# any chain; and again about the chains', so often at most, while less of the draws' worth is left. Of
# Maxwell's on the example one pass of 512 left 8 to 71 %, and these leave 73 to 89 %.
_DRAWS_BEFORE = (256, 512)
_MOST_AGAIN, _WELL_PLACED = 2, 0.3
PARETO_LIMIT = 0.7
# In fits of each element to data of its own kind the share was 0.73 to 1; it was 0.02 where a ridge of the
# likelihood was taken for a peak.
_LEAST_TOLD = 0.25
_EXACT = 'Set sampler.path = "exact" in the model file.'


@dataclass(frozen=True)
class Correction:
    """How the draws were corrected.

    Attributes:
        pareto_k: of the importance weights; above 0.7 they can't be trusted.
        effective: effective number of weighted draws over their number.
        ratios: likelihood over summary, of which the weights were made.
    """

    pareto_k: float
    effective: float
    ratios: ImportanceRatios | None = None

    @property
    def told(self) -> float:
        """Share of the points' worth that likelihood over summary leaves, the median over the impacts.

        Where it is next to nothing the ratio's mean is that of a point or two, the same for all draws, whose
        weights then say nothing of it.
        """
        if self.ratios is None:
            return 1.0
        weight = np.exp(below_greatest(np.asarray(self.ratios.log_ratio)))
        # An impact without any likelihood at the points leaves nothing of them.
        square = np.maximum(np.square(weight).sum(0), np.finfo(float).tiny)
        return float(np.median(weight.sum(0) ** 2 / square) / len(weight))

    @property
    def trusted(self) -> bool:
        """Whether the corrected draws can be used."""
        return all(check.passed for check in self.checks())

    def checks(self) -> tuple[Check, ...]:
        """As some of a run's diagnostics."""
        of_draws = Check(
            "Pareto k of the correction",
            self.pareto_k,
            f"below {PARETO_LIMIT}",
            self.pareto_k < PARETO_LIMIT,
            "do the traces' summaries stand for the traces themselves? "
            f"The correction leaves {self.effective:.0%} of the draws' worth",
            _EXACT,
        )
        if self.ratios is None:
            return (of_draws,)
        of_traces = Check(
            "effective share of the points that traces and summaries were compared at",
            self.told,
            f"above {_LEAST_TOLD}",
            self.told > _LEAST_TOLD,
            "is each trace's likelihood anything like its summary?",
            _EXACT,
        )
        return of_draws, of_traces


def corrected_draws(
    prepared: Prepared,
    settings: Sampler,
    seed: int,
    *,
    summarised: Approximation | None = None,
    say: Progress = silent,
    progress: Progress = silent,
) -> tuple[Approximation, Draws, Correction]:
    """Sites, and draws made with them; of the better of two kinds if need be.

    Whether a last parameter that may be open passes for normal is judged before the chains; where the
    correction then can't be trusted, the other kind of summary may still be right. ``summarised`` is what
    `approximate` found, if it was asked before.
    """
    summarised = summarised or approximate(prepared, say=say)
    if prepared.model.discrepancy:
        return _beside_a_discrepancy(prepared, summarised, settings, seed, progress)
    sample = partial(marginal_draws, prepared, settings=settings, seed=seed, progress=progress)
    made = [(summarised, *sample(summarised))]
    if prepared.model.weakly_identified and not made[0][2].trusted:
        other = made[0][0].profile is not None
        again = approximate(prepared, normal=other, say=say)
        made.append((again, *sample(again)))
    return min(
        made, key=lambda attempt: (not attempt[2].trusted, np.nan_to_num(attempt[2].pareto_k, nan=np.inf))
    )


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
        correction: what the weights are worth.
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
    model, summaries, profile = prepared.model, summarised.summaries, summarised.profile
    # The record stays behind: the population asks only for the summaries.
    data = prepared.data._replace(record=None)  # type: ignore[arg-type]
    chains = run_chains(
        marginal_model,
        (model, *filled_up((data, summaries, profile)), summarised.spreads.warp),
        _begun(prepared, summarised, settings.chains, np.random.default_rng([seed, 23])),
        settings,
        seed,
        progress=progress,
        processes=False,
    )
    shape = (settings.chains, settings.transitions)
    rng = np.random.default_rng([seed, 21])
    count = shape[0] * shape[1]
    raw = summarised.spreads.raw(chains.sites[COORDINATES].reshape(count, -1))
    z_b = rng.standard_normal((count, model.locations.size))
    if profile is not None:
        z_b[:, -1] = raw.pop(LAST)
    every = conditional_priors(model, data, summaries, raw, z_b)
    standard = standard_points(summaries.centre.shape[1])
    some = np.linspace(0, len(z_b) - 1, len(standard)).astype(int)
    compared = _rows(every, some)
    ratios = importance_ratios(model, prepared.data, summaries, compared.anchors, standard, profile)
    smoothed, k = pareto_smoothed(log_evidence_corrections(summaries, ratios, every.anchors).sum(-1))
    weight = np.exp(smoothed.reshape(shape))
    chosen = _resample(weight, settings.draws, rng)
    effective = weight.sum() ** 2 / np.square(weight).sum() / weight.size
    correction = Correction(k, float(effective), ratios)
    raw = {name: values[chosen] for name, values in raw.items()}
    return _Population(chains, raw, z_b[chosen], _rows(every, chosen), correction, compared, ratios, rng)


def _rows(every: ConditionalPriors, chosen: np.ndarray) -> ConditionalPriors:
    return jax.tree.map(lambda values: values[chosen], every)


def _beside_a_discrepancy(
    prepared: Prepared,
    summarised: Approximation,
    settings: Sampler,
    seed: int,
    progress: Progress,
) -> tuple[Approximation, Draws, Correction]:
    """`corrected_draws` by summaries that serve all of the posterior: see `factors.regression`.

    Where the posterior is, summaries tell to second order, each time better, and then, if need be, corrected
    draws.
    """
    rng = np.random.default_rng([seed, 22])
    for number, count in enumerate(_DRAWS_BEFORE):
        draws = _to_second_order(prepared, summarised.spreads, count, rng)
        summarised = _about_draws(prepared, summarised, draws, seed + number)
    made = []
    for again in range(1 + _MOST_AGAIN):
        found = _population_draws(prepared, summarised, settings, seed, progress)
        made.append((summarised, found))
        if found.correction.effective > _WELL_PLACED or again == _MOST_AGAIN:
            break
        some = np.resize(rng.permutation(len(found.z_b)), _DRAWS_BEFORE[-1])
        draws = {name: values[some] for name, values in found.raw.items()}, found.z_b[some]
        summarised = _about_draws(prepared, summarised, draws, seed + len(_DRAWS_BEFORE) + again)
    summarised, found = max(made, key=lambda attempt: attempt[1].correction.effective)
    return summarised, *_with_impacts(prepared, summarised, found, settings)


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
    expected = conditional_priors(prepared.model, prepared.data, summarised.summaries, *draws)
    summaries = regression.regression_sites(
        prepared.model, prepared.data, summarised.summaries, expected, seed
    )
    near = {name: np.asarray(values.mean()) for name, values in draws[0].items()}
    return Approximation(summaries, spreads_of_summaries(prepared, summaries, near), None)


def _candidates(
    model: TraceModel, ratios: ImportanceRatios, profile: LikelihoodGrid | None, part: ConditionalPriors
) -> int:
    """How many candidates an impact's parameters are chosen from.

    The choice is off the truth by about v / n, v being the variance of likelihood over summary relative to
    its mean squared, of what has a profile also under the population of each draw.
    """
    varies = _relative_variance(ratios.log_ratio)
    if profile is not None:
        of_profile = _over(profile, part.b[:, -1], part.sites[f"sd_{model.nuisance[-1]}"])
        varies = (1 + varies) * (1 + _relative_variance(of_profile)) - 1
    wanted = np.ceil(varies / _OFF) if np.isfinite(varies) else CANDIDATES
    return int(np.clip(wanted, _FEWEST_CANDIDATES, CANDIDATES))


_over = compiled_quickly()(LikelihoodGrid.over)


def _relative_variance(log_weight: Array) -> float:
    """Of weights along a first axis: the mean of variance over mean squared; infinite where one has none."""
    weight = np.exp(below_greatest(np.asarray(log_weight)))
    mean = weight.mean(0)
    return float(np.mean(weight.var(0) / mean**2)) if (mean > 0).all() else np.inf


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


def _resample(weight: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of so many draws of each chain, as often as their weights say (systematic resampling).

    A chain without any weight stays as it is: R-hat tells that it is elsewhere.
    """
    chains, length = weight.shape
    weight = np.where(weight.sum(axis=1, keepdims=True) > 0, weight, 1.0)
    share = weight / weight.sum(axis=1, keepdims=True)
    chosen = []
    for chain in range(chains):
        position = (np.arange(number) + rng.uniform()) / number
        index = np.searchsorted(np.cumsum(share[chain]), position)
        chosen.append(chain * length + np.minimum(index, length - 1))
    return np.concatenate(chosen)


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
